"""How well a force model fits rows, and where its values are absurd."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from swarm_envs.training.force_model.network import ForceNetwork
from swarm_envs.training.force_model.train import predict, to_batch
from swarm_envs.training.interaction_rows.rows import BoolArray, FloatArray, InteractionRows
from swarm_envs.vehicles import GRAM_FORCE

_AXIS_M = 0.05  # the measured bins count everything within this lateral distance as on the axis


class ForceFunction(Protocol):
    """A model of any kind, as it is judged here."""

    @property
    def types(self) -> tuple[str, ...]:
        """Return the interaction types that it knows."""
        ...

    def force_g(self, position: Tensor, velocity: Tensor, type_names: Sequence[str]) -> Tensor:
        """Vertical force (E, N), gram-force, at (E, N, 3) m and m/s, drag included."""
        ...


@dataclass(frozen=True)
class Errors:
    """Mean squared errors of the vertical force on validation rows, g^2."""

    overall: float
    """Mean squared error of all rows, g^2."""
    zero: float
    """Of predicting no force."""
    scenario_mean: float
    """Of predicting the mean of the scenario's training labels."""
    scenario: dict[str, float]
    """Of the model by scenario."""
    scenario_zero: dict[str, float]
    """The same of a model that says nothing, by scenario."""
    scenario_scenario_mean: dict[str, float]
    """The same of one that says the scenario's mean."""


@dataclass(frozen=True)
class AxisBin:
    """One bin of vertical distance under a single neighbour, lateral distance below 5 cm."""

    above: str
    """Type of the upper drone."""
    below: str
    """Type of the lower one."""
    lowest_m: float
    """Least distance in height, m."""
    highest_m: float
    """Largest distance in height, m."""
    rows: int
    """Rows in it."""
    measured_g: float
    """Mean of the labels."""
    model_g: float
    """Mean of the model on the same rows."""
    model_on_axis_g: float
    """The model in the middle of the bin, exactly on the axis, both drones at rest."""


@dataclass(frozen=True)
class Extremes:
    """Largest downward and upward force on any drone in random swarms, g."""

    drones: int
    """Number of drones."""
    small_only: tuple[float, float]
    """Lowest and highest force in swarms of small drones, g."""
    mixed: tuple[float, float]
    """The same in mixed swarms, g."""


def mean_squared_errors(predicted_g: FloatArray, rows: InteractionRows) -> Errors:
    """Compare predictions with the labels on validation rows, beside trivial predictors.

    Args:
        predicted_g: (R,) vertical force predicted for every row.
        rows: all rows; only the validation rows count, the others give the scenario means.
    """
    label = rows.force_g[:, 2]
    held_out = rows.validation
    mean = np.zeros(len(rows.scenario_names))
    for index in range(len(mean)):
        training = (rows.scenario == index) & ~held_out
        mean[index] = label[training].mean() if training.any() else 0.0
    residuals = {
        "model": (predicted_g - label)[held_out] ** 2,
        "zero": label[held_out] ** 2,
        "mean": (mean[rows.scenario] - label)[held_out] ** 2,
    }
    by_scenario: dict[str, dict[str, float]] = {}
    for kind, squared in residuals.items():
        by_scenario[kind] = {
            name: float(squared[rows.scenario[held_out] == index].mean())
            for index, name in enumerate(rows.scenario_names)
            if (rows.scenario[held_out] == index).any()
        }
    overall = {kind: float(squared.mean()) for kind, squared in residuals.items()}
    return Errors(
        overall["model"],
        overall["zero"],
        overall["mean"],
        by_scenario["model"],
        by_scenario["zero"],
        by_scenario["mean"],
    )


def predict_rows(network: ForceNetwork, rows: InteractionRows) -> FloatArray:
    """Vertical force of every row from the network and the drag, (R,) in gram-force."""
    force = predict(network, to_batch(rows, torch.float64)).numpy()
    drag = network.drag.numpy()[rows.ego_type, 2]
    return np.asarray(force - drag * rows.velocity[:, 2] / GRAM_FORCE)


def axis_bins(
    network: ForceFunction, predicted_g: FloatArray, rows: InteractionRows
) -> list[AxisBin]:
    """Compare measured and modelled force under one neighbour, by vertical distance."""
    one = rows.has_neighbor.sum(axis=1) == 1
    slot = np.argmax(rows.has_neighbor, axis=1)
    pair = rows.neighbor[np.arange(len(rows)), slot]
    kind = rows.neighbor_type[np.arange(len(rows)), slot]
    centred = one & (np.hypot(pair[:, 0], pair[:, 1]) < _AXIS_M)
    bins = []
    for below, below_name in enumerate(rows.types):
        for above, above_name in enumerate(rows.types):
            chosen = centred & (rows.ego_type == below) & (kind == above)
            for low in np.arange(0.1, 0.75, 0.1):
                inside = chosen & (pair[:, 2] >= low) & (pair[:, 2] < low + 0.1)
                if inside.sum() >= 50:
                    middle = pair_force(network, below_name, above_name, low + 0.05)
                    bins.append(
                        _bin(above_name, below_name, low, inside, rows, predicted_g, middle)
                    )
    return bins


def _bin(
    above: str,
    below: str,
    low: float,
    inside: BoolArray,
    rows: InteractionRows,
    predicted_g: FloatArray,
    middle: float,
) -> AxisBin:
    measured = float(rows.force_g[inside, 2].mean())
    modelled = float(predicted_g[inside].mean())
    edges = (round(float(low), 3), round(float(low) + 0.1, 3))
    return AxisBin(above, below, *edges, int(inside.sum()), measured, modelled, middle)


def pair_force(network: ForceFunction, below: str, above: str, distance_m: float) -> float:
    """Force on a drone at rest, `distance_m` under another one at rest, 1 m above the ground, g."""
    position = torch.tensor([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + distance_m]]], dtype=torch.float64)
    with torch.no_grad():
        force = network.force_g(position, torch.zeros_like(position), (below, above))
    return float(force[0, 0])


def scan_swarms(
    network: ForceFunction, drones: int, swarms: int, rng: np.random.Generator
) -> Extremes:
    """Largest forces in random swarms, packed so that many share one interaction volume.

    Positions are uniform in a box of 0.6 x 0.6 x 1.5 m above 8 cm, velocities uniform in
    +-1 m/s per axis; no minimum distance is kept, so drones may overlap.
    """
    position = torch.from_numpy(rng.uniform(0.0, 1.0, (swarms, drones, 3)) * [0.6, 0.6, 1.5])
    position[..., 2] += 0.08
    velocity = torch.from_numpy(rng.uniform(-1.0, 1.0, (swarms, drones, 3)))
    first, last = network.types[0], network.types[-1]
    teams = [(first,) * drones, tuple(last if i % 2 else first for i in range(drones))]
    found = []
    for team in teams:
        with torch.no_grad():
            force = network.force_g(position, velocity, team)
        found.append((float(force.min()), float(force.max())))
    return Extremes(drones, *found)
