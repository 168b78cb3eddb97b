"""From logs to the rows that the trainer of force models reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.training.collection.flight import LOG_RATE, FlightLog
from swarm_envs.training.collection.labels import interaction_force
from swarm_envs.training.force_model.rows import NO_NEIGHBOR, InteractionRows
from swarm_envs.vehicles import parse_team

TYPES = ("S", "L")
"""Interaction types of the vehicles that are flown."""
VOLUME_M = np.array([0.35, 0.35, 1.1])
"""Half edges of the interaction volume: rows stay if any neighbour is inside."""
ROW_RATE = 30
"""Rows per second and drone: neighbouring log entries are near copies."""


class Flight(NamedTuple):
    """A log and whose it is."""

    name: str
    team: str
    log: FlightLog
    validation: bool
    """Whether its rows are held out of training."""


def scenario_name(ego: str, neighbors: Sequence[str]) -> str:
    """Name such as `SL2S` (neighbours S and L, drone S), or `Ge2S` for a lone drone."""
    above = "".join(sorted(neighbors, key=TYPES.index)) or "Ge"
    return f"{above}2{ego}"


def interaction_rows(flights: Sequence[Flight]) -> InteractionRows:
    """Rows of every drone of every flight, labels from `interaction_force`.

    Of drones in company those rows stay that have a neighbour in the interaction volume, as in
    the paper; of lone drones every row.

    Raises:
        ValueError: there is no row.
    """
    slots = max((len(parse_team(flight.team)) - 1 for flight in flights), default=0)
    tables = [
        _drone_rows(flight, index, i, slots)
        for index, flight in enumerate(flights)
        for i in range(len(parse_team(flight.team)))
    ]
    tables = [table for table in tables if len(table["step"])]
    if not tables:
        raise ValueError(f"{len(flights)} flights give no row; fly longer, or nearer to each other")
    columns: dict[str, Any] = {
        name: np.concatenate([t[name] for t in tables]) for name in tables[0]
    }
    names = np.unique(columns["scenario"])
    columns["scenario"] = np.searchsorted(names, columns["scenario"])
    return InteractionRows(types=TYPES, scenario_names=tuple(names.tolist()), **columns)


def _drone_rows(flight: Flight, index: int, i: int, slots: int) -> dict[str, np.ndarray]:
    team = parse_team(flight.team)
    kinds = [vehicle.interaction_type for vehicle in team]
    others = [j for j in range(len(team)) if j != i]
    every = LOG_RATE // ROW_RATE
    force = interaction_force(flight.log, team)[::every, i]
    position, velocity = flight.log.position[::every], flight.log.velocity[::every]
    neighbor: FloatArray = np.zeros((len(force), slots, 6))
    neighbor_type = np.full((len(force), slots), NO_NEIGHBOR)
    for slot, j in enumerate(others):
        neighbor[:, slot, :3] = position[:, j] - position[:, i]
        neighbor[:, slot, 3:] = velocity[:, j] - velocity[:, i]
        neighbor_type[:, slot] = TYPES.index(kinds[j])
    near = np.all(np.abs(neighbor[..., :3]) <= VOLUME_M, axis=-1)
    keep = np.isfinite(force).all(axis=1)
    if others:
        keep &= (near & (neighbor_type != NO_NEIGHBOR)).any(axis=1)
    count = int(keep.sum())
    constants = {
        "ego_type": TYPES.index(kinds[i]),
        "flight": index,
        "vehicle": i,
        "validation": flight.validation,
        "scenario": scenario_name(kinds[i], [kinds[j] for j in others]),
    }
    return {
        "position": position[keep, i],
        "velocity": velocity[keep, i],
        "neighbor": neighbor[keep],
        "neighbor_type": neighbor_type[keep],
        "force_g": force[keep],
        "step": np.flatnonzero(keep) * every,
        **{name: np.full(count, value) for name, value in constants.items()},
    }
