"""Conversion of the motion of a flight to rows, of one drone or of many as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.interaction_rows.rows import NO_NEIGHBOR, InteractionRows

__all__ = ["TYPES", "join_rows", "near_any", "rows_of_drone", "scenario_name"]

TYPES = ("S", "L")
"""Interaction types of the vehicles."""


def scenario_name(ego: str, neighbors: Sequence[str]) -> str:
    """Return a name such as `SL2S` (neighbors S and L, drone S), or `Ge2S` for a lone drone."""
    above = "".join(sorted(neighbors, key=TYPES.index)) or "Ge"
    return f"{above}2{ego}"


def near_any(position: FloatArray) -> BoolArray:
    """Return True (T, N) for drones (T, N, 3) with a neighbor in their interaction volume."""
    apart = np.abs(position[:, :, None] - position[:, None])
    inside = (apart <= INTERACTION_VOLUME).all(axis=-1)
    return np.asarray(inside.sum(axis=-1) > 1)  # each drone is in its own volume


def rows_of_drone(
    i: int,
    kinds: Sequence[str],
    position: FloatArray,
    velocity: FloatArray,
    force_g: FloatArray,
    keep: BoolArray,
    **numbers: int,
) -> InteractionRows:
    """Return the entries of drone i of a flight as rows, with N - 1 neighbor slots.

    Args:
        i: the drone on which the force acts.
        kinds: interaction types of the N drones.
        position: (T, N, 3), m.
        velocity: (T, N, 3), m/s.
        force_g: labels (T, N, 3), gram-force.
        keep: (T,) mask of the entries that become rows.
        numbers: `flight`, `vehicle` and `validation` of all its rows.
    """
    others, step = [j for j in range(len(kinds)) if j != i], np.flatnonzero(keep)
    motion = np.concatenate([position, velocity], axis=-1)[keep]
    types = np.array([TYPES.index(kinds[j]) for j in others], dtype=np.int64)
    alike: dict[str, Any] = {name: np.full(len(step), value) for name, value in numbers.items()}
    return InteractionRows(
        types=TYPES,
        ego_type=np.full(len(step), TYPES.index(kinds[i])),
        position=position[keep, i],
        velocity=velocity[keep, i],
        neighbor=motion[:, others] - motion[:, i, None],
        neighbor_type=np.tile(types, (len(step), 1)),
        force_g=force_g[keep, i],
        step=step,
        scenario=np.zeros(len(step), dtype=np.int64),
        scenario_names=(scenario_name(kinds[i], [kinds[j] for j in others]),),
        **alike,
    )


def join_rows(parts: Sequence[InteractionRows], names: Mapping[int, str]) -> InteractionRows:
    """Return the rows of drones as one table, with the names of vehicles by number.

    It has the largest number of neighbor slots of any part; scenarios without rows are omitted.
    """
    slots = max(part.neighbor_type.shape[1] for part in parts)
    some = [part for part in parts if len(part)] or list(parts[:1])
    scenarios = tuple(sorted({part.scenario_names[0] for part in some}))
    padded = [_padded(part, slots, scenarios) for part in some]
    arrays: dict[str, Any] = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in padded])
        for entry in fields(InteractionRows)
        if isinstance(getattr(padded[0], entry.name), np.ndarray)
    }
    return replace(padded[0], **arrays, vehicle_names=dict(names))


def _padded(part: InteractionRows, slots: int, scenarios: tuple[str, ...]) -> InteractionRows:
    free = ((0, 0), (0, slots - part.neighbor_type.shape[1]))
    return replace(
        part,
        neighbor=np.pad(part.neighbor, (*free, (0, 0))),
        neighbor_type=np.pad(part.neighbor_type, free, constant_values=NO_NEIGHBOR),
        scenario=part.scenario + scenarios.index(part.scenario_names[0]),
        scenario_names=scenarios,
    )
