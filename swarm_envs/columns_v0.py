"""Columns, version 0: drones gather in vertical columns and stay in the downwash of those above.

    from swarm_envs import columns_v0
    env = columns_v0.parallel_env(layout="stack")

Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. By default drones fly in the
world `"hall"`, and each observes seven neighbors and, with `observe_load`, the thrust margin, mass
and charge of itself and of its neighbors.

**Layouts.** `stack`: eight small drones, half of them with a payload of 8 to 11 g, in two columns
of four places, 0.36 to 0.42 m apart. `sprint`: two large drones and a strong small one in each
column, in random order, 0.28 to 0.36 m apart.

**Start.** Next to the column, 0.6 m away in `stack` and 0.5 m in `sprint`, each drone at the height
of its first place. Gap, rotation, payload, which drones carry it, and starts are random.
`reset(options={"start": ...})` sets other starts. Goals cannot be set.

**Success.** `stack`: all places are occupied, within 0.06 m, for 1 s. Any drone may take any place:
a drone that reaches the place of another exchanges goals with it, so that `task.goal` is always a
place that no other drone has. The neighbors' goals show all places. `sprint`: every drone stays
within 0.03 m of its own place for 1 s. In both, without a collision.

**Rewards** (`parallel_env` lists terms and weights): as in swap.

**End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision, the
floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes are
terminated by success and truncated after 6 s in `stack` and 2 s in `sprint`.

**Versions.** v0: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import AirTaskOptions, task_views
from swarm_envs.errors import check_name
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.columns import COLUMN_LAYOUTS, ColumnsTask, column_team
from swarm_envs.vehicles import Team


@dataclass(frozen=True, kw_only=True)
class ColumnsOptions(AirTaskOptions):
    """Options of an environment with columns."""

    num_drones: int | None = None  # type: ignore[assignment]  # None: the layout's
    """N drones, if no team is given; None: 8 in `stack`, 6 in `sprint`."""
    layout: str = "stack"
    """The layout: `stack` or `sprint`."""
    gap_m: tuple[float, float] | None = None
    """Range of the vertical distance between places, m; None: the layout's."""
    payload_kg: tuple[float, float] | None = None
    """Range of the payload of half of each column's drones, kg; None: the layout's."""

    task_type = ColumnsTask

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        super().__post_init__()
        check_name("layout", self.layout, COLUMN_LAYOUTS)

    @property
    def vehicles(self) -> Team:
        """The team: as given, else the layout's."""
        return column_team(self.layout, self.num_drones) if self.team is None else super().vehicles

    def make_task(self) -> Task:
        """Columns as these options say."""
        return self.task_of(**COLUMN_LAYOUTS[self.layout])


blueprint, parallel_env, env = task_views(ColumnsOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
