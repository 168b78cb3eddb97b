"""Evaluation of a force model: errors on rows, on-axis forces, extremes, and the report of a fit.

The target of Neural-Swarm2's eq. (8) and (10) is the vector [f_a; tau_a]. The authors learn f_a,z
only, because they found tau_a small (Sec. VII-B). A torque head has four outputs: f_a,z, and the
three components of tau_a *in the world frame*, because the network's inputs are in that frame and
do not include the attitude; in the body frame of eq. (1b) it is R^T tau_a. Labels and tables are in
N m; the network uses gram-force centimeters, whose magnitude is similar to that of forces.
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
from swarm_envs.training.force_model.labels import PreparedRows
from swarm_envs.training.force_model.lipschitz import steepest
from swarm_envs.training.force_model.network import DeepSet, ForceNetwork
from swarm_envs.training.force_model.train import to_batch
from swarm_envs.training.interaction_rows.calibration import subtract_offsets
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.vehicles import GRAM_FORCE

__all__ = ["Errors", "mean_squared_errors"]

_LEAST_ROWS = 50  # Least number of rows of a bin
_AXIS_M = 0.05  # Horizontal distance up to which rows count as on the axis, m


def vertical_force_g(
    model: InteractionModel, position: FloatArray, velocity: FloatArray, types: Sequence[str]
) -> FloatArray:
    """Return forces (E, N), gram-force, on drones at (E, N, 3), m and m/s, including drag."""
    kinds = np.tile(types_array(tuple(types), model.types), (len(position), 1))
    out = np.empty_like(position)
    all_forces(model.packed, kinds, position, velocity, out)
    return np.asarray(out[..., 2] / GRAM_FORCE)


@dataclass(frozen=True)
class Errors:
    """Mean squared errors of the vertical force on validation rows, g^2."""

    overall: float  # Error of the model on all rows
    zero: float  # Error of predicting zero force
    scenario_mean: float  # Error of predicting the mean of the scenario's training labels
    scenario: dict[str, float]  # Error of the model by scenario
    scenario_zero: dict[str, float]  # Error of predicting zero force, by scenario
    scenario_scenario_mean: dict[str, float]  # Error of predicting the mean, by scenario


def mean_squared_errors(predicted_g: FloatArray, rows: InteractionRows) -> Errors:
    """Return the errors of predicted forces (R,) and of trivial predictors on validation rows.

    The training rows determine the scenario means.

    Raises:
        ValueError: no row is held out.
    """
    label, held_out = rows.force_g[:, 2], rows.validation
    if not held_out.any():
        raise ValueError(f"none of the {len(rows)} rows is held out; give longer flights")
    mean = np.zeros(len(rows.scenario_names))
    for index in range(len(mean)):
        training = (rows.scenario == index) & ~held_out
        mean[index] = label[training].mean() if training.any() else 0.0
    found: list[float] = []
    by_scenario: list[dict[str, float]] = []
    for predicted in (predicted_g, np.zeros(len(rows)), mean[rows.scenario]):
        squared, scenario = (predicted - label)[held_out] ** 2, rows.scenario[held_out]
        found.append(float(squared.mean()))
        own = {name: squared[scenario == k] for k, name in enumerate(rows.scenario_names)}
        by_scenario.append({name: float(part.mean()) for name, part in own.items() if len(part)})
    overall, zero, scenario_mean = found
    return Errors(overall, zero, scenario_mean, *by_scenario)


def axis_bins(
    model: InteractionModel, predicted_g: FloatArray, rows: InteractionRows
) -> list[dict[str, Any]]:
    """Return mean forces below one neighbor by types and height, within 5 cm of its axis, g.

    `measured_g` is that of the labels, `model_g` that of the model on the same rows, and
    `model_on_axis_g` that of the model in the middle of the bin with both drones at rest. The list
    is empty if no row has a neighbor.
    """
    if not rows.has_neighbor.any():
        return []
    one = rows.has_neighbor.sum(axis=1) == 1
    slot = np.argmax(rows.has_neighbor, axis=1)
    pair = rows.neighbor[np.arange(len(rows)), slot]
    kind = rows.neighbor_type[np.arange(len(rows)), slot]
    centered = one & (np.hypot(pair[:, 0], pair[:, 1]) < _AXIS_M)
    bins = []
    for (below, lower), (above, upper), low in itertools.product(
        enumerate(rows.types), enumerate(rows.types), np.arange(0.1, 0.75, 0.1).tolist()
    ):
        inside = centered & (rows.ego_type == below) & (kind == above)
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
    """Return the force on a drone 1 m above the ground, `distance_m` below another, at rest, g."""
    position = np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + distance_m]]])
    return float(vertical_force_g(model, position, np.zeros_like(position), (below, above))[0, 0])


def scan_swarms(
    model: InteractionModel, drones: int, swarms: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the lowest and highest force, g, in dense random swarms `small_only` and `mixed`.

    Positions are uniform in a box of 0.6 x 0.6 x 1.5 m above 8 cm, velocities uniform in
    +-1 m/s per axis; drones may overlap.
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
    """Return the RMS errors of the torque (x, y, z) and of zero torque on held-out rows, N m."""
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
    """The evaluation of the written model."""

    rows: int  # Number of rows
    validation_rows: int  # Number of held-out rows
    errors: Errors  # Errors with labels as in training
    lipschitz_measured: dict[str, dict[str, float]]
    """Largest gradients of a network by number of neighbors; empty for the closed form."""
    axis_bins: list[dict[str, Any]]
    """Measured and modeled force below one neighbor, with labels as in training."""
    extremes: list[dict[str, Any]]  # Largest forces in random swarms by number of drones


@dataclass(frozen=True)
class FitReport:
    """The report of a fit, such as the content of `deep-set.json`."""

    model: str  # `deep-set`, `composed` or `wake`
    command: str  # The command
    config: object  # Its options
    data_sha256: str  # SHA-256 of the data
    vehicle_offsets_g: dict[str, float]  # Offset of each vehicle, gram-force
    drag: dict[str, list[float]]  # c per type and axis, N s/m
    findings: Findings  # The evaluation
    history: list[dict[str, float]]
    """Steps, mean training loss since the last entry, and validation MSE, g^2."""
    wall_time_s: float
    """The time of reading, training and evaluation, s."""
    logs: list[FileReport]  # The result of reading every file
    notes: list[str]  # Warnings, such as vehicle types without rows
    torque_errors: dict[str, list[float]] | None = None
    """Errors of the torque on held-out rows; None without a torque head."""

    def lines(self) -> list[str]:
        """Return the lines that a command prints."""
        errors = self.findings.errors
        offsets = [f"vehicle {n}: offset {g:+.2f} g" for n, g in self.vehicle_offsets_g.items()]
        return [
            *(file.line() for file in self.logs),
            f"{self.findings.rows} rows, {self.findings.validation_rows} of them held out",
            *(offsets or ["calibration offsets are not subtracted from the labels"]),
            *(f"note: {note}" for note in self.notes),
            f"{self.model}: validation MSE {errors.overall:.2f} g^2 (of zero force: "
            f"{errors.zero:.2f}, of the scenario's mean: {errors.scenario_mean:.2f})",
        ]


def evaluate_model(
    model: InteractionModel, prepared: PreparedRows, seed: int, network: ForceNetwork | None = None
) -> Findings:
    """Evaluate a fitted model that was loaded from its file.

    `network` is the model in torch, whose gradients are computed; None to omit them.
    """
    rng, predicted_g = np.random.default_rng(seed), modelled_force_g(prepared.rows, model)[:, 2]
    rows, free = prepared.rows, subtract_offsets(prepared.rows, prepared.offsets)
    measured = {}
    if network is not None:
        measured = {str(count): steepest(network, count, rng) for count in (1, 2)}
    return Findings(
        rows=len(rows),
        validation_rows=int(rows.validation.sum()),
        errors=mean_squared_errors(predicted_g, free),
        lipschitz_measured=measured,
        axis_bins=axis_bins(model, predicted_g, free),
        extremes=[scan_swarms(model, size, _SWARMS, rng) for size in _SWARM_SIZES],
    )
