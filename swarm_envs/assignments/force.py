"""The assignment `force-model`: fitted and asked in its process, judged in the grader's.

The flights, for training and for the mark, are flown for each grading from its secret seed, so that
no file holds a label and no work can fly them again.
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
"""Correlation of predictions from which on they are another model's. Those that ship, which were
fitted to the same flights in different ways, reach 0.988."""


class ForceModel(Assignment):
    """Learn the downwash from flight logs of the hall."""

    name = "force-model"
    work = "force_model.py:MyModel"
    metric = "explained"
    zero, full = 0.25, 0.88
    counted = ""

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return how good a student's model is, as `score`, and whose it is, as `copied`."""
        rows, held_out = (collected(seed) for seed in (entry.seeds[0], entry.seeds[0] + 1))
        copied = harmless(copied_files, entry.home, entry.work)
        with entry.opened() as (work, _):
            found = grade_model(work, rows, held_out, entry.seeds[0] + 2)
        return {**found, "copied": copied or found["copied"]}


@cache
def collected(seed: int) -> InteractionRows:
    """Fly 20 flights of two small drones in the hall, and return the rows of their logs."""
    from swarm_envs.training.collection.collect import CollectionConfig, collect
    from swarm_envs.training.collection.table import interaction_rows

    config = CollectionConfig(teams=("SS",), world="hall", seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        return interaction_rows(collect(config, Path(folder), progress=False), config.label)


def score(predicted: Array, truth: Array) -> dict[str, float]:
    """Return how good vertical forces (R,) are, gram-force.

    `error_g`: their root mean square error; `baseline_g`: that of no force at all; `explained`: the
    share of the baseline's square that is gone, 1 for no error, negative for worse than nothing.
    """
    error, baseline = np.mean(np.square(predicted - truth)), np.mean(np.square(truth))
    return {
        "error_g": float(np.sqrt(error)),
        "baseline_g": float(np.sqrt(baseline)),
        "explained": float(1.0 - error / baseline),
    }


def grade_model(
    work: RemoteWork, rows: InteractionRows, held_out: InteractionRows, seed: int
) -> dict[str, Any]:
    """Fit a student's model to rows, score it on others, and compare it with those that ship.

    It is given no label of the others, among which are as many with their velocities exchanged. The
    truth is the force of the simulation: the noise of labels would change marks with the seed.

    Args:
        work: the student's model.
        rows: to fit it to.
        held_out: to score it on.
        seed: a secret one of the order of rows, and of the exchange.

    Raises:
        WorkFailed: it failed, or does not predict one finite number a row.
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
    with suppress(WorkFailed, ValueError):  # that knows small drones alone is no mistake
        changes.append((typed, _predicted(work, typed) - own))
    copied = harmless(copied_forces, held_out, own, changes)
    truth = modelled_force_g(held_out, "learned")[:, 2]
    return {**score(own, truth), "copied": copied}


def copied_forces(
    rows: InteractionRows, own: Array, changes: list[tuple[InteractionRows, Array]]
) -> str:
    """Return the name of the shipped model whose predictions change alike, or "".

    Args:
        rows: some.
        own: (R,) predictions of a work for them, gram-force.
        changes: the rows with something changed, and by how much predictions (R,) change.
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
    """Return rows whose neighbors are large drones, of which there are none in the flights."""
    large = np.where(rows.has_neighbor, len(rows.types) - 1, rows.neighbor_type)
    return dataclasses.replace(rows, neighbor_type=large)


def _joined(one: InteractionRows, other: InteractionRows) -> InteractionRows:
    pairs = ((name, getattr(one, name), getattr(other, name)) for name in ROW_ARRAYS)
    both: dict[str, Any] = {name: np.concatenate(pair) for name, *pair in pairs}
    return dataclasses.replace(one, torque=None, **both)


def _predicted(work: RemoteWork, rows: InteractionRows) -> Array:
    """Return what a work predicts for rows without their labels.

    Raises:
        WorkFailed: it failed, or does not predict one finite number a row.
    """
    hidden = dataclasses.replace(rows, force_g=np.zeros_like(rows.force_g), torque=None)
    _, given = work.ask("predict", *_packed(hidden), most=8 * len(rows))
    if len(given) != 1 or given[0].shape != (len(rows),) or not np.isfinite(given[0]).all():
        shape = given[0].shape if given else ()
        raise WorkFailed(
            f"predict() gave an array of shape {shape}, but must give {len(rows)} finite numbers, "
            "one a row"
        )
    return given[0].astype(np.float64)


def _packed(rows: InteractionRows) -> tuple[Mapping[str, Any], list[Array]]:
    """Return rows as header and arrays of a message."""
    names = [name for name in ROW_ARRAYS if getattr(rows, name) is not None]
    header = {"names": names, "types": rows.types, "scenario_names": rows.scenario_names}
    return header, [getattr(rows, name) for name in names]
