"""Gates, version 0: a slalom in vertical formation, through each gate all at once.

from swarm_envs import gates_v0
env = gates_v0.parallel_env(team="LSS")
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from swarm_envs.arguments import POSITIVE_M, Interval, OneOf, typed_options
from swarm_envs.envs.config import WORLDS
from swarm_envs.envs.options import NumDrones, TaskOptions, task_views
from swarm_envs.hall import Hall
from swarm_envs.physics.contact import ON_CONTACT
from swarm_envs.tasks.base import ByScore
from swarm_envs.tasks.gates import REWARD_WEIGHTS, GatesTask


@typed_options
@dataclass(frozen=True, kw_only=True)
class GatesOptions(TaskOptions):
    """Options of a gates environment."""

    num_drones: NumDrones = 3
    """N small drones, if no team is given."""
    gap_m: Annotated[tuple[float, float], Interval(POSITIVE_M)] = (0.3, 0.4)
    """Range from which the vertical distance of neighbours in the column is drawn, m."""
    radius_m: Annotated[float, POSITIVE_M] = 0.05
    """How near to their places in a gate all must be at once, m."""
    world: Annotated[str, OneOf(WORLDS)] | Hall = "hall"
    """`ideal`, `hall` or a `Hall` of your own; see `EnvConfig`."""
    on_contact: Annotated[str, OneOf(ON_CONTACT)] = "end_pair"
    """What touching something ends: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    task_type: ClassVar[type[GatesTask]] = GatesTask
    """What `make_task` makes."""

    def make_task(self) -> GatesTask:
        """Gates as these options say."""
        return self.task_type(
            team=self.vehicles,
            gap_m=self.gap_m,
            success=ByScore(radius=self.radius_m, least=0.0),
            reward_weights={**REWARD_WEIGHTS, **(self.reward_weights or {})},
            obstacles=tuple(self.obstacles),
        )


blueprint, parallel_env, env = task_views(GatesOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
