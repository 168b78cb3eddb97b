"""Formation, version 1: drones fly one shape after another, each to a place of its own.

    from swarm_envs import formation_v1
    env = formation_v1.parallel_env(num_drones=10, letters="ARC")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; the observed
`task.goal` is the drone's place in the current shape.

**Shapes.** `plane`, `pyramid`, `cube`, `sphere` and `plane` by default; `rings` and `blocks` are
those of Fig. 9 of the RTH3D paper; `letter:A` etc. are letters. Shapes exist for any number of
drones; places are 0.5 m apart, or less where the shape would not fit into the arena. All shapes are
turned about the vertical by one random angle; letters are not.

**Layouts.** `tour`: the default shapes. `cube`: one change, from a plane to a cube, within 8 s.
`shuffle`: the same with `labels="random"`.

**Labels.** `nearest` (the default): drones are assigned to places by the least sum of squared
distances, and the reference is a straight line of 4 s to the place. `random`, `mirror`, `blocks`:
see `swarm_envs.tasks.formation`; there is no reference.

**Start.** On the first shape, or just above the ground (`start="ground"`), with a random
assignment. `reset(options={"start": ...})` sets other starts. Goals cannot be set: use `shapes`.

**Success.** A shape is reached when every drone stayed within 0.10 m of its place for 0.5 s before
the next shape begins, every 6 s. Success: all shapes were reached, without a collision.

**Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is one over the number
of shapes, for each shape reached.

**End.** The episode is terminated by a collision, the floor, a wall, an obstacle, tumbling (150
rad/s) or success. It is truncated after 6 s for each shape but the first.

**Versions.** v1: first version.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.errors import check_name, check_type
from swarm_envs.tasks.formation import LAYOUTS, FormationTask, shapes_of


@dataclass(frozen=True, kw_only=True)
class FormationOptions(TaskOptions):
    """Options of a formation environment."""

    num_drones: int = 9
    """N small drones, if no team is given."""
    layout: str | None = None
    """A mission by name, instead of shapes, letters, labels and shape_s: `tour`, `cube` or
    `shuffle`; see `LAYOUTS` of `swarm_envs.tasks.formation`."""
    shapes: Sequence[str] | None = None
    """Names of the shapes, in order; None: `tour`'s."""
    letters: str | None = None
    """A text such as `"ARC"` to write, letter by letter, instead of `shapes`."""
    labels: str | None = None
    """Who goes where: `nearest`, `random`, `mirror` or `blocks`; None: the first."""
    start: str = "shape"
    """Where drones start: on the first `shape`, or on the `ground`."""
    spacing_m: float | None = None
    """Smallest distance between two places of a shape, m; None: 0.5, or what fits."""
    shape_s: float | None = None
    """Time for each shape, s; None: 6."""
    travel_s: float = 4.0
    """Time in which the reference gets there, s."""
    turn_rad: tuple[float, float] | None = None
    """Range of the turn of all shapes about the vertical, rad; None: anything, but letters are not
    turned."""

    task_type: ClassVar[type[FormationTask]] = FormationTask
    """What `make_task` makes."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        super().__post_init__()
        check_type("letters", self.letters, str | None)
        check_type("shapes", self.shapes, Sequence | None)
        if self.layout is not None:
            check_name("layout", self.layout, LAYOUTS)

    def make_task(self) -> FormationTask:
        """Formations as these options say.

        Raises:
            ValueError: the options contradict each other, or a shape does not fit the arena.
        """
        turn_rad = self.turn_rad
        if turn_rad is None:
            turn_rad = (0.0, 2 * math.pi) if self.letters is None else (0.0, 0.0)
        return self.task_type(
            team=self.vehicles,
            **self._mission(),
            start=self.start,
            spacing_m=self.spacing_m,
            travel_s=self.travel_s,
            turn_rad=turn_rad,
            reward_weights=self.weights,
            obstacles=self.standing,
        )

    def _mission(self) -> dict[str, Any]:
        """Options of the task that a layout or the caller gives."""
        shapes = self.shapes
        if self.letters is not None:
            if not self.letters:
                raise ValueError("letters is '', but must have at least one, such as 'ARC'")
            if shapes is not None:
                raise ValueError(
                    f"letters={self.letters!r} says what is flown, but shapes are given too; give "
                    "either"
                )
            shapes = shapes_of(self.letters)
        mission = {"shapes": shapes, "labels": self.labels, "shape_s": self.shape_s}
        given = {name: value for name, value in mission.items() if value is not None}
        if self.layout is not None:
            if given:
                raise ValueError(
                    f"layout={self.layout!r} already says what is flown, but {', '.join(given)} "
                    "are given too; give either"
                )
            return dict(LAYOUTS[self.layout])
        return given if shapes is None else {**given, "shapes": tuple(shapes)}


blueprint, parallel_env, env = task_views(FormationOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
