"""Columns, version 0: gather in vertical columns and stay there, in the air of those above.

    from swarm_envs import columns_v0
    env = columns_v0.parallel_env(layout="stack")

Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. Drones fly in the world
`"hall"` unless another is asked for, and each observes seven neighbours, and with `observe_load`
what thrust it and they have to spare.

**Layouts.** `stack`: eight small drones, half of which carry 8 to 11 g, in two columns of four
places 0.36 to 0.42 m apart. `sprint`: two large ones and a strong small one in each column, in a
drawn order, 0.28 to 0.36 m apart.

**Start.** Beside the column, each at the height of its first place: 0.6 m beside in `stack`, 0.5 m
in `sprint`. Gap, turn, payload, who carries it and who starts where are drawn.
`reset(options={"start": ...})` starts elsewhere. Goals cannot be given.

**Success.** `stack`: all places are taken, within 0.06 m, for 1 s. Any drone may take any place:
one that comes to another's exchanges goals with it, so that `task.goal` is always a place that no
other drone has. All places are seen as the goals of the neighbours. `sprint`: every drone within
0.03 m of its own place for 1 s. In both, without a collision.

**Rewards** (per drone, weights in `ColumnsTask.reward_weights`): as in swap.

**End.** Who touches a drone, the floor, a wall or an obstacle, or tumbles (150 rad/s), has ended,
and the others fly on: see `on_contact`. Terminated when nobody is left, or at success; truncated by
the clock, after 6 s in `stack` and 2 s in `sprint`.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from swarm_envs.arguments import NOT_NEGATIVE, POSITIVE_M, Interval, OneOf, typed_options
from swarm_envs.envs.options import AirTaskOptions, NumDrones, task_views
from swarm_envs.tasks.columns import COLUMN_LAYOUTS, ColumnsTask, column_team
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.vehicles import Team


@typed_options
@dataclass(frozen=True, kw_only=True)
class ColumnsOptions(AirTaskOptions):
    """Options of an environment with columns."""

    num_drones: NumDrones | None = None  # type: ignore[assignment]  # None: the layout's
    """N drones, if no team is given; None: 8 in `stack`, 6 in `sprint`."""
    layout: Annotated[str, OneOf(tuple(COLUMN_LAYOUTS))] = "stack"
    """What has to be done: `stack` or `sprint`."""
    gap_m: Annotated[tuple[float, float], Interval(POSITIVE_M)] | None = None
    """Range of the vertical distance between places, m; None: the layout's."""
    payload_kg: Annotated[tuple[float, float], Interval(NOT_NEGATIVE)] | None = None
    """Range of what half of each column's drones carry, kg; None: the layout's."""

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    """Weight of each reward term that is not given."""

    @property
    def vehicles(self) -> Team:
        """The team: as given, else the layout's."""
        return column_team(self.layout, self.num_drones) if self.team is None else super().vehicles

    def make_task(self) -> ColumnsTask:
        """Columns as these options say."""
        given: dict[str, Any] = {"gap_m": self.gap_m, "payload_kg": self.payload_kg}
        given = {name: value for name, value in given.items() if value is not None}
        return ColumnsTask(
            team=self.vehicles,
            **{**COLUMN_LAYOUTS[self.layout], **given},
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(ColumnsOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
