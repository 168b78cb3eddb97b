"""Checkpoints of a training run as safetensors: a learner's tensors, and history. No pickle."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from torch import Tensor

from swarm_envs.training.force_model.checkpoint import write_safetensors
from swarm_envs.training.provenance import differing
from swarm_envs.training.rl.learner import Learner


def save_checkpoint(path: Path, learner: Learner, progress: Mapping[str, Any]) -> None:
    """Write everything that `load_checkpoint` needs, whole or not at all.

    Args:
        path: the file.
        learner: what was trained.
        progress: where the run stands, ready for JSON; under `config` what it depends on.
    """
    metadata = {"progress": json.dumps(dict(progress), allow_nan=False)}
    write_safetensors(path, learner.tensors(), metadata)


def load_checkpoint(path: Path, learner: Learner, config: Mapping[str, Any]) -> dict[str, Any]:
    """Put a fresh learner where the checkpoint stands, and return its progress.

    Raises:
        ValueError: it is damaged, or of a run with another configuration.
    """
    try:
        tensors, progress = _read(path)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"checkpoint {str(path)!r} is damaged ({error}); delete the folder and train again"
        ) from error
    differences = differing_runs(progress["config"], config)
    if differences:
        raise ValueError(
            f"checkpoint {str(path)!r} is of a run with other options: {differences}; choose "
            "another folder by --out, or delete that one"
        )
    try:
        learner.load(tensors)
    except (KeyError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"checkpoint {str(path)!r} does not fit the networks of its own options ({error}); "
            "delete the folder and train again"
        ) from error
    return progress


def differing_runs(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Options in which two runs differ, in words; of two algorithms the names alone."""
    if there.get("algo") != here["algo"]:
        return differing({"algo": there.get("algo")}, {"algo": here["algo"]})
    return differing(there, here)


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    progress = json.loads(metadata["progress"])
    for name in ("config", "rollouts", "history", "judged"):
        if name not in progress:
            raise KeyError(name)
    return tensors, progress
