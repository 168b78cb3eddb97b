"""Swap, version 1: drones change places through each other's downwash.

    from swarm_envs import swap_v1
    env = swap_v1.parallel_env(team="LS", layout="stacked", action="setpoint")

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

**Versions.** v1: the force model `learned` sums pairs of drones, so it stays physical in crowds;
returns do not depend on the clock. v0: forces (`learned-v0`) and rewards of release 0.1.0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from swarm_envs.arguments import typed_options
from swarm_envs.envs.options import NumDrones, TaskOptions, task_views
from swarm_envs.tasks.swap import REWARD_WEIGHTS, CircleLayout, Layout, StackedLayout, SwapTask


@typed_options
@dataclass(frozen=True, kw_only=True)
class SwapOptions(TaskOptions):
    """Options of a swap environment."""

    num_drones: NumDrones = 4
    """N small drones, if no team is given."""
    layout: Layout = "random"
    """Where drones start: `random`, `stacked` or `circle`."""
    stacked: StackedLayout | None = None
    """What the stacked layout is drawn from."""
    circle: CircleLayout | None = None
    """What the circle layout is made of."""

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    task_type: ClassVar[type[SwapTask]] = SwapTask
    """What `make_task` makes."""

    def make_task(self) -> SwapTask:
        """Swaps as these options say."""
        return self.task_type(
            team=self.vehicles,
            layout=self.layout,
            stacked=self.stacked or StackedLayout(),
            circle=self.circle or CircleLayout(),
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(SwapOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
