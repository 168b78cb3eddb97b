"""From rows to what is learned: labels free of offsets and drag, the range of inputs, the types.

Linear body drag is fitted per type and axis to the same rows as the network. A network of a type
that no training row shows holds the random numbers that it started with: it is set to zero, and
the report says so. A type that was never a neighbor pushes none, one that never was the drone
of a row feels nothing.
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
"""A drone at this speed or above is out of control, m/s. In the published flights it falls: its
label, -40 g on average, says that the rotors no longer give the thrust of the command."""


class Treated(NamedTuple):
    """Rows, and what was taken out of their labels."""

    rows: InteractionRows  # With the labels as measured
    target: InteractionRows  # With the labels that a model is fitted to
    offsets: Offsets  # What was taken out of the vertical labels
    drag: FloatArray  # (T, 3) by type, N s/m; added back to what a model says


def is_calibrated(config: FitConfig) -> bool:
    """Return True if a fit estimates offsets."""
    return config.mode == "anchored" and config.offsets == "estimated"


def treat(rows: InteractionRows, config: FitConfig) -> Treated:
    """Take offsets and drag out of the labels that are fitted, as the configuration says.

    They are the vertical ones, of a composed model all three: horizontal offsets are those of
    attitude. A network in `measured` mode learns the vertical drag with the rest: it stays in.

    Raises:
        ValueError: a vehicle's offset cannot be estimated.
    """
    drag = fit_drag(rows)
    if config.mode == "measured" and config.model != "wake":
        drag[:, 2] = 0.0
    offsets, force = NO_OFFSETS, rows.force_g.copy()
    for axis in (0, 1, 2) if config.model == "composed" else (2,):
        if is_calibrated(config):
            offsets = estimate_offsets(rows, axis)
        force[:, axis] -= offsets.of(rows)
        force[:, axis] += drag[rows.ego_type, axis] * rows.velocity[:, axis] / GRAM_FORCE
    return Treated(rows, replace(rows, force_g=force), offsets, drag)


def flown(rows: InteractionRows) -> InteractionRows:
    """Rows without the training rows of drones that fall (`FALL_SPEED`)."""
    speed = np.linalg.norm(rows.velocity, axis=1)
    return rows.select(rows.validation | (speed < FALL_SPEED))


def check_rows(rows: InteractionRows) -> None:
    """Check that something is there to fit and to validate."""
    if rows.validation.all():
        raise ValueError(f"all {len(rows)} rows are held out, so there is nothing to fit")
    if not rows.validation.any():
        raise ValueError(
            f"none of {len(rows)} rows is held out; mark whole blocks of time, about 20 %, or give "
            "flights long enough for blocks to be drawn"
        )


def measured_range(rows: InteractionRows) -> InputRange:
    """Range that the inputs of an anchored fit are clamped to.

    Heights between the lowest and the highest of all rows; of every speed and of the vertical
    distance the 99.9 % quantile of its magnitude inside the interaction volume, one number for x
    and y; laterally the edge of the volume, since the window ends there.
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

    The constant is free for each flight of each vehicle, since attitude and thrust calibration
    shift the horizontal labels too. Horizontal axes use training rows where nothing else acts
    (`calibration.quiet_rows`, any speed), made one number for x and y because the vehicles are
    square; the vertical axis uses lone flight above the ground effect, since even quiet rows of a
    group move up and down together with the wakes. A negative slope would be no drag and
    becomes 0, as does an axis without rows.
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
    """Common c of the axes in gram-force s/m, with a free constant per flight and vehicle."""
    if not use.any():
        return 0.0
    pairs = np.stack([rows.flight[use], rows.vehicle[use]], axis=1)
    group = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(group)
    above = below = 0.0
    for axis in axes:
        force = _centred(rows.force_g[use, axis], group, count)
        velocity = _centred(rows.velocity[use, axis], group, count)
        above += float(force @ velocity)
        below += float(velocity @ velocity)
    return -above / below if below > 0 else 0.0


def _centred(values: FloatArray, group: np.ndarray, count: np.ndarray) -> FloatArray:
    mean = np.bincount(group, values) / count
    return np.asarray(values - mean[group])


def silence_unseen(network: ForceNetwork, rows: InteractionRows) -> list[str]:
    """Set the outputs of networks that saw no training row to zero; what was, a sentence each."""
    training = rows.select(~rows.validation)
    pairs, felt = shown_pairs(training), np.isin(np.arange(len(rows.types)), training.ego_type)
    said = []
    for index in np.flatnonzero(~felt).tolist():
        network.silence_drone(index)
        name = rows.types[index]
        said.append(
            f"type {name!r} is the drone of no training row: the model says it feels nothing"
        )
    if isinstance(network, DeepSet):
        return said + _silence_neighbors(network, pairs, felt)
    assert isinstance(network, Composed | Wake)
    for upper, lower in np.argwhere(~pairs).tolist():
        network.silence_pair(upper, lower)
        if felt[lower]:
            said.append(_never_together(rows.types, upper, lower) + "it does not push it")
    return said


def _silence_neighbors(network: DeepSet, pairs: BoolArray, felt: BoolArray) -> list[str]:
    """Silence the types that are no neighbor; what happens to pairs that never met is a guess."""
    said = []
    for name, row in zip(network.types, pairs, strict=True):
        if not row.any():
            silence(network.phi[name])
            said.append(
                f"type {name!r} is a neighbor in no training row: the model says it pushes nobody"
            )
    for upper, lower in np.argwhere(~pairs).tolist():
        if felt[lower] and pairs[upper].any():
            beginning = _never_together(network.types, upper, lower)
            said.append(beginning + "what it does to it is guessed from other pairs")
    return said


def _never_together(types: Sequence[str], upper: int, lower: int) -> str:
    return f"type {types[upper]!r} is a neighbor of type {types[lower]!r} in no training row: "


def shown_pairs(rows: InteractionRows) -> BoolArray:
    """Which of T types is a neighbor (first axis) of which (second) in some row, (T, T)."""
    pairs = np.zeros((len(rows.types), len(rows.types)), dtype=np.bool_)
    egos = np.repeat(rows.ego_type[:, None], rows.neighbor_type.shape[1], axis=1)
    pairs[rows.neighbor_type[rows.has_neighbor], egos[rows.has_neighbor]] = True
    return pairs
