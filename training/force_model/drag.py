"""Linear body drag per vehicle type and axis, fitted to the same rows as the network."""

from __future__ import annotations

import numpy as np

from swarm_envs.training.interaction_rows.calibration import quiet_rows
from swarm_envs.training.interaction_rows.rows import BoolArray, FloatArray, InteractionRows
from swarm_envs.vehicles import GRAM_FORCE


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
