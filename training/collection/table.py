"""From logs to the rows that the trainer of force models reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.collection.fleet import vehicle_ids
from swarm_envs.training.collection.labels import Label, interaction_force
from swarm_envs.training.collection.log import LOG_RATE, FlightLog
from swarm_envs.training.interaction_rows import NO_NEIGHBOR, InteractionRows
from swarm_envs.vehicles import parse_team

TYPES = ("S", "L")
"""Interaction types of the vehicles that are flown."""
ROW_RATE = 30
"""Rows per second and drone, about: neighbouring log entries are near copies."""

SCENARIOS = ("Ge2S", "S2S", "L2S", "SS2S", "SL2S", "LL2S",
             "Ge2L", "S2L", "L2L", "SS2L", "SL2L", "LL2L")  # fmt: skip
"""The twelve scenarios of Table II, in its order: `SL2S` is {S, L} -> S, `Ge2S` a lone drone."""


class Flight(NamedTuple):
    """A log and whose it is."""

    name: str
    """Of the flight, as in its file's name."""
    team: str
    """Who flew."""
    log: FlightLog
    """What was logged."""
    validation: bool
    """Whether its rows are held out of training."""
    rate_hz: int = LOG_RATE
    """Log entries per second."""

    @property
    def seconds(self) -> float:
        """Length of the flight, s."""
        return len(self.log.position) / self.rate_hz


def scenario_name(ego: str, neighbors: Sequence[str]) -> str:
    """Name such as `SL2S` (neighbours S and L, drone S), or `Ge2S` for a lone drone."""
    above = "".join(sorted(neighbors, key=TYPES.index)) or "Ge"
    return f"{above}2{ego}"


class ScenarioCount(NamedTuple):
    """How much of a scenario was flown."""

    flights: int
    """Flights in which the scenario occurs."""
    drone_seconds: float
    """Time of its drones; two like ones of a team count twice."""
    near_seconds: float
    """Of it, with a neighbour in the interaction volume; of lone drones all."""


def scenario_counts(flights: Sequence[Flight]) -> dict[str, ScenarioCount]:
    """Count what was flown of each scenario: those of Table II first, in its order."""
    found: dict[str, list[Any]] = {}
    for flight in flights:
        team = parse_team(flight.team)
        kinds = [vehicle.interaction_type for vehicle in team]
        near = near_any(flight.log.position).sum(axis=0) / flight.rate_hz
        for i, kind in enumerate(kinds):
            entry = found.setdefault(
                scenario_name(kind, kinds[:i] + kinds[i + 1 :]), [set[str](), 0.0, 0.0]
            )
            entry[0].add(flight.name)
            entry[1] += flight.seconds
            entry[2] += float(near[i]) if len(team) > 1 else flight.seconds
    order = [*(name for name in SCENARIOS if name in found), *sorted(set(found) - set(SCENARIOS))]
    return {
        name: ScenarioCount(len(found[name][0]), *(round(v, 3) for v in found[name][1:]))
        for name in order
    }


def near_any(position: FloatArray) -> BoolArray:
    """Which of the drones (T, N, 3) have a neighbour in their interaction volume, (T, N)."""
    apart = np.abs(position[:, :, None] - position[:, None])
    inside = (apart <= INTERACTION_VOLUME).all(axis=-1)
    return np.asarray(inside.sum(axis=-1) > 1)  # each is in its own


def interaction_rows(flights: Sequence[Flight], label: Label = "differentiated") -> InteractionRows:
    """Rows of every drone of every flight, labels from `interaction_force`.

    Of drones in company those rows stay that have a neighbour in the interaction volume, as in
    the paper; of lone drones every row.

    Args:
        flights: what was flown.
        label: where the acceleration of the labels comes from.

    Raises:
        ValueError: there is no row.
    """
    slots = max((len(parse_team(flight.team)) - 1 for flight in flights), default=0)
    tables = [t for k, flight in enumerate(flights) for t in _flight_rows(flight, k, slots, label)]
    tables = [table for table in tables if len(table["step"])]
    if not tables:
        raise ValueError(f"{len(flights)} flights give no row; fly longer, or nearer to each other")
    columns: dict[str, Any] = {
        name: np.concatenate([t[name] for t in tables]) for name in tables[0]
    }
    names = np.unique(columns["scenario"])
    columns["scenario"] = np.searchsorted(names, columns["scenario"])
    return InteractionRows(types=TYPES, scenario_names=tuple(names.tolist()), **columns)


def _flight_rows(
    flight: Flight, index: int, slots: int, label: Label
) -> list[dict[str, np.ndarray]]:
    """Tables of the rows of each drone of a flight."""
    team, every = parse_team(flight.team), round(flight.rate_hz / ROW_RATE)
    force = interaction_force(flight.log, team, rate_hz=flight.rate_hz, label=label)[::every]
    position, velocity = flight.log.position[::every], flight.log.velocity[::every]
    kinds = [vehicle.interaction_type for vehicle in team]
    known: BoolArray = np.asarray(np.isfinite(force).all(axis=-1))
    if len(team) > 1:
        known &= near_any(position)
    tables = []
    for i, vehicle in enumerate(vehicle_ids(team)):
        others = [j for j in range(len(team)) if j != i]
        keep = known[:, i]
        count = int(keep.sum())
        neighbor: FloatArray = np.zeros((count, slots, 6))
        neighbor_type = np.full((count, slots), NO_NEIGHBOR)
        neighbor[:, : len(others), :3] = (position[:, others] - position[:, i, None])[keep]
        neighbor[:, : len(others), 3:] = (velocity[:, others] - velocity[:, i, None])[keep]
        neighbor_type[:, : len(others)] = [TYPES.index(kinds[j]) for j in others]
        constants = {
            "ego_type": TYPES.index(kinds[i]),
            "flight": index,
            "vehicle": vehicle,
            "validation": flight.validation,
            "scenario": scenario_name(kinds[i], [kinds[j] for j in others]),
        }
        table = {
            "position": position[keep, i],
            "velocity": velocity[keep, i],
            "neighbor": neighbor,
            "neighbor_type": neighbor_type,
            "force_g": force[keep, i],
            "step": np.flatnonzero(keep) * every,
        }
        tables.append(table | {name: np.full(count, value) for name, value in constants.items()})
    return tables
