"""Gates, version 0: a slalom in vertical formation, through each gate all at once.

    from swarm_envs import gates_v0
    env = gates_v0.parallel_env(team="LSS")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; the observed
`task.goal` is the drone's place in the next gate.

**Gates.** Four, 0.8 m apart along x, in turn 0.4 m left and right; each is a way between two posts
of radius 0.05 m, 0.7 m apart, which are obstacles. They are flown through there and back.

**Start.** A column before the first gate, at either end; drawn are the order of the drones in it,
their vertical distance, 0.3-0.4 m, and how high the lowest is in each gate, 0.4-0.8 m. Starts may
be given, goals not.

**Gate by gate.** A gate is passed at the decision at which every drone that still flies is within
0.05 m of its place in it; then the places in the next gate are the goals.

**Success.** All eight gates within the clock, nobody hurt. The score is `gates_per_min`: gates
passed, those that a part of the team passed counting for that part, over the time until the last
one, or over the whole clock if not all were passed.

**Rewards** (per drone, weights in `GatesTask.reward_weights`): the terms of swap; `success` is 1/8
for each gate.

**End.** Terminated by success. A drone that collides, tumbles (150 rad/s), or touches the floor, a
wall or an obstacle is terminated, and the others fly on (`on_contact="end_pair"`); the clock
truncates all, after 30 s. `world="hall"` is the default.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping
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

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    task_type: ClassVar[type[GatesTask]] = GatesTask
    """What `make_task` makes."""

    def make_task(self) -> GatesTask:
        """Gates as these options say."""
        return self.task_type(
            team=self.vehicles,
            gap_m=self.gap_m,
            success=ByScore(radius=self.radius_m, least=0.0),
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(GatesOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
