"""From logs to the rows that the trainer of force models reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.training.collection.flight import vehicle_ids, vehicle_names
from swarm_envs.training.collection.log import LOG_RATE, FlightLog, Label, interaction_force
from swarm_envs.training.interaction_rows import NO_NEIGHBOR, InteractionRows
from swarm_envs.vehicles import parse_team

__all__ = [
    "ROW_RATE",
    "CollectedFlight",
    "DroneRows",
    "interaction_rows",
    "rows_of_drone",
    "rows_of_drones",
]

TYPES = ("S", "L")
"""Interaction types of the vehicles that are flown."""
ROW_RATE = 30
"""Rows per second and drone: successive log entries are near copies."""

SCENARIOS = ("Ge2S", "S2S", "L2S", "SS2S", "SL2S", "LL2S",
             "Ge2L", "S2L", "L2L", "SS2L", "SL2L", "LL2L")  # fmt: skip
"""The twelve scenarios of Table II, in its order: `SL2S` is {S, L} -> S, `Ge2S` a lone drone."""


class CollectedFlight(NamedTuple):
    """A log and whose it is."""

    name: str
    """Of the flight, as in its file's name."""
    team: str
    """Who flew."""
    log: FlightLog
    """What was logged."""
    validation: bool
    """Whether its rows are held out of training."""

    @property
    def seconds(self) -> float:
        """Length of the flight, s."""
        return len(self.log.position) / LOG_RATE


def scenario_name(ego: str, neighbors: Sequence[str]) -> str:
    """Name such as `SL2S` (neighbours S and L, drone S), or `Ge2S` for a lone drone."""
    above = "".join(sorted(neighbors, key=TYPES.index)) or "Ge"
    return f"{above}2{ego}"


class _ScenarioCount(NamedTuple):
    """How much of a scenario was flown."""

    flights: int  # flights in which the scenario occurs
    drone_seconds: float  # time of its drones; two like ones of a team count twice
    near_seconds: float  # of it, with a neighbour in the interaction volume; of lone drones all


def scenario_counts(flights: Sequence[CollectedFlight]) -> dict[str, _ScenarioCount]:
    """Count what was flown of each scenario: those of Table II first, in its order."""
    found: dict[str, list[Any]] = {}
    for flight in flights:
        team = parse_team(flight.team)
        kinds = [vehicle.interaction_type for vehicle in team]
        near = near_any(flight.log.position).sum(axis=0) / LOG_RATE
        for i, kind in enumerate(kinds):
            entry = found.setdefault(
                scenario_name(kind, kinds[:i] + kinds[i + 1 :]), [set[str](), 0.0, 0.0]
            )
            entry[0].add(flight.name)
            entry[1] += flight.seconds
            entry[2] += float(near[i]) if len(team) > 1 else flight.seconds
    order = [*(name for name in SCENARIOS if name in found), *sorted(set(found) - set(SCENARIOS))]
    return {
        name: _ScenarioCount(len(found[name][0]), *(round(v, 3) for v in found[name][1:]))
        for name in order
    }


def near_any(position: FloatArray) -> BoolArray:
    """Which of the drones (T, N, 3) have a neighbour in their interaction volume, (T, N)."""
    apart = np.abs(position[:, :, None] - position[:, None])
    inside = (apart <= INTERACTION_VOLUME).all(axis=-1)
    return np.asarray(inside.sum(axis=-1) > 1)  # each is in its own


def interaction_rows(
    flights: Sequence[CollectedFlight], label: Label = "differentiated"
) -> InteractionRows:
    """Rows of every drone of every flight, labels from `interaction_force`.

    Of drones in company those rows stay that have a neighbour in the interaction volume, as in
    the paper; of lone drones every row.

    Raises:
        ValueError: there is no row.
    """
    slots = max((len(parse_team(flight.team)) - 1 for flight in flights), default=0)
    parts = [
        (number, vehicle, flight, rows)
        for number, flight in enumerate(flights)
        for vehicle, rows in _flight_rows(flight, label)
        if len(rows.step)
    ]
    if not parts:
        raise ValueError(f"{len(flights)} flights give no row; fly longer, or nearer to each other")
    return rows_of_drones(
        [rows for _, _, _, rows in parts],
        slots,
        flight=[number for number, _, _, _ in parts],
        vehicle=[vehicle for _, vehicle, _, _ in parts],
        held_out=np.concatenate(
            [np.full(len(rows.step), flight.validation) for _, _, flight, rows in parts]
        ),
    )


