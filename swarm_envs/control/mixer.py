"""From a wrench to rotor thrusts: the inverse of the X mixer, with priorities when it saturates.

Rotors: 1 front right, 2 back right, 3 back left, 4 front left; body x forward, y left, z up.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.errors import check_array
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Vehicle


@borrowing_kernel
def mix_row(
    thrust: float,
    torque: FloatArray,
    max_rotor_thrust: float,
    rotor_offset: float,
    thrust_to_torque: float,
    out: FloatArray,
) -> None:
    """Write the rotor thrusts of one drone that give a wrench, each in [0, max_rotor_thrust].

    A wrench that the rotors can give is given exactly. Otherwise parts of it are given up in the
    order yaw, thrust, roll and pitch: yaw is scaled down as far as the rest needs; if that is not
    enough the thrust is shifted, as little as possible; only when roll and pitch alone ask for
    more than the rotors' range are they scaled, both alike.

    Args:
        thrust: total thrust T, N.
        torque: (3,) torque in the body frame, N m.
        max_rotor_thrust: largest thrust of one rotor, N.
        rotor_offset: distance of each rotor from the body x and y axes, m.
        thrust_to_torque: yaw torque per newton of rotor thrust, m.
        out: (4,) receives the rotor thrusts, N.
    """
    mix_scalars(
        thrust,
        torque[0],
        torque[1],
        torque[2],
        max_rotor_thrust,
        rotor_offset,
        thrust_to_torque,
        out,
    )


@borrowing_kernel
def mix_scalars(
    thrust: float,
    torque_x: float,
    torque_y: float,
    torque_z: float,
    max_rotor_thrust: float,
    rotor_offset: float,
    thrust_to_torque: float,
    out: FloatArray,
) -> None:
    """Do what `mix_row` does, with the torque given as three numbers."""
    # Rotors 1 and 3 take opposite shares of roll and pitch, and so do 2 and 4.
    diagonal_1 = -(torque_x + torque_y) / (4.0 * rotor_offset)
    diagonal_2 = (torque_y - torque_x) / (4.0 * rotor_offset)
    largest = max(abs(diagonal_1), abs(diagonal_2))
    if 2.0 * largest > max_rotor_thrust:
        scale = 0.5 * max_rotor_thrust / largest
        diagonal_1 *= scale
        diagonal_2 *= scale
        largest = 0.5 * max_rotor_thrust

    # Positive yaw takes thrust from rotors 1 and 3 and gives it to 2 and 4, so it narrows the range
    # of thrusts that fit on one side and may widen it on the other.
    yaw = torque_z / (4.0 * thrust_to_torque)
    losing, gaining = abs(diagonal_1), abs(diagonal_2)
    if yaw < 0.0:
        losing, gaining = gaining, losing
    size = abs(yaw)
    lowest = largest - min(max(0.5 * (gaining - losing), 0.0), size)
    highest = max_rotor_thrust - largest + min(max(0.5 * (losing - gaining), 0.0), size)
    base = min(max(0.25 * thrust, lowest), highest)
    size = max(min(size, base - losing, max_rotor_thrust - gaining - base), 0.0)
    yaw = math.copysign(size, yaw)

    out[0] = min(max(base + diagonal_1 - yaw, 0.0), max_rotor_thrust)
    out[1] = min(max(base + diagonal_2 + yaw, 0.0), max_rotor_thrust)
    out[2] = min(max(base - diagonal_1 - yaw, 0.0), max_rotor_thrust)
    out[3] = min(max(base - diagonal_2 + yaw, 0.0), max_rotor_thrust)


def mix(vehicle: Vehicle, thrust: float, torque: npt.ArrayLike) -> FloatArray:
    """Rotor thrusts (4,), N, that give a vehicle a thrust, N, and a (3,) body torque, N m.

    Thrusts lie in [0, max_rotor_thrust]; see `mix_row` for what is given up first.

    Raises:
        ValueError: the torque is not three finite numbers, or the thrust is not finite.
    """
    total = float(check_array("thrust", thrust, ()))
    moment = check_array("torque", torque, (3,), "roll, pitch, yaw in N m")
    out = np.empty(4)
    offset = vehicle.arm / np.sqrt(2.0)
    mix_row(total, moment, vehicle.max_rotor_thrust, offset, vehicle.thrust_to_torque, out)
    return out


def wrench(vehicle: Vehicle, rotor_thrust: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Total thrust (...,), N, and body torque (..., 3), N m, of rotor thrusts (..., 4), N."""
    f1, f2, f3, f4 = np.moveaxis(np.asarray(rotor_thrust, dtype=np.float64), -1, 0)
    offset = vehicle.arm / np.sqrt(2.0)
    torque = np.stack(
        [
            offset * (-f1 - f2 + f3 + f4),
            offset * (-f1 + f2 + f3 - f4),
            vehicle.thrust_to_torque * (-f1 + f2 - f3 + f4),
        ],
        axis=-1,
    )
    return f1 + f2 + f3 + f4, torque
