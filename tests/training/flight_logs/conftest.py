"""Flights in the environment, written as logs of real drones would be: the truth of these tests."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from swarm_envs.training.collection.collect import (
    CollectionConfig,
    FlightBatch,
    flight_generator,
    make_motion,
)
from swarm_envs.training.collection.flight import fly_motion
from swarm_envs.training.collection.log import LOG_RATE, FlightLog
from swarm_envs.training.flight_logs import FlightTable
from swarm_envs.vehicles import GRAVITY, Team, parse_team
from tests.helpers.real_logs import to_table


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


def make_table(log: FlightLog, team: str, names=None, accelerometer=True) -> FlightTable:
    """The log as a table, of drones with these names, with the acceleration of its velocity."""
    table = to_table(log, parse_team(team), LOG_RATE)
    time, count = np.arange(len(log.position)) / LOG_RATE, len(log.position)
    acceleration = CubicSpline(time, log.velocity).derivative()(time)
    acceleration[..., 2] += GRAVITY
    return dataclasses.replace(
        table,
        drone=np.tile(np.array(names or [f"cf{i}" for i in range(len(parse_team(team)))]), count),
        time=table.time + 100.0,
        acceleration=acceleration.reshape(-1, 3) if accelerometer else None,
    )


@pytest.fixture(scope="session")
def flown():
    """Flies a team: `fly_team`."""
    return fly_team


@pytest.fixture(scope="session")
def as_table():
    """Writes a flight as a table: `make_table`."""
    return make_table
