"""The simulation of a batch of flights, logged at 120 Hz.

All teams consist of vehicles of one fleet: the second small drone of any team is always the vehicle
`S2`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from swarm_envs.control.config import GAINS, ControllerConfig, PositionGains
from swarm_envs.control.tracking import TrackingController
from swarm_envs.errors import check_name
from swarm_envs.hall import Hall
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.hall_lanes import sense_in_hall
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.reference import inverse, rotate
from swarm_envs.state import Setpoint, SwarmState, hover_state, state_of
from swarm_envs.tables import SENSED_TYPE
from swarm_envs.training.collection.log import LOG_RATE, STEPS_PER_ENTRY, FlightLog
from swarm_envs.training.collection.motion import TeamMotion
from swarm_envs.vehicles import GRAVITY, VEHICLES, Team

__all__ = ["vehicle_ids", "vehicle_names"]

_PER_TYPE = 100


def vehicle_names(team: Team) -> tuple[str, ...]:
    """Return the names of the vehicles of a team, such as `S1`, `S2`, `L1` of `SSL`."""
    seen = Counter[str]()
    names = []
    for vehicle in team:
        seen[vehicle.token] += 1
        names.append(f"{vehicle.token}{seen[vehicle.token]}")
    return tuple(names)


def vehicle_ids(team: Team) -> tuple[int, ...]:
    """Return the numbers of the vehicles of a team in the fleet, such as 1, 2, 101 of `SSL`."""
    tokens = list(VEHICLES)
    return tuple(
        _PER_TYPE * tokens.index(vehicle.token) + int(name.removeprefix(vehicle.token))
        for vehicle, name in zip(team, vehicle_names(team), strict=True)
    )


FIRM = PositionGains(position=3.0, velocity=5.0, integral=1.0)
"""High gains, to hold the position in the wakes of other drones."""

PILOTS = {**GAINS, "firm": FIRM}
"""Position gains by name: the presets of the controller, and `FIRM`."""

_WIDTHS = (3, 3, 4, 3, 3, 4)  # Widths of the arrays of a FlightLog


def fly_motion(
    team: Team,
    motion: TeamMotion,
    interactions: str | InteractionModel,
    duration_s: float,
    feedforward: InteractionModel | None = None,
    pilot: str = "firm",
    hall: Hall | None = None,
    rngs: Sequence[np.random.Generator] = (),
) -> list[FlightLog]:
    """Simulate a motion of E teams and log the state that the controller receives.

    A log ends before the first contact or tumble of its team.

    Args:
        team: the N vehicles.
        motion: the motion of E teams.
        interactions: the force model of the environment.
        duration_s: the duration of the flights, s.
        feedforward: the force model that the controller compensates; None for no compensation.
        pilot: the name of the position gains, see `PILOTS`.
        hall: parameters of the world "hall", where the controller receives an estimate of the
            state; None for "ideal".
        rngs: E generators for the hall.
    """
    envs, drones = motion.start.shape[:2]
    physics = BatchPhysics(team, envs, interactions, hall=hall)
    gains = PILOTS[check_name("pilot", pilot, PILOTS)]
    tracker = TrackingController(team, envs, ControllerConfig(gains, feedforward))
    setpoint = Setpoint.hold(motion.start)
    if hall is not None:
        for e, rng in enumerate(rngs):
            hall.draw(rng, e, physics.world)
    physics.reset(hover_state(team, motion.start))
    state = _seen(physics)
    entries = round(duration_s * LOG_RATE)
    log = FlightLog(*(np.empty((entries, envs, drones, width)) for width in _WIDTHS))
    length = np.full(envs, entries)
    before = physics.state.velocity.copy()
    for k in range(entries):
        for step in range(STEPS_PER_ENTRY):
            target = motion.target((k + step / STEPS_PER_ENTRY) / LOG_RATE, state.position)
            for part, value in zip(setpoint, target, strict=False):
                part[...] = value
            commands = tracker.commands(state, setpoint)
            if step == 0:
                log.position[k], log.velocity[k] = state.position, state.velocity
                log.quaternion[k], log.commands[k] = state.quaternion, commands
                log.setpoint[k] = target.position
            now = physics.state.velocity.copy()
            physics.step(commands)
            state = _seen(physics)
            if step == 0:  # the two steps around the entry
                log.specific_force[k] = (physics.state.velocity - before) / (
                    TIME_STEP * (2 if k else 1)
                )
            before = now
            touched = (physics.contact | physics.contacts.tumbling).any(axis=1)
            length[touched] = np.minimum(length[touched], k)
    log.specific_force[..., 2] += GRAVITY
    log = log._replace(specific_force=rotate(inverse(log.quaternion), log.specific_force))
    flights = (FlightLog(*(array[:, e] for array in log)) for e in range(envs))
    return [flight.cut(int(count)) for flight, count in zip(flights, length, strict=True)]


def _seen(physics: BatchPhysics) -> SwarmState:
    """Return the state that the controller receives: an estimate in the hall, else the truth."""
    if physics.hall is None:
        return physics.state
    drones = physics.world.drones
    seen = np.zeros(drones.shape, SENSED_TYPE)
    sense_in_hall(0, len(drones), drones, np.ones(len(drones), np.bool_), seen)
    return state_of(seen)
