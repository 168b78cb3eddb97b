"""Fit of the closed-form wake to rows: `python -m swarm_envs.training.force_model.wake_fit`.

Least squares over every parameter at once, on training rows whose labels are free of calibration
offsets and of the vertical drag. Drones of different types have very different residuals, so a
second pass weighs each type's rows by what the first left over.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.optimize import least_squares

from swarm_envs.files import write_json
from swarm_envs.training.force_model.drag import fit_drag
from swarm_envs.training.force_model.evaluate import Errors, mean_squared_errors
from swarm_envs.training.force_model.labels import measured_range
from swarm_envs.training.force_model.network import OUTER_FADE
from swarm_envs.training.force_model.unseen import shown_pairs
from swarm_envs.training.force_model.wake_model import (
    WakeParameters,
    WakeRows,
    WakeVelocity,
    wake_force_g,
    wake_rows,
)
from swarm_envs.training.interaction_rows.calibration import (
    RULE,
    estimate_offsets,
    subtract_offsets,
)
from swarm_envs.training.interaction_rows.rows import FloatArray, InteractionRows, read_rows
from swarm_envs.training.provenance import file_sha256, json_ready
from swarm_envs.vehicles import GRAM_FORCE

_PER_PAIR = {  # start, lowest, highest
    "amplitude_g": (20.0, 0.0, 80.0),
    "width_m": (0.05, 0.01, 0.2),
    "spread": (0.05, 0.0, 0.5),
    "decay": (1.5, 0.2, 3.0),
}
_PER_TYPE = {
    "advection_speed": (3.0, 0.3, 50.0),
    "ground_g": (5.0, 0.0, 30.0),
    "ground_height_m": (0.05, 0.01, 0.3),
}
_SHARED = {
    "combine_q": (1.4, 1.0, 5.0),
    "mitigation": (0.4, 0.0, 1.0),
    "mitigation_height_m": (0.2, 0.02, 1.0),
}


@dataclass(frozen=True, kw_only=True)
class WakeFitConfig:
    """What to fit the wake to."""

    data: Path
    """file of rows"""
    out: Path
    """folder for `wake.json`"""
    rows: int = 100_000
    """training rows to use, drawn at random"""
    seed: int = 0
    """of that draw"""


@dataclass(frozen=True)
class WakeFit:
    """One fitted variant."""

    velocity: WakeVelocity
    """Which velocity tilts the jets."""
    parameters: WakeParameters
    """The numbers that were fitted."""
    errors: Errors
    """Errors on the rows that were held out."""


def bounds(types: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start, lowest and highest value of the packed parameters."""
    groups = ((_PER_PAIR, types * types), (_PER_TYPE, types), (_SHARED, 1))
    columns = [[limits] * count for group, count in groups for limits in group.values()]
    table = np.array([limits for column in columns for limits in column])
    return table[:, 0], table[:, 1], table[:, 2]


def unpack(vector: FloatArray, types: int) -> WakeParameters:
    """Turn a packed vector into named parameters."""
    values: dict[str, FloatArray] = {}
    begin = 0
    for name in _PER_PAIR:
        values[name] = vector[begin : begin + types * types].reshape(types, types)
        begin += types * types
    for name in _PER_TYPE:
        values[name] = vector[begin : begin + types]
        begin += types
    combine, mitigation, height = (float(value) for value in vector[begin:])
    return WakeParameters(
        **values, combine_q=combine, mitigation=mitigation, mitigation_height_m=height
    )


def fit_wake(rows: InteractionRows, velocity: WakeVelocity) -> WakeParameters:
    """Fit every parameter to the rows' vertical labels, in two passes.

    What no row shows has no force: a pair of types that never meets, the ground under a type that
    is the drone of no row.
    """
    types = len(rows.types)
    table, label = wake_rows(rows, velocity), rows.force_g[:, 2]
    start, low, high = bounds(types)
    weight = np.ones(len(rows))
    for _ in range(2):
        start = _least_squares(table, label, weight, types, (start, low, high))
        left = wake_force_g(unpack(start, types), table) - label
        for index in range(types):
            own = rows.ego_type == index
            if own.any():
                weight[own] = 1.0 / max(float(left[own].std()), 1e-6)
    found, felt = unpack(start, types), np.isin(np.arange(types), rows.ego_type)
    return found._replace(
        amplitude_g=np.where(shown_pairs(rows), found.amplitude_g, 0.0),
        ground_g=np.where(felt, found.ground_g, 0.0),
    )


