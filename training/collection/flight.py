"""One batch of flights: the loop, and what it logs at 120 Hz."""

from __future__ import annotations

import numpy as np

from swarm_envs.control.config import GAINS, ControllerConfig, PositionGains
from swarm_envs.control.tracking import TrackingController
from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray, Setpoint, SwarmState, hover_state
from swarm_envs.training.collection.fleet import Vehicles
from swarm_envs.training.collection.log import LOG_RATE, STEPS_PER_ENTRY, FlightLog, rotate_back
from swarm_envs.training.collection.motion import Motion
from swarm_envs.vehicles import GRAVITY, Team

FIRM = PositionGains(position=3.0, velocity=5.0, integral=1.0)
"""Stiffer than flights need, to hold place in wakes that the pilot does not know."""

PILOTS = {**GAINS, "firm": FIRM}
"""Position gains of a pilot by name: those of the controller, and firmer ones."""

_WIDTHS = (3, 3, 4, 3, 3, 4)  # of the arrays of a FlightLog


def fly(
    team: Team,
    motion: Motion,
    interactions: str | InteractionModel,
    duration_s: float,
    feedforward: InteractionModel | None = None,
    vehicles: Vehicles | None = None,
    pilot: str = "firm",
) -> list[FlightLog]:
    """Fly a motion in the environment and log it without noise.

    Args:
        team: the N vehicles.
        motion: of E teams.
        interactions: the force model that blows.
        duration_s: length of the flights, s.
        feedforward: the force that the pilot compensates for; None for no compensation.
        vehicles: what the drones really are; None for exactly their type.
        pilot: name of its position gains, see `PILOTS`.

    Returns:
        E logs; one ends before its team touches anything or tumbles.
    """
    envs, drones = motion.start.shape[:2]
    physics = BatchPhysics(team, envs, interactions)
    thrust_factor: FloatArray = np.ones((envs, drones, 1))
    if vehicles is not None:
        physics.parameters.mass[...] *= vehicles.mass_factor
        thrust_factor = vehicles.thrust_factor[..., None]
    gains = PILOTS[check_name("pilot", pilot, PILOTS)]
    tracker = TrackingController(team, envs, ControllerConfig(gains, feedforward))
    setpoint = Setpoint.hold(motion.start)
    state = physics.reset(hover_state(team, motion.start))
    entries = round(duration_s * LOG_RATE)
    log = FlightLog(*(np.empty((entries, envs, drones, width)) for width in _WIDTHS))
    length = np.full(envs, entries)
    before = state.velocity.copy()
    for k in range(entries):
        for step in range(STEPS_PER_ENTRY):
            target = motion.target((k + step / STEPS_PER_ENTRY) / LOG_RATE, state.position)
            for part, value in zip(setpoint, target, strict=False):
                part[...] = value
            commands = tracker.commands(state, setpoint)
            if step == 0:
                record(log, k, state, target.position, commands)
            now = state.velocity.copy()
            state = physics.step(thrust_factor * commands)
            if step == 0:  # the two steps around the entry
                log.specific_force[k] = (state.velocity - before) / (TIME_STEP * (2 if k else 1))
            before = now
            touched = (physics.contact | physics.contacts.tumbling).any(axis=1)
            length[touched] = np.minimum(length[touched], k)
    log.specific_force[..., 2] += GRAVITY
    log = log._replace(specific_force=rotate_back(log.quaternion, log.specific_force))
    flights = (FlightLog(*(array[:, e] for array in log)) for e in range(envs))
    return [flight.cut(int(count)) for flight, count in zip(flights, length, strict=True)]


def record(
    log: FlightLog, k: int, state: SwarmState, setpoint: FloatArray, commands: FloatArray
) -> None:
    """Write entry k of a batch's log (T, E, N, ...), but for its specific force."""
    log.position[k], log.velocity[k] = state.position, state.velocity
    log.quaternion[k], log.setpoint[k], log.commands[k] = state.quaternion, setpoint, commands
