"""The assignment `force-model`: fit and predict in the submission's process, score in the grader.

The flights for fit and score are simulated for each grading from its secret seed, so that no
submission can know their labels.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.grading.assignment import Assignment
from swarm_envs.grading.copies import ALIKE, copied_files, harmless, known_forces
from swarm_envs.grading.pipes import Array
from swarm_envs.grading.submission import Entry, RemoteWork, WorkFailed
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.training.interaction_rows.rows import ROW_ARRAYS

_SAME = 0.995
"""Correlation of predictions at which a model counts as a copy. Included models, which were fitted
to the same flights by different methods, reach 0.988."""


class ForceModel(Assignment):
    """Learn the downwash from flight logs of the hall."""

    name = "force-model"
    work = "force_model.py:MyModel"
    metric = "explained"
    zero, full = 0.25, 0.88
    counted = ""

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return `explained` of a student's model, and `copied`."""
        rows, held_out = (collected(seed) for seed in (entry.seeds[0], entry.seeds[0] + 1))
        copied = harmless(copied_files, entry.home, entry.work)
        with entry.opened() as (work, _):
            found = grade_model(work, rows, held_out, entry.seeds[0] + 2)
        return {**found, "copied": copied or found["copied"]}


@cache
def collected(seed: int) -> InteractionRows:
    """Simulate 20 flights of two small drones in the hall, and return the rows of their logs."""
    from swarm_envs.training.collection.collect import CollectionConfig, collect
    from swarm_envs.training.collection.table import interaction_rows

    config = CollectionConfig(teams=("SS",), world="hall", seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        return interaction_rows(collect(config, Path(folder), progress=False), config.label)


def explained_share(predicted: Array, truth: Array) -> float:
    """Return the fraction of the squared vertical force (R,) that a prediction (R,) explains.

    It is 1 for no error, 0 for a prediction of zero force, and negative if worse than that.
    """
    return float(1.0 - np.mean(np.square(predicted - truth)) / np.mean(np.square(truth)))


def grade_model(
    work: RemoteWork, rows: InteractionRows, held_out: InteractionRows, seed: int
) -> dict[str, Any]:
    """Fit a student's model to rows, score it on others, and compare it with included models.

    The model receives the other rows without labels, mixed with as many whose velocities are
    exchanged. The truth is the simulated force, because the noise of labels would change the score.

    Args:
        work: the student's model.
        rows: the rows for the fit.
        held_out: the rows for the score.
        seed: the secret seed of the order of rows and of the exchange.

    Raises:
        WorkFailed: it failed, or does not predict one finite number per row.
    """
    work.ask("fit", *_packed(rows))
    rng = np.random.default_rng(seed)
    order = rng.permutation(2 * len(held_out))
    moved = exchanged(held_out, rng)
    both = _joined(held_out, moved).select(order)
    predicted = np.empty(len(order))
    predicted[order] = _predicted(work, both)
    own, other = np.split(predicted, 2)
    typed = _of_large(held_out)
    changes = [(moved, other - own)]
    with suppress(WorkFailed, ValueError):  # a model may support small drones only
        changes.append((typed, _predicted(work, typed) - own))
    copied = harmless(copied_forces, held_out, own, changes)
    truth = modelled_force_g(held_out, "learned")[:, 2]
    return {"explained": explained_share(own, truth), "copied": copied}


def copied_forces(
    rows: InteractionRows, own: Array, changes: list[tuple[InteractionRows, Array]]
) -> str:
    """Return the name of the included model whose predictions change similarly, or "".

    Args:
        rows: rows.
        own: (R,) the submission's predictions for them, gram-force.
        changes: changed rows, and the changes of the predictions (R,).
    """
    found = {"": ALIKE}
    for name, model in known_forces().items():
        before = modelled_force_g(rows, model)[:, 2]
        alike = [_correlation(modelled_force_g(r, model)[:, 2] - before, d) for r, d in changes]
        same = _correlation(before, own) > _SAME
        found[name] = 1.0 if same else max(alike)
    return max(found, key=found.__getitem__)


def _correlation(one: Array, other: Array) -> float:
    spread = float(np.std(one) * np.std(other))
    return float(np.mean((one - one.mean()) * other)) / spread if spread > 1e-9 else 0.0


def exchanged(rows: InteractionRows, rng: np.random.Generator) -> InteractionRows:
    """Return rows with the velocities of other rows."""
    other = rng.permutation(len(rows))
    neighbor = rows.neighbor.copy()
    neighbor[..., 3:] = np.where(rows.has_neighbor[..., None], neighbor[other][..., 3:], 0.0)
    return dataclasses.replace(rows, neighbor=neighbor, velocity=rows.velocity[other])


def _of_large(rows: InteractionRows) -> InteractionRows:
    """Return rows whose neighbors are large drones, which do not occur in the flights."""
    large = np.where(rows.has_neighbor, len(rows.types) - 1, rows.neighbor_type)
    return dataclasses.replace(rows, neighbor_type=large)


def _joined(one: InteractionRows, other: InteractionRows) -> InteractionRows:
    pairs = ((name, getattr(one, name), getattr(other, name)) for name in ROW_ARRAYS)
    both: dict[str, Any] = {name: np.concatenate(pair) for name, *pair in pairs}
    return dataclasses.replace(one, torque=None, **both)


def _predicted(work: RemoteWork, rows: InteractionRows) -> Array:
    """Return the submission's predictions for rows without their labels.

    Raises:
        WorkFailed: it failed, or does not predict one finite number per row.
    """
    hidden = dataclasses.replace(rows, force_g=np.zeros_like(rows.force_g), torque=None)
    _, given = work.ask("predict", *_packed(hidden), most=8 * len(rows))
    if len(given) != 1 or given[0].shape != (len(rows),) or not np.isfinite(given[0]).all():
        shape = given[0].shape if given else ()
        raise WorkFailed(
            f"predict() returned an array of shape {shape}, but must return {len(rows)} finite "
            "numbers, one per row"
        )
    return given[0].astype(np.float64)


def _packed(rows: InteractionRows) -> tuple[Mapping[str, Any], list[Array]]:
    """Return header and arrays of a message with rows."""
    names = [name for name in ROW_ARRAYS if getattr(rows, name) is not None]
    header = {"names": names, "types": rows.types, "scenario_names": rows.scenario_names}
    return header, [getattr(rows, name) for name in names]
