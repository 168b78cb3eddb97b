"""What a model is fitted to: labels free of calibration offsets and of drag, and their range."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.training.force_model.config import FitConfig
from swarm_envs.training.force_model.drag import fit_drag
from swarm_envs.training.force_model.spec import InputRange
from swarm_envs.training.interaction_rows.calibration import (
    NO_OFFSETS,
    Offsets,
    estimate_offsets,
    subtract_offsets,
)
from swarm_envs.training.interaction_rows.rows import FloatArray, InteractionRows
from swarm_envs.vehicles import GRAM_FORCE


class Treated(NamedTuple):
    """Rows, and what was taken out of their vertical labels."""

    rows: InteractionRows
    """With the labels as measured."""
    target: InteractionRows
    """With the labels that a model is fitted to."""
    offsets: Offsets
    """What was taken out of the labels."""
    drag: FloatArray
    """(T, 3) by type, N s/m; added back to what a model says."""


def is_calibrated(config: FitConfig) -> bool:
    """Whether a fit estimates offsets."""
    return config.mode == "anchored" and config.offsets == "estimated"


def treat(rows: InteractionRows, config: FitConfig) -> Treated:
    """Take offsets and vertical drag out of the labels, as the configuration says.

    A network in `measured` mode learns the vertical drag with the rest: it stays in.

    Raises:
        ValueError: a vehicle's offset cannot be estimated.
    """
    drag = fit_drag(rows)
    offsets = estimate_offsets(rows) if is_calibrated(config) else NO_OFFSETS
    if config.mode == "measured" and config.model != "wake":
        drag[:, 2] = 0.0
    free = subtract_offsets(rows, offsets)
    vertical_g = drag[rows.ego_type, 2] * rows.velocity[:, 2] / GRAM_FORCE
    target = free.with_vertical_force(free.force_g[:, 2] + vertical_g)
    return Treated(rows, target, offsets, drag)


def check_rows(rows: InteractionRows) -> None:
    """Check that something is there to fit and to validate.

    Raises:
        ValueError: there is no training row, or no row that is held out.
    """
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
