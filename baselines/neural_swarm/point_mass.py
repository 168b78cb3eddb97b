"""The plant that Theorem 5 of Neural-Swarm2 assumes, under this package's position controller.

A point mass feels the desired force f_d of eqs. (18) and (19) at once. A model error is planted:
the air pushes with eps_f, and the controller believes that it does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.neural_swarm.plain import UP, PlainTrackingController, Target
from swarm_envs.control.config import ControllerConfig
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAVITY, Vehicle

UNCLAMPED = 1e6
"""Clamp of the integral, m, that stands for none."""


def without_clamp(config: ControllerConfig) -> ControllerConfig:
    """The same controller as the theorem has it: nothing limits the integral."""
    return replace(config, velocity_integral_limit=UNCLAMPED)


def fly_point_mass(
    vehicle: Vehicle,
    config: ControllerConfig,
    force_error: FloatArray,
    dt: float,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
    velocity_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Let a point mass hold a place against a planted model error.

    The law's errors do not depend on the reference: what is found at rest holds on any.

    Args:
        vehicle: its mass is what flies.
        config: gains and clamps; see `without_clamp`.
        force_error: (T, 3) eps_f = f_a - f_hat in each step, N.
        dt: length of a step, s; the force is held over it and the motion exact.
        position_error: (3,) p - p_d at the start, m.
        velocity_error: (3,) its derivative at the start, m/s.

    Returns:
        (T + 1, 3) position errors, m, from the start on.
    """
    controller = PlainTrackingController(vehicle, config, dt)
    target, nothing = Target(np.zeros(3)), np.zeros(3)
    position, velocity = (np.array(x, dtype=np.float64) for x in (position_error, velocity_error))
    errors = np.empty((len(force_error) + 1, 3))
    errors[0] = position
    for k, push in enumerate(force_error):
        desired = controller.desired_force(position, velocity, target, nothing)
        acceleration = (desired + push) / vehicle.mass - GRAVITY * UP
        position = position + dt * velocity + 0.5 * dt**2 * acceleration
        velocity = velocity + dt * acceleration
        errors[k + 1] = position
    return errors
