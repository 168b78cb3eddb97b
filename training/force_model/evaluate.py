"""Evaluation of a force model: errors on rows, on-axis forces, extremes, and the report of a fit.

The target of Neural-Swarm2's eq. (8) and (10) is the vector [f_a; tau_a]. The authors learn f_a,z
alone, since they found tau_a small (Sec. VII-B). A torque head gives four numbers: f_a,z, and the
three components of tau_a *in the world frame*, since the network's inputs are of that frame and
attitude is none of them; in the body frame of eq. (1b) it is R^T tau_a. Labels and tables hold N m;
inside, torques are counted in gram-force centimeters, of the size of forces in gram-force.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.forces import all_forces, types_array
from swarm_envs.interactions.torque import GRAM_CENTIMETRE
from swarm_envs.state import FloatArray
from swarm_envs.training.flight_logs.read import FileReport
from swarm_envs.training.force_model.labels import Treated
from swarm_envs.training.force_model.lipschitz import steepest
from swarm_envs.training.force_model.network import DeepSet, ForceNetwork
from swarm_envs.training.force_model.train import to_batch
from swarm_envs.training.interaction_rows.calibration import subtract_offsets
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.vehicles import GRAM_FORCE

_LEAST_ROWS = 50  # of a bin
_AXIS_M = 0.05  # the measured bins count everything within this lateral distance as on the axis


def vertical_force_g(
    model: InteractionModel, position: FloatArray, velocity: FloatArray, types: Sequence[str]
) -> FloatArray:
    """Force (E, N), gram-force, on drones of these types at (E, N, 3), m and m/s, drag included."""
    kinds = np.tile(types_array(tuple(types), model.types), (len(position), 1))
    out = np.empty_like(position)
    all_forces(model.packed, kinds, position, velocity, out)
    return np.asarray(out[..., 2] / GRAM_FORCE)


@dataclass(frozen=True)
class Errors:
    """Mean squared errors of the vertical force on validation rows, g^2."""

    overall: float  # Mean squared error of all rows, g^2
    zero: float  # Of predicting no force
    scenario_mean: float  # Of predicting the mean of the scenario's training labels
    scenario: dict[str, float]  # Of the model by scenario
    scenario_zero: dict[str, float]  # The same of a model that says nothing, by scenario
    scenario_scenario_mean: dict[str, float]  # The same of one that says the scenario's mean


def mean_squared_errors(predicted_g: FloatArray, rows: InteractionRows) -> Errors:
    """Compare forces (R,) predicted for every row with the labels, beside trivial predictors.

    Only the validation rows count; the others give the scenario means.
    """
    label, held_out = rows.force_g[:, 2], rows.validation
    mean = np.zeros(len(rows.scenario_names))
    for index in range(len(mean)):
        training = (rows.scenario == index) & ~held_out
        mean[index] = label[training].mean() if training.any() else 0.0
    found: list[float] = []
    by_scenario: list[dict[str, float]] = []
    for said in (predicted_g, np.zeros(len(rows)), mean[rows.scenario]):
        squared, scenario = (said - label)[held_out] ** 2, rows.scenario[held_out]
        found.append(float(squared.mean()))
        own = {name: squared[scenario == k] for k, name in enumerate(rows.scenario_names)}
        by_scenario.append({name: float(part.mean()) for name, part in own.items() if len(part)})
    overall, zero, scenario_mean = found
    return Errors(overall, zero, scenario_mean, *by_scenario)


def axis_bins(
    model: InteractionModel, predicted_g: FloatArray, rows: InteractionRows
) -> list[dict[str, Any]]:
    """Mean force under one neighbor by types and vertical distance, within 5 cm of its axis, g.

    `measured_g` are the labels, `model_g` the model on the same rows, `model_on_axis_g` the model
    in the middle of the bin, both drones at rest. Empty if no row has a neighbor.
    """
    if not rows.has_neighbor.any():
        return []
    one = rows.has_neighbor.sum(axis=1) == 1
    slot = np.argmax(rows.has_neighbor, axis=1)
    pair = rows.neighbor[np.arange(len(rows)), slot]
    kind = rows.neighbor_type[np.arange(len(rows)), slot]
    centred = one & (np.hypot(pair[:, 0], pair[:, 1]) < _AXIS_M)
    bins = []
    for (below, lower), (above, upper), low in itertools.product(
        enumerate(rows.types), enumerate(rows.types), np.arange(0.1, 0.75, 0.1).tolist()
    ):
        inside = centred & (rows.ego_type == below) & (kind == above)
        inside &= (pair[:, 2] >= low) & (pair[:, 2] < low + 0.1)
        if inside.sum() < _LEAST_ROWS:
            continue
        bins.append(
            {
                "above": upper,
                "below": lower,
                "lowest_m": round(low, 3),
                "highest_m": round(low + 0.1, 3),
                "rows": int(inside.sum()),
                "measured_g": float(rows.force_g[inside, 2].mean()),
                "model_g": float(predicted_g[inside].mean()),
                "model_on_axis_g": pair_force(model, lower, upper, low + 0.05),
            }
        )
    return bins


def pair_force(model: InteractionModel, below: str, above: str, distance_m: float) -> float:
    """Force on a drone at rest, `distance_m` under another one at rest, 1 m above the ground, g."""
    position = np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + distance_m]]])
    return float(vertical_force_g(model, position, np.zeros_like(position), (below, above))[0, 0])


def scan_swarms(
    model: InteractionModel, drones: int, swarms: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Lowest and highest force, g, in random swarms `small_only` and `mixed`, packed closely.

    Positions are uniform in a box of 0.6 x 0.6 x 1.5 m above 8 cm, velocities uniform in
    +-1 m/s per axis; no minimum distance is kept, so drones may overlap.
    """
    position = rng.uniform(0.0, 1.0, (swarms, drones, 3)) * [0.6, 0.6, 1.5]
    position[..., 2] += 0.08
    velocity = rng.uniform(-1.0, 1.0, (swarms, drones, 3))
    first, last = model.types[0], model.types[-1]
    teams = [(first,) * drones, tuple(last if i % 2 else first for i in range(drones))]
    found = []
    for team in teams:
        force = vertical_force_g(model, position, velocity, team)
        found.append((float(force.min()), float(force.max())))
    return {"drones": drones, "small_only": found[0], "mixed": found[1]}


