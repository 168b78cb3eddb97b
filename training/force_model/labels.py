"""Preparation of labels: subtraction of offsets and drag, the range of inputs, vehicle types.

Linear body drag is fitted per type and axis to the same rows as the network. The network of a type
without training rows has random weights: its output is set to zero, with a note in the report. A
type that never was a neighbor exerts no force; on a type that never was the drone of a row, no
force acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.force_model.composed import Composed
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.network import (
    DeepSet,
    ForceNetwork,
    InputRange,
    silence,
)
from swarm_envs.training.force_model.wake import Wake
from swarm_envs.training.interaction_rows.calibration import (
    NO_OFFSETS,
    Offsets,
    estimate_offsets,
    quiet_rows,
)
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.vehicles import GRAM_FORCE

FALL_SPEED = 1.5
"""Least speed of drones that are out of control, m/s. In the published flights they fall: their
mean label of -40 g shows that the rotors no longer produce the commanded thrust."""


class PreparedRows(NamedTuple):
    """Rows with measured and with prepared labels."""

    rows: InteractionRows  # With the labels as measured
    target: InteractionRows  # With the labels of the fit
    offsets: Offsets  # Offsets that were subtracted from the vertical labels
    drag: FloatArray  # (T, 3) by type, N s/m; added to the model's predictions


def prepare(rows: InteractionRows, config: FitConfig) -> PreparedRows:
    """Subtract offsets and drag from the labels of a fit.

    These are the vertical labels, for a composed model all three (horizontal offsets are due to
    attitude errors). In `measured` mode, the vertical drag is not subtracted.

    Raises:
        ValueError: a vehicle's offset cannot be estimated.
    """
    drag = fit_drag(rows)
    if config.mode == "measured" and config.model != "wake":
        drag[:, 2] = 0.0
    offsets, force = NO_OFFSETS, rows.force_g.copy()
    for axis in (0, 1, 2) if config.model == "composed" else (2,):
        if config.mode == "anchored" and config.offsets == "estimated":
            offsets = estimate_offsets(rows, axis)
        force[:, axis] -= offsets.of(rows)
        force[:, axis] += drag[rows.ego_type, axis] * rows.velocity[:, axis] / GRAM_FORCE
    return PreparedRows(rows, replace(rows, force_g=force), offsets, drag)


def without_falls(rows: InteractionRows) -> InteractionRows:
    """Return the rows without training rows of falling drones (`FALL_SPEED`)."""
    speed = np.linalg.norm(rows.velocity, axis=1)
    return rows.select(rows.validation | (speed < FALL_SPEED))


def check_rows(rows: InteractionRows) -> None:
    """Raise ValueError unless there are rows for training and for validation."""
    if rows.validation.all():
        raise ValueError(
            f"all {len(rows)} rows are held out, so there is nothing to fit; add training rows"
        )
    if not rows.validation.any():
        raise ValueError(
            f"none of {len(rows)} rows is held out; mark whole blocks of time, about 20 %, or give "
            "flights long enough for blocks to be drawn"
        )


def measured_range(rows: InteractionRows) -> InputRange:
    """Return the range to which the inputs of an anchored fit are clamped.

    For heights it is from the lowest to the highest of all rows; for speeds and the vertical
    distance the 99.9 % quantile of the magnitude inside the interaction volume, the same for x and
    y; for horizontal distances the edge of the volume, where the window ends.
    """
    inside = (np.abs(rows.neighbor[..., :3]) <= INTERACTION_VOLUME).all(axis=-1) & rows.has_neighbor
    own = np.quantile(np.abs(rows.velocity), 0.999, axis=0)
    own[:2] = own[:2].max()
    pair = np.zeros(6)
    if inside.any():
        pair = np.quantile(np.abs(rows.neighbor[inside]), 0.999, axis=0)
    pair[3:5] = pair[3:5].max()
    pair[:2] = INTERACTION_VOLUME[:2]
    own, pair = np.round(own, 2), np.round(pair, 2)
    height = rows.position[:, 2]
    low, high = round(float(height.min()), 2), round(float(height.max()), 2)
    return InputRange(
        pair=(tuple((-pair).tolist()), tuple(pair.tolist())),
        environment=((-high, *(-own).tolist()), (-low, *own.tolist())),
    )


def fit_drag(rows: InteractionRows) -> FloatArray:
    """Fit c of f = constant - c v by least squares: (number of types, 3) in N s/m, c >= 0.

    The constant is free for each flight of each vehicle, because attitude and thrust calibration
    shift the labels. Horizontal axes use training rows where no other force acts
    (`calibration.quiet_rows`, any speed), with one value for x and y because the vehicles are
    square. The vertical axis uses lone flight above the ground effect, because in groups vertical
    motion is correlated with the wakes. A negative slope is set to 0, as is an axis without rows.
    """
    quiet = quiet_rows(rows, max_speed=np.inf) & ~rows.validation
    alone = quiet & ~rows.has_neighbor.any(axis=1)
    drag = np.zeros((len(rows.types), 3))
    for index in range(len(rows.types)):
        ego = rows.ego_type == index
        horizontal = _slope(rows, quiet & ego, (0, 1))
        drag[index] = horizontal, horizontal, _slope(rows, alone & ego, (2,))
    return np.maximum(drag, 0.0) * GRAM_FORCE


def _slope(rows: InteractionRows, use: BoolArray, axes: tuple[int, ...]) -> float:
    """Return the common c of axes, gram-force s/m, with a free constant per flight and vehicle."""
    if not use.any():
        return 0.0
    pairs = np.stack([rows.flight[use], rows.vehicle[use]], axis=1)
    group = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(group)
    above = below = 0.0
    for axis in axes:
        force = _centered(rows.force_g[use, axis], group, count)
        velocity = _centered(rows.velocity[use, axis], group, count)
        above += float(force @ velocity)
        below += float(velocity @ velocity)
    return -above / below if below > 0 else 0.0


def _centered(values: FloatArray, group: np.ndarray, count: np.ndarray) -> FloatArray:
    mean = np.bincount(group, values) / count
    return np.asarray(values - mean[group])


def silence_unseen(network: ForceNetwork, rows: InteractionRows) -> list[str]:
    """Set the outputs of networks without training rows to zero; return a note for each."""
    training = rows.select(~rows.validation)
    pairs, felt = occurring_pairs(training), np.isin(np.arange(len(rows.types)), training.ego_type)
    notes = []
    for index in np.flatnonzero(~felt).tolist():
        network.silence_drone(index)
        name = rows.types[index]
        notes.append(f"type {name!r} is the drone of no training row: the force on it is zero")
    if isinstance(network, DeepSet):
        return notes + _silence_neighbors(network, pairs, felt)
    assert isinstance(network, Composed | Wake)
    for upper, lower in np.argwhere(~pairs).tolist():
        network.silence_pair(upper, lower)
        if felt[lower]:
            notes.append(_never_together(rows.types, upper, lower) + "its force on it is zero")
    return notes


def _silence_neighbors(network: DeepSet, pairs: BoolArray, felt: BoolArray) -> list[str]:
    """Set phi of types that are no neighbor to zero; note pairs that are extrapolated."""
    notes = []
    for name, row in zip(network.types, pairs, strict=True):
        if not row.any():
            silence(network.phi[name])
            notes.append(
                f"type {name!r} is a neighbor in no training row: it exerts no force on others"
            )
    for upper, lower in np.argwhere(~pairs).tolist():
        if felt[lower] and pairs[upper].any():
            beginning = _never_together(network.types, upper, lower)
            notes.append(beginning + "its force on it is extrapolated from other pairs")
    return notes


def _never_together(types: Sequence[str], upper: int, lower: int) -> str:
    return f"type {types[upper]!r} is a neighbor of type {types[lower]!r} in no training row: "


def occurring_pairs(rows: InteractionRows) -> BoolArray:
    """Return True (T, T) for type pairs [neighbor, drone] that occur in a row."""
    pairs = np.zeros((len(rows.types), len(rows.types)), dtype=np.bool_)
    egos = np.repeat(rows.ego_type[:, None], rows.neighbor_type.shape[1], axis=1)
    pairs[rows.neighbor_type[rows.has_neighbor], egos[rows.has_neighbor]] = True
    return pairs
