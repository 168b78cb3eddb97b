"""Conversion of collected logs to rows for the fit of force models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.state import BoolArray
from swarm_envs.training.collection.flight import vehicle_ids
from swarm_envs.training.collection.log import LOG_RATE, FlightLog, Label, interaction_force
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.drone_rows import (
    join_rows,
    near_any,
    rows_of_drone,
    scenario_name,
)
from swarm_envs.vehicles import parse_team

__all__ = ["ROW_RATE", "CollectedFlight", "interaction_rows"]

ROW_RATE = 30
"""Rows per second and drone, fewer than log entries because these are nearly equal."""

SCENARIOS = ("Ge2S", "S2S", "L2S", "SS2S", "SL2S", "LL2S",
             "Ge2L", "S2L", "L2L", "SS2L", "SL2L", "LL2L")  # fmt: skip
"""The twelve scenarios of Table II, in its order: `SL2S` is {S, L} -> S, `Ge2S` a lone drone."""


class CollectedFlight(NamedTuple):
    """The log of a flight, with its team."""

    name: str
    """The name of the flight and of its file."""
    team: str
    """The vehicle types, such as `SSL`."""
    log: FlightLog
    """The log."""
    validation: bool
    """True if its rows are held out of training."""

    @property
    def seconds(self) -> float:
        """The duration of the flight, s."""
        return len(self.log.position) / LOG_RATE


def scenario_counts(flights: Sequence[CollectedFlight]) -> dict[str, dict[str, Any]]:
    """Return the flights and times of each scenario, those of Table II first, in its order.

    By scenario: `flights` in which it occurs, and `drone_seconds`, the total time of its drones.
    """
    found: dict[str, dict[str, Any]] = {}
    for flight in flights:
        kinds = [vehicle.interaction_type for vehicle in parse_team(flight.team)]
        names = [scenario_name(k, kinds[:i] + kinds[i + 1 :]) for i, k in enumerate(kinds)]
        for name in names:
            entry = found.setdefault(name, {"flights": 0, "drone_seconds": 0.0})
            entry["drone_seconds"] = round(entry["drone_seconds"] + flight.seconds, 3)
        for name in set(names):
            found[name]["flights"] += 1
    order = [*(name for name in SCENARIOS if name in found), *sorted(set(found) - set(SCENARIOS))]
    return {name: found[name] for name in order}


def interaction_rows(
    flights: Sequence[CollectedFlight], label: Label = "differentiated"
) -> InteractionRows:
    """Return the rows of every drone of every flight, with labels from `interaction_force`.

    In flights of several drones, rows without a neighbor in the interaction volume are dropped, as
    in the paper.

    Raises:
        ValueError: there is no row.
    """
    parts = [rows for k, flight in enumerate(flights) for rows in _flight_rows(k, flight, label)]
    if not any(map(len, parts)):
        raise ValueError(f"{len(flights)} flights give no row; fly longer, or closer to each other")
    return join_rows(parts, {})


def _flight_rows(number: int, flight: CollectedFlight, label: Label) -> list[InteractionRows]:
    """Return the rows of each drone of a flight."""
    team, every = parse_team(flight.team), LOG_RATE // ROW_RATE
    force = interaction_force(flight.log, team, label=label)[::every]
    position, velocity = flight.log.position[::every], flight.log.velocity[::every]
    kinds = [vehicle.interaction_type for vehicle in team]
    known: BoolArray = np.asarray(np.isfinite(force).all(axis=-1))
    if len(team) > 1:
        known &= near_any(position)
    found = []
    for i, vehicle in enumerate(vehicle_ids(team)):
        own = {"flight": number, "vehicle": vehicle, "validation": flight.validation}
        rows = rows_of_drone(i, kinds, position, velocity, force, known[:, i], **own)
        found.append(replace(rows, step=rows.step * every))
    return found
