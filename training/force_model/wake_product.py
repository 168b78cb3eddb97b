"""The closed-form wake as one of the models of `fit`: fitted, written, and judged as it is loaded.

`wake_fit` compares the two velocities that may tilt a jet, for the parameters that ship. Here the
upper drone's own is taken, which is what `swarm_envs.interactions` computes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from swarm_envs.files import write_json
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.forces import all_forces, types_array
from swarm_envs.training.force_model.config import FitConfig
from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.force_model.labels import Treated, measured_range
from swarm_envs.training.force_model.unseen import never_together, shown_pairs
from swarm_envs.training.force_model.wake_fit import WakeFit, description, fit_wake
from swarm_envs.training.force_model.wake_model import wake_force_g, wake_rows
from swarm_envs.training.interaction_rows.rows import FloatArray, InteractionRows
from swarm_envs.training.provenance import json_ready
from swarm_envs.vehicles import GRAM_FORCE

MOST_ROWS = 100_000
"""Training rows that the least squares look at, drawn at random: they take a minute."""


@dataclass(frozen=True)
class CompiledForce:
    """A model of `swarm_envs.interactions`, as `evaluate.ForceFunction` asks for one."""

    model: InteractionModel
    """The model that is evaluated."""

    @property
    def types(self) -> tuple[str, ...]:
        """Interaction types that it knows."""
        return self.model.types

    def force_g(self, position: Tensor, velocity: Tensor, type_names: Sequence[str]) -> Tensor:
        """Vertical force (E, N), gram-force, at (E, N, 3) m and m/s, drag included."""
        p, v = (np.ascontiguousarray(values.numpy()) for values in (position, velocity))
        kinds = np.tile(types_array(tuple(type_names), self.types), (len(p), 1))
        out = np.empty_like(p)
        all_forces(self.model.packed, kinds, p, v, out)
        return torch.from_numpy(out[..., 2] / GRAM_FORCE)


def fit_wake_model(
    path: Path, treated: Treated, config: FitConfig, provenance: dict[str, object]
) -> tuple[CompiledForce, FloatArray, list[str]]:
    """Fit the closed form by least squares and write it to `path`.

    Args:
        path: JSON file to write.
        treated: rows with the labels to fit.
        config: its seed draws the rows, where there are more than `MOST_ROWS`.
        provenance: further keys of the file.

    Returns:
        The model as it loads, its vertical force of every row with drag, (R,) gram-force, and
        what a user must know.
    """
    rng, target = np.random.default_rng(config.seed), treated.target
    training = np.flatnonzero(~target.validation)
    count = min(MOST_ROWS, len(training))
    chosen = target.select(np.sort(rng.choice(training, count, replace=False)))
    parameters = fit_wake(chosen, "neighbor")
    predicted = wake_force_g(parameters, wake_rows(target, "neighbor"))
    fitted = WakeFit("neighbor", parameters, mean_squared_errors(predicted, target))
    error = {"tilted by neighbor velocity": fitted.errors.overall}
    content = description(fitted, target.types, treated.drag, error)
    content["input_range"] = measured_range(treated.rows)
    content["provenance"] = provenance | {"training_rows": count}
    write_json(path, json_ready(content))
    drag_g = treated.drag[target.ego_type, 2] * target.velocity[:, 2] / GRAM_FORCE
    return CompiledForce(load(str(path))), predicted - drag_g, _unknown(chosen)


def _unknown(rows: InteractionRows) -> list[str]:
    """Pairs of types that no fitted row shows."""
    return [
        never_together(rows.types[above], rows.types[below]) + "it does not push it"
        for above, below in np.argwhere(~shown_pairs(rows))
    ]
