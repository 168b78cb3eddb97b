"""The kernel of resets, for both engines."""

from __future__ import annotations

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.motors import limit_rotors
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tables import RESET_COLUMNS, RESET_VALUES, Records


@kernel
def begin_flight(
    where: IntArray,
    at_rest: bool,
    drones: Records,
    columns: FloatArray,
    settings: Records,
    open_circuit: FloatArray,
) -> None:
    """Reset the drones of these environments (M,).

    With `at_rest`, they are at rest at their `start`, with rotors at hover thrust and their
    `charge`; a drone that starts at its goal has arrived. Otherwise their state was set before.
    `columns` (E, N, columns) is the memory of the drones, `open_circuit` (K,) that of `voltage`.
    """
    for e in where:
        for i in range(drones.shape[1]):
            d = drones[e, i]
            for k in range(len(RESET_COLUMNS)):
                columns[e, i, RESET_COLUMNS[k]] = RESET_VALUES[k]
            if at_rest:
                for k in range(3):
                    d.position[k] = d.start[k]
                    d.velocity[k] = d.angular_velocity[k] = d.quaternion[k] = 0.0
                for k in range(4):
                    d.rotor_thrust[k] = d.hover_thrust
                d.quaternion[3], d.battery = 1.0, d.charge
                x, y, z = d.goal[0] - d.start[0], d.goal[1] - d.start[1], d.goal[2] - d.start[2]
                d.distance = np.sqrt(x * x + y * y + z * z)
                if d.distance < settings[0].success_radius:
                    d.arrival = 0.0
            square = total = 0.0
            for k in range(4):
                square += d.quaternion[k] * d.quaternion[k]
                total += d.rotor_thrust[k]
            for k in range(4):  # normalize quaternions, as Bullet does
                d.quaternion[k] /= np.sqrt(square)
                d.commands[k] = d.rotor_thrust[k]
                d.ctbr[k] = 0.0
            for k in range(3):
                d.setpoint_position[k] = d.position[k]
            d.ctbr[0], d.rotor_limit = total, d.max_rotor_thrust
            d.motor_decay = np.exp(-d.motor_rate * TIME_STEP)
            if settings[0].drains and d.battery < 1.0:
                d.rotor_limit = limit_rotors(d.battery, total, d, settings[0], open_circuit)
