"""Fit one student's force model and say how good it is; `swarm-envs grade` runs it as a process."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents.registry import load_class
from swarm_envs.files import write_json
from swarm_envs.training.interaction_rows import InteractionRows, read_rows


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


def grade(work: str, data: Path) -> dict[str, Any]:
    """Fit a student's model to the training rows of a table, and score it on the others.

    Returns:
        As `score`; or `error`, why there is none.
    """
    rows = read_rows(data)
    held_out = rows.select(rows.validation)
    try:
        model = load_class(work)()
        model.fit(rows.select(~rows.validation))
        unknown = dataclasses.replace(held_out, force_g=np.zeros_like(held_out.force_g))
        return dict(score(model.predict(unknown), held_out))
    except (Exception, SystemExit) as error:
        return {"error": f"{type(error).__name__}: {error}"}


if __name__ == "__main__":
    write_json(Path(sys.argv[3]), grade(sys.argv[1], Path(sys.argv[2])))
