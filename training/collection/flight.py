"""One batch of flights: the loop, and what it logs at 120 Hz."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from swarm_envs.control.config import ControllerConfig, PositionGains
from swarm_envs.control.state import Setpoint
from swarm_envs.control.tracking import TrackingController
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import FloatArray, SwarmState, hover_state
from swarm_envs.training.collection.motion import Motion
from swarm_envs.vehicles import Team

LOG_RATE = 120
"""Log entries per second: every second physics step."""

STEPS_PER_ENTRY = PHYSICS_RATE // LOG_RATE
"""Physics steps between log entries."""

GAINS = PositionGains(position=3.0, velocity=5.0, integral=1.0)
"""Of the pilot: stiffer than flights need, to hold place in wakes that it does not know."""


@dataclass(frozen=True)
class SensorNoise:
    """White noise on the logged state, standard deviations per component."""

    position_m: float = 2e-4
    """of a motion-capture system, m"""
    velocity: float = 0.01
    """of the state estimator, m/s"""
    attitude_rad: float = 3e-3
    """of the state estimator, rad"""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ValueError: a standard deviation is negative or not finite.
        """
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{entry.name} is {value}, but must be finite and not negative")


NO_NOISE = SensorNoise(0.0, 0.0, 0.0)
"""Perfect sensors."""


class FlightLog(NamedTuple):
    """What one flight of N drones recorded, T entries at `LOG_RATE`. World frame, SI units."""

    position: FloatArray
    """(T, N, 3) m."""
    velocity: FloatArray
    """(T, N, 3) m/s."""
    quaternion: FloatArray
    """(T, N, 4) attitude (x, y, z, w), body to world."""
    commands: FloatArray
    """(T, N, 4) rotor thrusts as commanded from this entry on, N; never those that act."""

    def cut(self, count: int) -> FlightLog:
        """Return the first `count` entries."""
        return FlightLog(*(array[:count] for array in self))


def fly(
    team: Team,
    motion: Motion,
    interactions: str | InteractionModel,
    duration_s: float,
) -> list[FlightLog]:
    """Fly a motion in the environment, uncompensated, and log it without noise.

    Args:
        team: the N vehicles.
        motion: of E teams.
        interactions: the force model that blows.
        duration_s: length of the flights, s.

    Returns:
        E logs; one ends before its team touches anything or tumbles.
    """
    envs, drones = motion.start.shape[:2]
    physics = BatchPhysics(team, envs, interactions)
    pilot = TrackingController(team, envs, ControllerConfig(gains=GAINS))
    setpoint = Setpoint.hold(motion.start)
    state = physics.reset(hover_state(team, motion.start))
    entries = round(duration_s * LOG_RATE)
    widths = (3, 3, 4, 4)
    log = FlightLog(*(np.empty((entries, envs, drones, width)) for width in widths))
    length = np.full(envs, entries)
    for k in range(entries):
        for step in range(STEPS_PER_ENTRY):
            target = motion.target((k + step / STEPS_PER_ENTRY) / LOG_RATE, state.position)
            for part, value in zip(setpoint, target, strict=False):
                part[...] = value
            commands = pilot.commands(state, setpoint)
            if step == 0:
                record(log, k, state, commands)
            state = physics.step(commands)
            touched = (physics.contact | physics.contacts.tumbling).any(axis=1)
            length[touched] = np.minimum(length[touched], k)
    flights = (FlightLog(*(array[:, e] for array in log)) for e in range(envs))
    return [flight.cut(int(count)) for flight, count in zip(flights, length, strict=True)]


def record(log: FlightLog, k: int, state: SwarmState, commands: FloatArray) -> None:
    """Write entry k of a batch's log (T, E, N, ...)."""
    log.position[k], log.velocity[k] = state.position, state.velocity
    log.quaternion[k], log.commands[k] = state.quaternion, commands


def with_noise(log: FlightLog, noise: SensorNoise, rng: np.random.Generator) -> FlightLog:
    """Return the log as noisy sensors would have written it."""
    shape = log.position.shape
    turn = 0.5 * noise.attitude_rad * rng.standard_normal(shape)
    small = np.concatenate([turn, np.ones((*shape[:-1], 1))], axis=-1)
    quaternion = multiply(small, log.quaternion)
    return log._replace(
        position=log.position + noise.position_m * rng.standard_normal(shape),
        velocity=log.velocity + noise.velocity * rng.standard_normal(shape),
        quaternion=quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True),
    )


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Product p q of quaternions (..., 4) in the order (x, y, z, w)."""
    a, b = p[..., :3], q[..., :3]
    s, t = p[..., 3:], q[..., 3:]
    vector = s * b + t * a + np.cross(a, b)
    return np.concatenate([vector, s * t - (a * b).sum(axis=-1, keepdims=True)], axis=-1)
