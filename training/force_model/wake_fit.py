"""The closed-form wake, and its fit by least squares: `swarm-envs fit --model wake`.

The vertical force on a drone, gram-force, downwash positive inside:

    pair_k = A (w0/w)^p exp(-(r/w)^2 / 2) s(dz / 0.03 m),    w = w0 + S max(dz, 0)
    f_z = G exp(-(z - 0.07 m)/h) - (1 - M exp(-z/hm)) (sum_k pair_k^q)^(1/q)

s is the logistic function, dz the height of neighbour k over the drone, and r the lateral
distance from the wake's axis, which a moving neighbour leaves behind: at depth dz it is shifted
by -v dz / U, U being one advection speed per type of the neighbour. A pair fades over the edge
of the interaction volume as in the learned model.

The fit is by least squares over every parameter at once, on training rows whose labels are free of
calibration offsets and of the vertical drag. Drones of different types have very different
residuals, so a second pass weights each type's rows by what the first left over.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import least_squares

from swarm_envs.files import write_json
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.labels import (
    Treated,
    measured_range,
    never_together,
    shown_pairs,
)
from swarm_envs.training.force_model.network import OUTER_FADE, fade
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.training.provenance import json_ready
from swarm_envs.vehicles import GRAM_FORCE

ROTOR_DEPTH_M = 0.03
"""Vertical distance over which a neighbour at the same height comes to be above."""

GROUND_REFERENCE_M = 0.07  # Height at which the ground effect is G: the lowest that was measured

MOST_ROWS = 100_000
"""Training rows that the least squares look at, drawn at random: they take a minute."""


class WakeParameters(NamedTuple):
    """Parameters by type: rows of the (T, T) arrays are the upper drone, columns the lower."""

    amplitude_g: FloatArray  # A (T, T), gram-force
    width_m: FloatArray  # w0 (T, T), m
    spread: FloatArray  # S (T, T), m of width per m of depth
    decay: FloatArray  # p (T, T)
    advection_speed: FloatArray  # U (T,) by upper type, m/s
    ground_g: FloatArray  # G (T,) by the drone's own type, gram-force
    ground_height_m: FloatArray  # h (T,), m
    combine_q: float  # q >= 1: 1 adds the pairs, infinity keeps the largest
    mitigation: float  # M in [0, 1]: share of the downwash that the ground takes away at z = 0
    mitigation_height_m: float  # hm, m


class _WakeRows(NamedTuple):
    """Rows as the wake takes them; only slots with a neighbour inside the volume are pairs."""

    ego_type: IntArray  # (R,)
    height_m: FloatArray  # (R,) z
    pair_row: IntArray  # (P,) row that each pair belongs to
    pair_type: IntArray  # (P,) type of the neighbour
    offset_m: FloatArray  # (P, 3) p_j - p_i
    wake_velocity: FloatArray  # (P, 2) horizontal velocity of the neighbor, which tilts it, m/s
    weight: FloatArray  # (P,) fade at the edge of the volume


def wake_rows(rows: InteractionRows) -> _WakeRows:
    """Pick the pairs out of a table of rows."""
    window = OUTER_FADE
    distance = torch.from_numpy(np.abs(rows.neighbor[..., :3]))
    weight = fade(distance[..., 0], *window.lateral_m) * fade(distance[..., 1], *window.lateral_m)
    weight = weight * fade(distance[..., 2], *window.vertical_m)
    kept: BoolArray = rows.has_neighbor & (weight.numpy() > 0)
    row, slot = np.nonzero(kept)
    pair = rows.neighbor[row, slot]
    return _WakeRows(
        ego_type=rows.ego_type,
        height_m=rows.position[:, 2],
        pair_row=row.astype(np.int64),
        pair_type=rows.neighbor_type[row, slot],
        offset_m=pair[:, :3],
        wake_velocity=pair[:, 3:5] + rows.velocity[row, :2],
        weight=weight.numpy()[row, slot],
    )


def wake_force_g(parameters: WakeParameters, rows: _WakeRows) -> FloatArray:
    """Vertical force of every row without drag, (R,) in gram-force."""
    w = parameters
    ego = rows.ego_type
    pair = pair_downwash_g(w, rows)
    total = np.bincount(rows.pair_row, pair**w.combine_q, minlength=len(ego))
    downwash = total ** (1.0 / w.combine_q)
    downwash *= 1.0 - w.mitigation * np.exp(-rows.height_m / w.mitigation_height_m)
    above = rows.height_m - GROUND_REFERENCE_M
    ground = w.ground_g[ego] * np.exp(-above / w.ground_height_m[ego])
    return np.asarray(ground - downwash)


def pair_downwash_g(parameters: WakeParameters, rows: _WakeRows) -> FloatArray:
    """Downwash of every pair, (P,) in gram-force, positive downwards."""
    w = parameters
    upper, lower = rows.pair_type, rows.ego_type[rows.pair_row]
    dz = rows.offset_m[:, 2]
    depth = np.maximum(dz, 0.0)
    lag = depth / w.advection_speed[upper]
    axis = rows.offset_m[:, :2] - rows.wake_velocity * lag[:, None]
    start = w.width_m[upper, lower]
    width = start + w.spread[upper, lower] * depth
    centre = w.amplitude_g[upper, lower] * (start / width) ** w.decay[upper, lower]
    shape = np.exp(-0.5 * np.sum(axis**2, axis=1) / width**2)
    above = 1.0 / (1.0 + np.exp(-dz / ROTOR_DEPTH_M))
    return np.asarray(rows.weight * centre * shape * above)


_LIMITS = {  # axes of types, start, lowest, highest
    "amplitude_g": (2, 20.0, 0.0, 80.0),
    "width_m": (2, 0.05, 0.01, 0.2),
    "spread": (2, 0.05, 0.0, 0.5),
    "decay": (2, 1.5, 0.2, 3.0),
    "advection_speed": (1, 3.0, 0.3, 50.0),
    "ground_g": (1, 5.0, 0.0, 30.0),
    "ground_height_m": (1, 0.05, 0.01, 0.3),
    "combine_q": (0, 1.4, 1.0, 5.0),
    "mitigation": (0, 0.4, 0.0, 1.0),
    "mitigation_height_m": (0, 0.2, 0.02, 1.0),
}


def unpack(vector: FloatArray, types: int) -> WakeParameters:
    """Turn a packed vector into named parameters."""
    values: dict[str, Any] = {}
    for name, (axes, *_) in _LIMITS.items():
        part, vector = vector[: types**axes], vector[types**axes :]
        values[name] = part.reshape((types,) * axes) if axes else float(part[0])
    return WakeParameters(**values)


def fit_wake(rows: InteractionRows) -> WakeParameters:
    """Fit every parameter to the rows' vertical labels, in two passes.

    What no row shows has no force: a pair of types that never meets, the ground under a type that
    is the drone of no row.
    """
    types = len(rows.types)
    table, label = wake_rows(rows), rows.force_g[:, 2]
    limits = [limits for axes, *limits in _LIMITS.values() for _ in range(types**axes)]
    packed, low, high = np.array(limits).T
    weight = np.ones(len(rows))

    def left(vector: FloatArray) -> FloatArray:
        return wake_force_g(unpack(vector, types), table) - label

    def weighted(vector: FloatArray) -> FloatArray:
        return weight * left(vector)

    for _ in range(2):
        packed = least_squares(
            weighted, packed, bounds=(low, high), x_scale=high - low, xtol=1e-6
        ).x
        error = left(packed)
        for index in range(types):
            own = rows.ego_type == index
            if own.any():
                weight[own] = 1.0 / max(float(error[own].std()), 1e-6)
    found, felt = unpack(packed, types), np.isin(np.arange(types), rows.ego_type)
    return found._replace(
        amplitude_g=np.where(shown_pairs(rows), found.amplitude_g, 0.0),
        ground_g=np.where(felt, found.ground_g, 0.0),
    )


def draw_rows(rows: InteractionRows, seed: int, count: int = MOST_ROWS) -> InteractionRows:
    """So many training rows, drawn at random."""
    training = np.flatnonzero(~rows.validation)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(training, min(count, len(training)), replace=False)
    return rows.select(np.sort(chosen))


def description(
    w: WakeParameters, types: tuple[str, ...], drag: FloatArray, error: float
) -> dict[str, object]:
    """Content of `wake.json`, without its provenance. `"L>S"` is a large drone above a small."""
    index = {name: i for i, name in enumerate(types)}
    pairs = (w.amplitude_g, w.width_m, w.spread, w.decay)
    return {
        "format": "wake-1",
        "types": list(types),
        "pair": {
            f"{upper}>{lower}": dict(
                zip(("A_g", "w0_m", "S", "p"), (float(values[i, j]) for values in pairs))
            )
            for upper, i in index.items()
            for lower, j in index.items()
        },
        "advection_speed": {name: float(w.advection_speed[i]) for name, i in index.items()},
        "advection_velocity": "neighbor",
        "combine_q": w.combine_q,
        "ground": {
            name: {"G_g": float(w.ground_g[i]), "h_m": float(w.ground_height_m[i])}
            for name, i in index.items()
        },
        "mitigation": {"M": w.mitigation, "hm_m": w.mitigation_height_m},
        "drag": {name: drag[i].tolist() for name, i in index.items()},
        "window": OUTER_FADE._asdict(),
        "validation_mse_g2": error,
    }


def fit_wake_model(
    path: Path, treated: Treated, config: FitConfig, provenance: dict[str, object]
) -> tuple[FloatArray, list[str]]:
    """Fit the closed form by least squares and write it to `path`, with further keys `provenance`.

    The seed of `config` draws the rows, where there are more than `MOST_ROWS`.

    Returns:
        Its vertical force of every row with drag, (R,) gram-force, and what a user must know.
    """
    target = treated.target
    drawn = draw_rows(target, config.seed)
    fitted = fit_wake(drawn)
    predicted = wake_force_g(fitted, wake_rows(target))
    error = mean_squared_errors(predicted, target).overall
    content = description(fitted, target.types, treated.drag, error)
    content["input_range"] = measured_range(treated.rows)
    content["provenance"] = provenance | {"training_rows": len(drawn)}
    write_json(path, json_ready(content))
    drag_g = treated.drag[target.ego_type, 2] * target.velocity[:, 2] / GRAM_FORCE
    notes = [
        never_together(target.types[above], target.types[below]) + "it does not push it"
        for above, below in np.argwhere(~shown_pairs(drawn))
    ]
    return predicted - drag_g, notes
