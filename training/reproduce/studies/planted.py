"""Model errors to plant, bounded in size and rate, and the quadrotor that flies with them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.control.config import ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.errors import check_array
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.vehicles import Vehicle

_TURN_S = 0.7
"""Mean time for which a random error goes in one direction, s."""


def growing_error(
    steps: int, rate: float, direction: npt.ArrayLike = (0.0, 0.0, -1.0), dt: float = TIME_STEP
) -> FloatArray:
    """(steps, 3) an error that grows as fast as it may, N: the worst for Theorem 5.

    Args:
        steps: of dt seconds.
        rate: its rate of change, N/s.
        direction: (3,) where it points; by default down.
        dt: length of a step, s.
    """
    unit = np.asarray(direction, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    return np.asarray(rate * dt * np.arange(steps)[:, None] * unit)


def random_errors(
    rng: np.random.Generator,
    flights: int,
    steps: int,
    size: float,
    rate: float,
    dt: float = TIME_STEP,
) -> FloatArray:
    """Errors that always change at their largest rate, in directions that turn at random.

    Args:
        rng: source of the directions.
        flights: E.
        steps: T, of dt seconds.
        size: largest norm, N.
        rate: norm of the rate of change, N/s; at the edge of the ball of `size` it points inwards.
        dt: length of a step, s.

    Returns:
        (E, T, 3) N.
    """
    errors = np.zeros((flights, steps, 3))
    heading = _directions(rng, flights)
    for k in range(1, steps):
        turns = rng.random(flights) < dt / _TURN_S
        heading[turns] = _directions(rng, int(turns.sum()))
        last = errors[:, k - 1]
        outside = np.linalg.norm(last + rate * dt * heading, axis=1) > size
        heading[outside] = -last[outside] / np.linalg.norm(last[outside], axis=1, keepdims=True)
        errors[:, k] = last + rate * dt * heading
    return errors


def _directions(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) unit vectors, uniform on the sphere."""
    vectors = rng.standard_normal((count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def fly_quadrotors(
    vehicle: Vehicle,
    config: ControllerConfig,
    force_errors: FloatArray,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Let E quadrotors hold a place in still air while their controllers believe in -eps_f.

    Attitude, rotor lag and limits of the thrust are those of the package's engine, at 240 Hz.

    Args:
        vehicle: what flies.
        config: of the tracking controller.
        force_errors: (E, T, 3) planted model errors eps_f, N.
        position_error: (3,) p - p_d at the start, m.

    Returns:
        (E, T + 1, 3) position errors, m.

    Raises:
        ValueError: the errors have another shape, or are not finite.
    """
    shape = (*np.shape(force_errors)[:2], 3)
    errors = check_array("force_errors", force_errors, shape, "(E, T, 3), newton")
    flights, steps = shape[:2]
    place = np.tile([0.0, 0.0, 100.0], (flights, 1, 1))  # where no ground is near
    physics = BatchPhysics((vehicle,), flights, "none")
    controller = TrackingController((vehicle,), flights, config)
    setpoint = Setpoint.hold(place)
    state = physics.reset(hover_state((vehicle,), place + np.asarray(position_error)))
    found = np.empty((flights, steps + 1, 3))
    found[:, 0] = position_error
    for k in range(steps):
        commands = controller.commands(state, setpoint, -errors[:, None, k])
        state = physics.step(commands)
        found[:, k + 1] = (state.position - place)[:, 0]
    return found
