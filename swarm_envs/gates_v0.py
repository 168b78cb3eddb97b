"""Gates, version 0: a team flies a slalom in vertical formation, passing each gate together.

    from swarm_envs import gates_v0
    env = gates_v0.parallel_env(team="LSS")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`;
`task.goal` is the drone's place in the next gate. The default world is `"hall"`.

**Gates.** Four gates, 0.8 m apart along x, alternate between 0.4 m left and right. Each is a gap of
0.7 m between two posts of radius 0.05 m, which are obstacles. The team flies through them in both
directions.

**Start.** A column before the first gate, at either end. The order of drones in the column, their
vertical distance (0.3-0.4 m) and the height of the lowest place in each gate (0.4-0.8 m) are
random. `reset(options={"start": ...})` sets other starts. Goals cannot be set.

**Passing a gate.** A gate is passed on the step on which every drone that still flies is within
0.05 m of its place in it; the goals are then the places in the next gate.

**Success.** All eight gates are passed within the time limit, without a crash. The score is
`gates_per_min`: gates passed per minute until the last one, or of the whole episode length if not
all were passed. A gate that part of the team passed counts for that part.

**Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is 1/8 for each gate.

**End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision, the
floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes are
terminated by success and truncated after 30 s.

**Versions.** v0: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.errors import check_number
from swarm_envs.hall import Hall
from swarm_envs.tasks.base import ByScore, Task
from swarm_envs.tasks.gates import GatesTask


@dataclass(frozen=True, kw_only=True)
class GatesOptions(TaskOptions):
    """Options of a gates environment."""

    num_drones: int = 3
    """N small drones, if no team is given."""
    gap_m: tuple[float, float] = (0.3, 0.4)
    """Range from which the vertical distance of neighbours in the column is drawn, m."""
    radius_m: float = 0.05
    """Largest distance of all drones from their places in a gate, m."""
    world: str | Hall = "hall"
    """`ideal`, `hall` or a custom `Hall`; see `EnvConfig`."""
    on_contact: str = "end_pair"
    """Effect of a contact: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    task_type = GatesTask

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        super().__post_init__()
        check_number("radius_m", self.radius_m, above=0.0, unit="m")

    def make_task(self) -> Task:
        """Gates as these options say."""
        return self.task_of(success=ByScore(radius=self.radius_m, least=0.0))


blueprint, parallel_env, env = task_views(GatesOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
