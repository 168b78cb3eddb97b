"""The score of a student's force model: fitted and asked in its process, judged in the grader's."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.commands.grading.copies import copied_forces
from swarm_envs.commands.grading.messages import Array
from swarm_envs.commands.grading.remote import RemoteWork
from swarm_envs.training.interaction_rows import InteractionRows, read_rows
from swarm_envs.training.interaction_rows.rows import ROW_ARRAYS


def score(predicted: Any, held_out: InteractionRows) -> dict[str, float]:
    """How good vertical forces are, gram-force.

    `error_g`: their root mean square error; `baseline_g`: that of no force at all; `explained`: the
    share of the baseline's square that is gone, 1 for no error, negative for worse than nothing.

    Raises:
        ValueError: they are not one finite number a row.
    """
    force = np.asarray(predicted, dtype=np.float64)
    if force.shape != (len(held_out),) or not np.isfinite(force).all():
        raise ValueError(
            f"predict() gave {type(predicted).__name__} of shape {force.shape}, but must give "
            f"{len(held_out)} finite numbers, one a row"
        )
    truth = held_out.force_g[:, 2]
    error, baseline = np.mean(np.square(force - truth)), np.mean(np.square(truth))
    return {
        "error_g": float(np.sqrt(error)),
        "baseline_g": float(np.sqrt(baseline)),
        "explained": float(1.0 - error / baseline),
    }


def grade_model(work: RemoteWork, data: Path) -> dict[str, Any]:
    """Fit a student's model to the training rows of a table, and score it on the others.

    Its process is given no label of a held-out row.

    Args:
        work: its process.
        data: the table.

    Returns:
        As `score`, and under `copied` the shipped model that predicts the same.

    Raises:
        WorkFailed: it failed.
        ValueError: what it predicts is not one finite number a row.
    """
    rows = read_rows(data)
    held_out = rows.select(rows.validation)
    work.ask("fit", *_packed(rows.select(~rows.validation)))
    unknown = np.zeros_like(held_out.force_g)
    hidden = dataclasses.replace(held_out, force_g=unknown, torque=None)
    _, given = work.ask("predict", *_packed(hidden), most=8 * len(held_out))
    predicted = given[0] if len(given) == 1 else np.zeros(0)
    return {**score(predicted, held_out), "copied": copied_forces(predicted, held_out)}


def _packed(rows: InteractionRows) -> tuple[dict[str, Any], list[Array]]:
    """Rows as header and arrays of a message."""
    names = [name for name in (*ROW_ARRAYS, "torque") if getattr(rows, name) is not None]
    header = {"names": names, "types": rows.types, "scenario_names": rows.scenario_names}
    return header, [getattr(rows, name) for name in names]
