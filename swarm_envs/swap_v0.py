"""Swap, version 0: drones change places through each other's downwash.

    from swarm_envs import swap_v0
    env = swap_v0.parallel_env(team="LS", layout="stacked", action="setpoint")

| | |
|---|---|
| Agents | `drone_0` ... `drone_{N-1}`, in the order of the team; all end together |
| `acceleration` | 3 in [-1, 1]: acceleration of a set-point along world x, y, z, in 5 m/s^2 |
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
half way.

**Success.** Every drone within 0.10 m of its goal for 0.5 s, without a collision.

**Rewards** (per drone, weights in `SwapTask.reward_weights`): `progress`, `at_goal`, `tracking`,
`effort`, `proximity`, `crash`, `success`; each bounded, each in `infos[agent]["reward_terms"]`; see
`swarm_envs.tasks.swap.write_swap_terms`. Returns do not depend on the decision rate.

**End.** Terminated by a collision, the floor, a wall, tumbling (150 rad/s) or success; truncated by
the clock, after 8 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.options import refuse_unknown, team_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_kind
from swarm_envs.interactions import InteractionModel
from swarm_envs.motors import BatteryModel
from swarm_envs.tasks.swap import REWARD_WEIGHTS, StackedLayout, SwapTask
from swarm_envs.vehicles import Vehicle


def parallel_env(
    *,
    num_drones: int = 4,
    team: str | Sequence[Vehicle] | None = None,
    layout: str = "random",
    physics: str | None = None,
    interactions: str | Path | InteractionModel = "learned",
    action: str = "acceleration",
    decision_rate: int = 48,
    force_rate: int = 240,
    controller: ControllerConfig | None = None,
    num_neighbors: int = 3,
    horizon_s: float = 8.0,
    end_on_success: bool = True,
    battery: BatteryModel | None = None,
    stacked: StackedLayout | None = None,
    reward_weights: Mapping[str, float] | None = None,
    render_mode: str | None = None,
    **unknown: object,
) -> SwarmParallelEnv:
    """Make a swap environment with PettingZoo's parallel interface.

    Args:
        num_drones: N small drones, if no team is given.
        team: the vehicles, or a string such as `"SSL"`; overrides `num_drones`.
        layout: `random` or `stacked`.
        physics: `bullet`, `batch`, or None for Bullet where it can be imported.
        interactions: the force model that blows: `none`, `wake`, `learned`, a path or a model.
        action: `acceleration`, `rotors` or `setpoint`.
        decision_rate: actions per second, 240 over an integer.
        force_rate: evaluations of the interaction force per second, 240 over an integer.
        controller: configuration of the tracking loop between actions and rotors.
        num_neighbors: how many neighbours a drone observes.
        horizon_s: the clock, s.
        end_on_success: whether success ends the episode.
        battery: how batteries empty; None for batteries that never do.
        stacked: ranges from which the stacked layout is drawn.
        reward_weights: weight of each reward term; terms left out keep their default.
        render_mode: `rgb_array` or None.
        **unknown: refused, with the nearest name.

    Raises:
        TypeError: an option does not exist.
        ValueError: an option has an impossible value.
        ImportError: `physics="bullet"` without pybullet.
    """
    refuse_unknown(parallel_env, unknown)
    config = EnvConfig(
        physics=physics,
        interactions=interactions,
        action=action,
        decision_rate=decision_rate,
        force_rate=force_rate,
        controller=controller,
        num_neighbors=num_neighbors,
        horizon_s=horizon_s,
        end_on_success=end_on_success,
        battery=battery,
    )
    if stacked is not None:
        check_kind("stacked", stacked, StackedLayout, "StackedLayout(duration_s=(4.0, 4.0))")
    if reward_weights is not None:
        check_kind("reward_weights", reward_weights, Mapping, "{'success': 5.0}")
    task = SwapTask(
        team=team_of(team, num_drones),
        layout=layout,
        stacked=stacked or StackedLayout(),
        reward_weights={**REWARD_WEIGHTS, **(reward_weights or {})},
    )
    return SwarmParallelEnv(task, config, render_mode)