def _least_squares(
    table: WakeRows,
    label: FloatArray,
    weight: FloatArray,
    types: int,
    limits: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    start, low, high = limits

    def residual(vector: FloatArray) -> FloatArray:
        return weight * (wake_force_g(unpack(vector, types), table) - label)

    result = least_squares(residual, start, bounds=(low, high), x_scale=high - low, xtol=1e-6)
    return np.asarray(result.x)


def fit_variants(rows: InteractionRows, config: WakeFitConfig) -> list[WakeFit]:
    """Fit both kinds of tilt to a draw of training rows; validate on all held-out rows."""
    rng = np.random.default_rng(config.seed)
    training = np.flatnonzero(~rows.validation)
    count = min(config.rows, len(training))
    chosen = rows.select(np.sort(rng.choice(training, count, replace=False)))
    fits = []
    velocities: tuple[WakeVelocity, ...] = ("relative", "neighbor")
    for velocity in velocities:
        parameters = fit_wake(chosen, velocity)
        predicted = wake_force_g(parameters, wake_rows(rows, velocity))
        fits.append(WakeFit(velocity, parameters, mean_squared_errors(predicted, rows)))
    return fits


def description(
    fit: WakeFit, types: tuple[str, ...], drag: FloatArray, ends: dict[str, float]
) -> dict[str, object]:
    """Content of `wake.json`, without its provenance. `"L>S"` is a large drone above a small."""
    w = fit.parameters
    index = {name: i for i, name in enumerate(types)}
    pair = {
        f"{upper}>{lower}": {
            "A_g": float(w.amplitude_g[i, j]),
            "w0_m": float(w.width_m[i, j]),
            "S": float(w.spread[i, j]),
            "p": float(w.decay[i, j]),
        }
        for upper, i in index.items()
        for lower, j in index.items()
    }
    return {
        "format": "wake-1",
        "types": list(types),
        "pair": pair,
        "advection_speed": {name: float(w.advection_speed[i]) for name, i in index.items()},
        "advection_velocity": fit.velocity,
        "combine_q": w.combine_q,
        "ground": {
            name: {"G_g": float(w.ground_g[i]), "h_m": float(w.ground_height_m[i])}
            for name, i in index.items()
        },
        "mitigation": {"M": w.mitigation, "hm_m": w.mitigation_height_m},
        "drag": {name: drag[i].tolist() for name, i in index.items()},
        "window": OUTER_FADE._asdict(),
        "validation_mse_g2": ends,
    }


def run(config: WakeFitConfig) -> dict[str, object]:
    """Fit the wake and write `wake.json` into `config.out`."""
    began = time.perf_counter()
    rows = read_rows(config.data)
    drag = fit_drag(rows)
    rows = subtract_offsets(rows, estimate_offsets(rows))
    vertical_g = drag[rows.ego_type, 2] * rows.velocity[:, 2] / GRAM_FORCE
    rows = rows.with_vertical_force(rows.force_g[:, 2] + vertical_g)
    fits = fit_variants(rows, config)
    best = next(fit for fit in fits if fit.velocity == "neighbor")  # which the kernels compute
    ends = {f"tilted by {fit.velocity} velocity": fit.errors.overall for fit in fits}
    ends |= {"zero": best.errors.zero, "scenario mean": best.errors.scenario_mean}
    content = description(best, rows.types, drag, ends)
    content["validation_mse_g2_by_scenario"] = best.errors.scenario
    content["input_range"] = asdict(measured_range(rows))
    content["provenance"] = {
        "data": config.data.name,
        "data_sha256": file_sha256(config.data),
        "offset_rule": RULE,
        "training_rows": config.rows,
        "seed": config.seed,
        "wall_time_s": round(time.perf_counter() - began, 1),
    }
    write_json(config.out / "wake.json", json_ready(content))
    return content


if __name__ == "__main__":
    fitted = run(tyro.cli(WakeFitConfig, description="Fit the closed-form wake to rows."))
    print(fitted["validation_mse_g2"])  # noqa: T201
