"""Checkpoints of a training run as safetensors: weights, Adam's averages, history. No pickle."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from swarm_envs.training.force_model.checkpoint import write_safetensors
from swarm_envs.training.force_model.files import differing
from swarm_envs.training.rl.learner import Learner

_POLICY, _OPTIMISER = "policy.", "optimiser."


def save_checkpoint(path: Path, learner: Learner, progress: Mapping[str, Any]) -> None:
    """Write everything that `load_checkpoint` needs, whole or not at all.

    Args:
        path: the file.
        learner: what was trained.
        progress: where the run stands, ready for JSON; under `config` what it depends on.
    """
    policy = learner.model.policy
    tensors = {_POLICY + name: tensor for name, tensor in policy.state_dict().items()}
    for place, entries in policy.optimizer.state_dict()["state"].items():
        for name, value in entries.items():
            tensors[f"{_OPTIMISER}{place}.{name}"] = torch.as_tensor(value).clone()
    write_safetensors(path, tensors, {"progress": json.dumps(dict(progress), allow_nan=False)})


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
    differences = differing(progress["config"], config)
    if differences:
        raise ValueError(
            f"checkpoint {str(path)!r} is of a run with other options: {differences}; choose "
            "another folder by --out, or delete that one"
        )
    policy = learner.model.policy
    try:
        policy.load_state_dict(_named(tensors, _POLICY))
        policy.optimizer.load_state_dict(
            {
                "state": _places(tensors),
                "param_groups": policy.optimizer.state_dict()["param_groups"],
            }
        )
    except (RuntimeError, ValueError) as error:
        raise ValueError(
            f"checkpoint {str(path)!r} does not fit the networks of its own options ({error}); "
            "delete the folder and train again"
        ) from error
    return progress


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    progress = json.loads(metadata["progress"])
    for name in ("config", "rollouts", "history", "judged"):
        if name not in progress:
            raise KeyError(name)
    return tensors, progress


def _named(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}


def _places(tensors: Mapping[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    """Adam's state by parameter, as `Optimizer.load_state_dict` takes it."""
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in _named(tensors, _OPTIMISER).items():
        place, _, entry = name.partition(".")
        state.setdefault(int(place), {})[entry] = tensor
    return state
