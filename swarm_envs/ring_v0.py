"""Ring, version 0: keep to a reference on intertwined rings, through each other's downwash.

    from swarm_envs import ring_v0
    env = ring_v0.parallel_env(num_drones=5, action="setpoint")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v0`. Here the
observed `task.goal` is where the reference is now.

**Teams.** 5 drones (the default, `S*S*S*LL`): three small ones on an upright circle, two large ones
on a level circle of the same radius, 0.55 m, at 0.65 m/s; a small one is at its lowest when a large
one is right above. 16 drones (`LSSLSS` and ten `S*`): two large and four small ones on a level
ellipse of 1.0 x 0.6 m, five and five on upright circles of 0.5 m at its tips, at 0.5 m/s. Any other
team flies by the same rule: see `swarm_envs.tasks.ring`. Sizes, speed and phases:
`rings=RingLayout(...)`.

**Start.** On the rings, at rest, phases locked, the whole team ahead by a flight time drawn from
0-60 s. Within 2 s the rate grows smoothly from rest. `reset(options={"start": ...})` starts
elsewhere; the reference stays where it is. Goals cannot be given.

**Success.** No collision until the clock ends, and after the first 2 s no drone ever 0.15 m or more
from its reference. Known, and rewarded, at the end of the clock.

**Rewards** (per drone, weights in `RingTask.reward_weights`): as in swap, with `tracking` in place
of `progress` and `at_goal`.

**End.** Terminated by a collision, the floor, a wall, an obstacle or tumbling (150 rad/s);
truncated by the clock, after 2 + 10 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Unpack

from swarm_envs.arguments import typed
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.options import (
    MOST_DRONES,
    Blueprint,
    EnvOptions,
    aec_view,
    check_common,
    parallel_view,
    refuse_unknown,
    team_of,
)
from swarm_envs.errors import check_integer, check_kind
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.tasks.ring import REWARD_WEIGHTS, RingTask, ring_team
from swarm_envs.tasks.rings import RingLayout
from swarm_envs.vehicles import Vehicle


@typed
def blueprint(
    *,
    num_drones: int = 5,
    team: str | Sequence[Vehicle] | None = None,
    rings: RingLayout | None = None,
    obstacles: Sequence[Obstacle] = (),
    reward_weights: Mapping[str, float] | None = None,
    render_mode: str | None = None,
    **options: Unpack[EnvOptions],
) -> Blueprint:
    """Make a ring environment: what every interface is made from.

    Args:
        num_drones: N drones, if no team is given: the paper's teams for 5 and 16, else small ones.
        team: the vehicles, or a string such as `"S*S*S*LL"`; overrides `num_drones`.
        rings: sizes, speed and phases of the rings.
        obstacles: what stands in the way: `Box` and `Column` of `swarm_envs.tasks.obstacles`.
        reward_weights: weight of each reward term; terms left out keep their default.
        render_mode: `rgb_array` (pictures), `human` (a window) or None.
        **options: those of every task; see `swarm_envs.envs.config.EnvConfig`.

    Raises:
        TypeError: an option does not exist (the message names the nearest), or has a wrong type.
        ValueError: an option has an impossible value, or the rings do not fit the team.
        ImportError: `physics="bullet"` without pybullet.
    """
    refuse_unknown(blueprint, options)
    weights, standing = check_common(reward_weights, obstacles)
    if rings is not None:
        check_kind("rings", rings, RingLayout, "RingLayout((0.6, 0.6), 0.6, speed_m_s=0.5)")
    if team is None:
        team = ring_team(check_integer("num_drones", num_drones, 1, MOST_DRONES))
    task = RingTask(
        team=team_of(team, num_drones),
        rings=rings,
        reward_weights={**REWARD_WEIGHTS, **weights},
        obstacles=standing,
    )
    return Blueprint(task, EnvConfig(**options), render_mode)


parallel_env = parallel_view(blueprint)
"""Make the environment with PettingZoo's parallel interface; options as of `blueprint`."""

env = aec_view(blueprint)
"""The same one agent at a time, with PettingZoo's AEC interface."""
