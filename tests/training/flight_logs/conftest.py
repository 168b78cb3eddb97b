"""Flights in the environment, written as logs of real drones would be: the truth of these tests."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from swarm_envs.motors import FULL_VOLTAGE
from swarm_envs.training.collection.collect import (
    CollectionConfig,
    FlightBatch,
    flight_generator,
    make_motion,
)
from swarm_envs.training.collection.flight import fly_motion
from swarm_envs.training.collection.log import LOG_RATE, FlightLog
from swarm_envs.training.flight_logs import FlightTable
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Team, Vehicle, parse_team


def psi1_signal(vehicle: Vehicle, force_g, volts):
    """The signal at which psi1 gives exactly a force: its root on the rising branch.

    Where psi1 gives no force so small, the signal of its least.
    """
    a, b, c, d, e = vehicle.pwm_to_force
    slope = b + e * volts
    return (-slope + np.sqrt(np.maximum(slope**2 - 4.0 * d * (a + c * volts - force_g), 0.0))) / (
        2.0 * d
    )


@cache
def fly_team(
    team: str, kind: str = "walk", seconds: float = 8.0, mass_g: float = 0.0, seed: int = 0
) -> FlightLog:
    """A noiseless flight; `mass_g` is what every drone weighs more than its type says."""
    config = CollectionConfig(teams=(team,), duration_s=seconds, seed=seed)
    batch = FlightBatch(team, kind, 1)
    rngs = [flight_generator(config, name) for name in batch.names]
    vehicles: Team = tuple(
        dataclasses.replace(v, mass=v.mass + mass_g / 1000.0) for v in parse_team(team)
    )
    return fly_motion(vehicles, make_motion(config, batch, rngs), "learned", seconds)[0]


def make_table(
    log: FlightLog, team: str, names=None, thrust_gain=1.0, accelerometer=True
) -> FlightTable:
    """The log as a table; psi1 of its PWM is the commanded thrust over `thrust_gain`."""
    vehicles = parse_team(team)
    names = names or [f"cf{i}" for i in range(len(vehicles))]
    count = len(log.position)
    time = np.arange(count) / LOG_RATE
    volts = np.linspace(4.0, 3.7, count)
    signal = np.stack(
        [
            psi1_signal(
                vehicle,
                log.commands[:, i] / GRAM_FORCE / thrust_gain,
                volts[:, None] / FULL_VOLTAGE,
            )
            for i, vehicle in enumerate(vehicles)
        ],
        axis=1,
    )
    acceleration = CubicSpline(time, log.velocity).derivative()(time)
    acceleration[..., 2] += GRAVITY

    def column(values):
        return values.reshape(-1, *values.shape[2:])

    return FlightTable(
        drone=np.tile(np.array(names), count),
        type=np.tile(np.array([vehicle.token for vehicle in vehicles]), count),
        time=np.repeat(time + 100.0, len(vehicles)),
        position=column(log.position),
        velocity=column(log.velocity),
        quaternion=column(log.quaternion),
        acceleration=column(acceleration) if accelerometer else None,
        pwm=65536.0 * column(signal),
        voltage=np.repeat(volts, len(vehicles)),
    )


@pytest.fixture(scope="session")
def flown():
    """Flies a team: `fly_team`."""
    return fly_team


@pytest.fixture(scope="session")
def as_table():
    """Writes a flight as a table: `make_table`."""
    return make_table