def _flight_rows(flight: CollectedFlight, label: Label) -> list[tuple[int, DroneRows]]:
    """Number of each vehicle of a flight, and its rows."""
    team, every = parse_team(flight.team), LOG_RATE // ROW_RATE
    force = interaction_force(flight.log, team, label=label)[::every]
    position, velocity = flight.log.position[::every], flight.log.velocity[::every]
    kinds = [vehicle.interaction_type for vehicle in team]
    known: BoolArray = np.asarray(np.isfinite(force).all(axis=-1))
    if len(team) > 1:
        known &= near_any(position)
    found = []
    for i, (name, vehicle) in enumerate(zip(vehicle_names(team), vehicle_ids(team), strict=True)):
        rows = rows_of_drone(name, i, kinds, position, velocity, force)
        rows = rows._replace(step=rows.step * every)
        found.append((vehicle, rows.select(known[:, i], "force unknown or no drone near")))
    return found


class DroneRows(NamedTuple):
    """Rows of one drone in one flight, R of them, K neighbour slots; see `InteractionRows`."""

    name: str
    """Of the physical vehicle that feels the force."""
    ego_type: int
    """Index of its type."""
    scenario: str
    """Who flew around it, such as `L2S`."""
    step: IntArray
    """(R,) sample index."""
    position: FloatArray
    """(R, 3) its position, m."""
    velocity: FloatArray
    """(R, 3) its velocity, m/s."""
    neighbor: FloatArray
    """(R, K, 6) positions and velocities of neighbours relative to it, m and m/s."""
    neighbor_type: IntArray
    """(R, K) indices of their types; -1 where there is none."""
    force_g: FloatArray
    """Force on it, gram-force."""
    dropped: dict[str, int]
    """Entries left out, by reason."""

    def select(self, keep: BoolArray, reason: str) -> DroneRows:
        """Return only the rows of an (R,) mask; the others are counted under `reason`."""
        arrays = ("step", "position", "velocity", "neighbor", "neighbor_type", "force_g")
        counts = self.dropped | {reason: self.dropped.get(reason, 0) + int((~keep).sum())}
        kept = {name: getattr(self, name)[keep] for name in arrays}
        return self._replace(**kept, dropped=counts)


def rows_of_drone(
    name: str,
    i: int,
    kinds: Sequence[str],
    position: FloatArray,
    velocity: FloatArray,
    force_g: FloatArray,
) -> DroneRows:
    """Every entry of drone i of a flight as a row, with N - 1 neighbour slots.

    `kinds` are interaction types of the N drones; positions, m, velocities, m/s, and labels, g, are
    (T, N, 3).
    """
    others = [j for j in range(len(kinds)) if j != i]
    apart = [values[:, others] - values[:, i, None] for values in (position, velocity)]
    types = np.array([TYPES.index(kinds[j]) for j in others], dtype=np.int64)
    return DroneRows(
        name=name,
        ego_type=TYPES.index(kinds[i]),
        scenario=scenario_name(kinds[i], [kinds[j] for j in others]),
        step=np.arange(len(position)),
        position=position[:, i],
        velocity=velocity[:, i],
        neighbor=np.concatenate(apart, axis=-1),
        neighbor_type=np.broadcast_to(types, (len(position), len(others))),
        force_g=force_g[:, i],
        dropped={},
    )


def rows_of_drones(
    parts: Sequence[DroneRows],
    slots: int,
    flight: Sequence[int],
    vehicle: Sequence[int],
    held_out: BoolArray,
    names: dict[int, str] | None = None,
) -> InteractionRows:
    """One table of the rows of D drones, one after the other, with room for `slots` neighbours.

    `flight` and `vehicle` are D numbers, `held_out` (R,) says which of all rows are for validation.
    """
    scenarios = sorted({rows.scenario for rows in parts})

    def repeated(values: Sequence[int]) -> IntArray:
        return np.repeat(np.asarray(values), [len(rows.step) for rows in parts])

    def stacked(name: str) -> npt.NDArray[Any]:
        return np.concatenate([getattr(rows, name) for rows in parts])

    free = [((0, 0), (0, slots - rows.neighbor.shape[1])) for rows in parts]
    neighbor = [np.pad(rows.neighbor, (*at, (0, 0))) for rows, at in zip(parts, free, strict=True)]
    neighbor_type = [
        np.pad(rows.neighbor_type, at, constant_values=NO_NEIGHBOR)
        for rows, at in zip(parts, free, strict=True)
    ]
    return InteractionRows(
        types=TYPES,
        ego_type=repeated([rows.ego_type for rows in parts]),
        position=stacked("position"),
        velocity=stacked("velocity"),
        neighbor=np.concatenate(neighbor),
        neighbor_type=np.concatenate(neighbor_type),
        force_g=stacked("force_g"),
        flight=repeated(flight),
        step=stacked("step"),
        vehicle=repeated(vehicle),
        scenario=repeated([scenarios.index(rows.scenario) for rows in parts]),
        validation=held_out,
        scenario_names=tuple(scenarios),
        vehicle_names=names or {},
    )