def torque_errors(network: DeepSet, rows: InteractionRows) -> dict[str, list[float]]:
    """Root mean square of the torque's error on held-out rows by component x, y, z, N m.

    Beside that of predicting none.
    """
    held_out = rows.select(rows.validation)
    assert held_out.torque is not None
    with torch.no_grad():
        heads = network.heads(to_batch(held_out, torch.float64)).numpy()
    error = heads[:, 1:] * GRAM_CENTIMETRE - held_out.torque
    found = {"error_n_m": error, "zero_n_m": held_out.torque}
    return {name: np.sqrt(np.mean(v**2, axis=0)).tolist() for name, v in found.items()}


_SWARM_SIZES = (2, 3, 5, 8, 16)
_SWARMS = 2000


@dataclass(frozen=True)
class Findings:
    """The measurements on the weights as they ship."""

    rows: int  # Rows there were
    validation_rows: int  # Those of them that were held out
    errors: Errors  # Against labels treated as in training
    errors_raw: Errors  # Against labels as measured
    lipschitz_measured: dict[str, dict[str, float]]
    """Of a network, by number of neighbors; empty of the closed form."""
    axis_bins: list[dict[str, Any]]
    """Measured and modeled force under one neighbor; labels treated as in training."""
    extremes: list[dict[str, Any]]  # Largest forces in random swarms by number of drones


@dataclass(frozen=True)
class FitReport:
    """The report of a fit: the content of `learned.json`, whatever the model."""

    model: str  # `deep-set`, `composed` or `wake`
    command: str  # The command that was run
    config: object  # Its options
    data_sha256: str  # SHA-256 of the data
    offset_rule: str  # How offsets were taken out of the labels, in words
    vehicle_offsets_g: dict[str, float]  # Offset of each vehicle, gram-force
    drag: dict[str, list[float]]  # c per type and axis, N s/m
    findings: Findings  # What came out
    history: list[dict[str, float]]
    """Steps, mean training loss since the last entry, and validation MSE, g^2."""
    wall_time_s: float
    """Of reading, training and evaluation."""
    logs: list[FileReport]  # What became of every file
    notes: list[str]  # What a user of the model must know: types that no row shows
    torque_errors: dict[str, list[float]] | None = None
    """On held-out rows, if there is a torque head."""

    def lines(self) -> list[str]:
        """Return the lines that a command prints."""
        errors = self.findings.errors
        offsets = [f"vehicle {n}: offset {g:+.2f} g" for n, g in self.vehicle_offsets_g.items()]
        return [
            *(file.line() for file in self.logs),
            f"{self.findings.rows} rows, {self.findings.validation_rows} of them held out",
            *(offsets or ["calibration offsets are not subtracted: labels are as measured"]),
            *(f"note: {note}" for note in self.notes),
            f"{self.model}: validation MSE {errors.overall:.2f} g^2 (zero {errors.zero:.2f}, "
            f"scenario mean {errors.scenario_mean:.2f})",
        ]


def worth(errors: Errors) -> list[str]:
    """A note if a model is no better than one of the trivial ones."""
    trivial = {"of predicting nothing": errors.zero, "of the scenario mean": errors.scenario_mean}
    better = [f"that {name} ({e:.2f})" for name, e in trivial.items() if errors.overall >= e]
    if not better:
        return []
    return [
        f"the model explains nothing: its validation MSE {errors.overall:.2f} g^2 is not below "
        f"{' nor '.join(better)}; fly more, nearer to each other, or train for more steps"
    ]


def examine(
    model: InteractionModel, treated: Treated, seed: int, network: ForceNetwork | None = None
) -> Findings:
    """Measure a fitted model as it loads from its file.

    `network` is the model in torch, whose gradients are measured; None leaves them out.
    """
    rng, predicted_g = np.random.default_rng(seed), modelled_force_g(treated.rows, model)[:, 2]
    rows, free = treated.rows, subtract_offsets(treated.rows, treated.offsets)
    measured = {}
    if network is not None:
        measured = {str(count): steepest(network, count, rng) for count in (1, 2)}
    return Findings(
        rows=len(rows),
        validation_rows=int(rows.validation.sum()),
        errors=mean_squared_errors(predicted_g, free),
        errors_raw=mean_squared_errors(predicted_g, rows),
        lipschitz_measured=measured,
        axis_bins=axis_bins(model, predicted_g, free),
        extremes=[scan_swarms(model, size, _SWARMS, rng) for size in _SWARM_SIZES],
    )
