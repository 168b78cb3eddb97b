"""Swap, version 0: drones change places through each other's downwash.

    from swarm_envs import swap_v0
    env = swap_v0.parallel_env(team="LS", layout="stacked", action="setpoint")

| | |
|---|---|
| Agents | `drone_0` ... `drone_{N-1}`, in the order of the team; all end together |
| `acceleration` | 3 in [-1, 1]: acceleration of a set-point along world x, y, z, in 5 m/s^2 |
| `velocity` | 3 in [-1, 1]: velocity of a set-point along world x, y, z, in 2 m/s |
| `ctbr` | 4 in [-1, 1]: collective thrust, from none to the largest; body rates, in 8, 8, 4 rad/s |
| `rotors` | 4 in [-1, 1]: thrust of each rotor, from none to the largest |
| `setpoint` | 14, SI, world frame: position, velocity, acceleration, jerk, yaw, yaw rate |
| Observations | float32 row; `env.observation_layout` has name, place, unit, scale of each field |
| Arena | 4 x 4 x 2.5 m, grown with (N / 16)^(1/3) above 16 drones |

World frame: x, y horizontal, z up, metres. A drone follows its set-point, whose acceleration lags
what is asked for by 0.1 s and whose speed stays within 2 m/s. Rotors: front right, back right, back
left, front left; the first and the third turn counter-clockwise. Yaw in rad. What is observed is
the number in the row times its field's scale.

**Start.** `random`: starts at least 0.5 m apart, 0.5-2.0 m high, each drone's goal is another's
start. `stacked`: on a circle of radius 0.5-0.75 m seen from above, in planes 0.2-0.3 m apart, the
lowest at 0.8 m, the first of the team on top; straight to the opposite side in 3-4 s, all aligned
half way. `circle`: evenly spaced on a circle of radius 1.5 m (more where neighbours would be less
than 0.3 m apart), all 1.0 m high; each drone's goal is the opposite point.

**Success.** Every drone within 0.10 m of its goal for 0.5 s, without a collision.

**Rewards** (per drone, weights in `SwapTask.reward_weights`): `progress`, `at_goal`, `tracking`,
`effort`, `proximity`, `crash`, `success`; each bounded, each in `infos[agent]["reward_terms"]`; see
`swarm_envs.tasks.rewards.write_terms`. Returns do not depend on the decision rate.

**End.** Terminated by a collision, the floor, a wall, an obstacle, tumbling (150 rad/s) or
success; truncated by the clock, after 8 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Unpack

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
from swarm_envs.errors import check_kind
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.tasks.swap import REWARD_WEIGHTS, CircleLayout, StackedLayout, SwapTask
from swarm_envs.vehicles import Vehicle


@typed
def blueprint(
    *,
    num_drones: int = 4,
    team: str | Sequence[Vehicle] | None = None,
    layout: str = "random",
    stacked: StackedLayout | None = None,
    circle: CircleLayout | None = None,
    obstacles: Sequence[Obstacle] = (),
    reward_weights: Mapping[str, float] | None = None,
    render_mode: str | None = None,
    **options: Unpack[EnvOptions],
) -> Blueprint:
    """Make a swap environment: what every interface is made from.

    Args:
        num_drones: N small drones, if no team is given.
        team: the vehicles, or a string such as `"SSL"`; overrides `num_drones`.
        layout: `random`, `circle` or `stacked`.
        stacked: ranges from which the stacked layout is drawn.
        circle: size of the circle layout.
        obstacles: what stands in the way: `Box` and `Column` of `swarm_envs.tasks.obstacles`.
        reward_weights: weight of each reward term; terms left out keep their default.
        render_mode: `rgb_array` (pictures), `human` (a window) or None.
        **options: those of every task: physics, interactions, action, decision_rate, force_rate,
            precision, controller, observation, num_neighbors, num_obstacles, horizon_s,
            end_on_success, battery, randomization, deterministic, force_bounds_g; see
            `swarm_envs.envs.config.EnvConfig`.

    Raises:
        TypeError: an option does not exist (the message names the nearest), or has a wrong type.
        ValueError: an option has an impossible value.
        ImportError: `physics="bullet"` without pybullet.
    """
    refuse_unknown(blueprint, options)
    weights, standing = check_common(reward_weights, obstacles)
    if stacked is not None:
        check_kind("stacked", stacked, StackedLayout, "StackedLayout(duration_s=(4.0, 4.0))")
    if circle is not None:
        check_kind("circle", circle, CircleLayout, "CircleLayout(radius_m=1.2)")
    task = SwapTask(
        team=team_of(team, num_drones),
        layout=layout,
        stacked=stacked or StackedLayout(),
        circle=circle or CircleLayout(),
        reward_weights={**REWARD_WEIGHTS, **weights},
        obstacles=standing,
    )
    return Blueprint(task, EnvConfig(**options), render_mode)


parallel_env = parallel_view(blueprint)
"""Make the environment with PettingZoo's parallel interface; options as of `blueprint`."""

env = aec_view(blueprint)
"""The same one agent at a time, with PettingZoo's AEC interface."""
