"""From a wrench to rotor thrusts: the inverse of the X mixer, with priorities when it saturates.

Rotors: 1 front right, 2 back right, 3 back left, 4 front left; body x forward, y left, z up.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.control.loop import mix_rotors
from swarm_envs.errors import check_array
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Vehicle


def mix(vehicle: Vehicle, thrust: float, torque: npt.ArrayLike) -> FloatArray:
    """Rotor thrusts (4,), N, that give a vehicle a thrust, N, and a (3,) body torque, N m.

    Thrusts lie in [0, max_rotor_thrust]; see `mix_rotors` for what is given up first.

    Raises:
        ValueError: the torque is not three finite numbers, or the thrust is not finite.
    """
    total = float(check_array("thrust", thrust, ()))
    moment = check_array("torque", torque, (3,), "roll, pitch, yaw in N m").tolist()
    offset = float(vehicle.arm / np.sqrt(2.0))
    x, y, z = moment
    limits = (vehicle.max_rotor_thrust, offset, vehicle.thrust_to_torque)
    return np.array(list(mix_rotors(total, x, y, z, *limits)))


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
