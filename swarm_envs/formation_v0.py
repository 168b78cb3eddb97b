"""Formation, version 0: fly one shape after another, each drone to a place of its own.

    from swarm_envs import formation_v0
    env = formation_v0.parallel_env(num_drones=10, letters="ARC")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v0`; the observed
`task.goal` is the drone's place in the present shape.

**Shapes.** `plane`, `pyramid`, `cube`, `sphere`, then `plane` again; `rings` and `blocks` as in
Fig. 9 of the RTH3D paper; `letter:A` and the like. Any number of drones, 0.5 m apart or, where
that would not fit the arena, less. All shapes are turned about the vertical by one drawn angle;
letters are not.

**Start.** On the first shape, or just above the ground (`start="ground"`); who stands where is
drawn. `reset(options={"start": ...})` starts elsewhere. Goals cannot be given: use `shapes`.

**Labels.** `nearest` (the default): places are matched to drones by the least sum of squared ways,
and straight lines there within 4 s are the reference. `random`, `mirror`, `blocks`: see
`swarm_envs.tasks.formation`; no reference.

**Success.** Each shape is reached when every drone was within 0.10 m of its place for 0.5 s before
the next shape is due, after 6 s; success when all were, without a collision.

**Rewards** (per drone, weights in `FormationTask.reward_weights`): as in swap; `success` is one
over the number of shapes, for each that is reached.

**End.** Terminated by a collision, the floor, a wall, an obstacle, tumbling (150 rad/s) or success;
truncated by the clock, 6 s for each shape that is flown to.

**Versions.** v0: the first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

from swarm_envs.arguments import typed
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.options import (
    Blueprint,
    EnvOptions,
    aec_view,
    check_common,
    parallel_view,
    refuse_unknown,
    team_of,
)
from swarm_envs.errors import check_kind, check_name
from swarm_envs.tasks.formation import LAYOUTS, FormationTask, shapes_of
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.vehicles import Vehicle


@typed
def blueprint(
    *,
    num_drones: int = 9,
    team: str | Sequence[Vehicle] | None = None,
    layout: str | None = None,
    shapes: Sequence[str] | None = None,
    letters: str | None = None,
    labels: str | None = None,
    start: str = "shape",
    spacing_m: float | None = None,
    shape_s: float | None = None,
    travel_s: float = 4.0,
    turn_rad: tuple[float, float] | None = None,
    obstacles: Sequence[Obstacle] = (),
    reward_weights: Mapping[str, float] | None = None,
    render_mode: str | None = None,
    **options: Unpack[EnvOptions],
) -> Blueprint:
    """Make a formation environment: what every interface is made from.

    Args:
        num_drones: N small drones, if no team is given.
        team: the vehicles, or a string such as `"SSLL"`; overrides `num_drones`.
        layout: a mission by name, instead of shapes, letters, labels and shape_s: `tour`, `cube` or
            `shuffle`; see `LAYOUTS` of `swarm_envs.tasks.formation`.
        shapes: names of the shapes, in order; None: `tour`'s.
        letters: a text such as `"ARC"` to write, letter by letter, instead of `shapes`.
        labels: who goes where: `nearest`, `random`, `mirror` or `blocks`; None: the first.
        start: on the first `shape`, or on the `ground`.
        spacing_m: smallest distance between two places of a shape, m; None: 0.5, or what fits.
        shape_s: time for each shape, s; None: 6.
        travel_s: time in which the reference gets there, s.
        turn_rad: range of the turn of all shapes about the vertical, rad; None: anything, but
            letters are not turned.
        obstacles: what stands in the way: `Box` and `Column` of `swarm_envs.tasks.obstacles`.
        reward_weights: weight of each reward term; terms left out keep their default.
        render_mode: `rgb_array` (pictures), `human` (a window) or None.
        **options: those of every task; see `swarm_envs.envs.config.EnvConfig`.

    Raises:
        TypeError: an option does not exist (the message names the nearest), or has a wrong type.
        ValueError: an option has an impossible value or contradicts the layout, or a shape does not
            fit the arena.
        ImportError: `physics="bullet"` without pybullet.
    """
    refuse_unknown(blueprint, options)
    weights, standing = check_common(reward_weights, obstacles)
    if letters is not None:
        check_kind("letters", letters, str, "'ARC'")
        if not letters:
            raise ValueError("letters is '', but must have at least one, such as 'ARC'")
        shapes = shapes_of(letters)
    mission = {"shapes": shapes, "labels": labels, "shape_s": shape_s}
    if turn_rad is None:
        turn_rad = (0.0, 2 * math.pi) if letters is None else (0.0, 0.0)
    task = FormationTask(
        team=team_of(team, num_drones),
        **_mission(layout, {k: v for k, v in mission.items() if v is not None}),
        start=start,
        spacing_m=spacing_m,
        travel_s=travel_s,
        turn_rad=turn_rad,
        reward_weights={**REWARD_WEIGHTS, **weights},
        obstacles=standing,
    )
    return Blueprint(task, EnvConfig(**options), render_mode)


def _mission(layout: str | None, given: dict[str, Any]) -> dict[str, Any]:
    """Options of the task that a layout or the caller gives."""
    if layout is None:
        return {**given, **({"shapes": tuple(given["shapes"])} if "shapes" in given else {})}
    found = dict(LAYOUTS[check_name("layout", layout, LAYOUTS)])
    if given:
        raise ValueError(
            f"layout={layout!r} already says what is flown, but {', '.join(given)} are given too; "
            "give either"
        )
    return found


parallel_env = parallel_view(blueprint)
"""Make the environment with PettingZoo's parallel interface; options as of `blueprint`."""

env = aec_view(blueprint)
"""The same one agent at a time, with PettingZoo's AEC interface."""
