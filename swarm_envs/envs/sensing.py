"""What drones measure of the swarm: the true state, or that with white noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import kernel
from swarm_envs.noise import normal
from swarm_envs.state import BoolArray, IntArray, SwarmState

_PER_DRONE = 12


@kernel
def sense(
    state: SwarmState,
    noise: tuple[float, float, float, float],
    key: npt.NDArray[np.uint64],
    decisions: IntArray,
    mask: BoolArray,
    out: SwarmState,
) -> None:
    """Write the state as noisy sensors measure it; rotors and batteries are known.

    Args:
        state: the true one.
        noise: standard deviations per component of position (m), velocity (m/s), attitude (rad)
            and body rate (rad/s).
        key: (E,) streams of random numbers.
        decisions: (E,) how many decisions were flown: each is measured anew.
        mask: (E,) environments to measure.
        out: written.
    """
    drones = state.position.shape[1]
    for e in range(mask.shape[0]):
        if not mask[e]:
            continue
        for i in range(drones):
            at = (decisions[e] * drones + i) * _PER_DRONE
            turn = np.empty(3)
            for k in range(3):
                p, v = normal(key[e], np.uint64(at + k)), normal(key[e], np.uint64(at + 3 + k))
                w = normal(key[e], np.uint64(at + 9 + k))
                out.position[e, i, k] = state.position[e, i, k] + noise[0] * p
                out.velocity[e, i, k] = state.velocity[e, i, k] + noise[1] * v
                out.angular_velocity[e, i, k] = state.angular_velocity[e, i, k] + noise[3] * w
                turn[k] = 0.5 * noise[2] * normal(key[e], np.uint64(at + 6 + k))
            x, y, z, w = state.quaternion[e, i]
            q = out.quaternion[e, i]
            q[0] = x + turn[0] * w + turn[1] * z - turn[2] * y
            q[1] = y - turn[0] * z + turn[1] * w + turn[2] * x
            q[2] = z + turn[0] * y - turn[1] * x + turn[2] * w
            q[3] = w - turn[0] * x - turn[1] * y - turn[2] * z
            q /= np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            out.rotor_thrust[e, i] = state.rotor_thrust[e, i]
            out.battery[e, i] = state.battery[e, i]
