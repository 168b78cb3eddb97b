"""Swap, version 1: drones swap places through each other's downwash.

    from swarm_envs import swap_v1
    env = swap_v1.parallel_env(team="LS", layout="stacked", action="setpoint")

| | |
|---|---|
| Agents | `drone_0` ... `drone_{N-1}`, in the order of the team; see `on_contact` for their ends |
| `acceleration` | 3 in [-1, 1]: acceleration of a set-point along world x, y, z, times 5 m/s^2 |
| `velocity` | 3 in [-1, 1]: velocity of a set-point along world x, y, z, times 2 m/s |
| `ctbr` | 4 in [-1, 1]: collective thrust, from zero to maximum; body rates times 8, 8, 4 rad/s |
| `rotors` | 4 in [-1, 1]: thrust of each rotor, from zero to maximum |
| `setpoint` | 14, SI, world frame: position, velocity, acceleration, jerk, yaw, yaw rate |
| Observations | float32 row; `env.observation_layout`: name, slice, unit and scale of each field |
| Arena | 4 x 4 x 2.5 m, grown with (N / 16)^(1/3) above 16 drones |

World frame: x and y are horizontal, z points up, metres. In `acceleration` and `velocity` the drone
tracks a set-point, whose acceleration follows the action with a lag of 0.1 s and whose speed is at
most 2 m/s. Rotors: front right, back right, back left, front left; the first and the third turn
counter-clockwise. Yaw in rad. An observed quantity is the number in the row times its field's
scale.

**Start.**

- `random`: at least 0.5 m apart, 0.5-2.0 m high. Each drone's goal is the start of another drone.
- `circle`: evenly spaced on a circle of radius 1.5 m (larger where neighbors would be less than
  0.3 m apart), 1.0 m high. Each goal is the opposite point.
- `stacked`, the flight test of Neural-Swarm2 (Sec. VII-E): on a circle of radius 0.5-0.75 m, in
  planes 0.2-0.3 m apart, the lowest at 0.8 m, the first drone of the team on top. The reference
  leads straight to the opposite side in 3-4 s, so that drones are above each other half way.

**Success.** Every drone stays within 0.10 m of its goal for 0.5 s, without a collision.

**Rewards** (`parallel_env` lists terms and weights): each drone gets the weighted sum of bounded
terms, which `infos[agent]["reward_terms"]` contains; `reward_weights={"effort": -0.5}` changes a
weight.

**End.** The episode is terminated by a collision, the floor, a wall, an obstacle, tumbling (150
rad/s) or success. It is truncated after 8 s.

**Versions.** v1: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.tasks.swap import CircleLayout, Layout, StackedLayout, SwapTask


@dataclass(frozen=True, kw_only=True)
class SwapOptions(TaskOptions):
    """Options of a swap environment."""

    num_drones: int = 4
    """N small drones, if no team is given."""
    layout: Layout = "random"
    """Where drones start: `random`, `stacked` or `circle`."""
    stacked: StackedLayout | None = None
    """Ranges of the stacked layout."""
    circle: CircleLayout | None = None
    """Size of the circle layout."""

    task_type = SwapTask


blueprint, parallel_env, env = task_views(SwapOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
