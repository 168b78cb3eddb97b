"""Checkpoints of a training run as safetensors: weights, optimiser, averages, history."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from swarm_envs.files import written_whole
from swarm_envs.training.provenance import differing

if TYPE_CHECKING:
    from swarm_envs.training.force_model.train import Training

_OPTIMISER = "optimiser."


def write_safetensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
    """Write a safetensors file so that a reader sees the old file or the whole new one."""
    with written_whole(path) as partial:
        save_file({name: t.contiguous() for name, t in tensors.items()}, partial, metadata=metadata)
        partial.chmod(0o644)  # safetensors makes files that only their owner can read


def save_checkpoint(path: Path, run: Training, configuration: str) -> None:
    """Write everything that `load_checkpoint` needs to continue the run.

    Args:
        path: the file to write.
        run: where training stands.
        configuration: what the run depends on; only the same may continue it.
    """
    weights = run.weights
    tensors = {"weights": weights.values.detach()}
    tensors |= {"averaged": run.averaged, "best": run.best}
    tensors |= {_OPTIMISER + k: v for k, v in run.optimiser.state[weights.values].items()}
    metadata = {
        "step": str(run.step),
        "best_step": str(run.best_step),
        "history": json.dumps(run.history),
        "configuration": configuration,
    }
    write_safetensors(path, tensors, metadata)


def load_checkpoint(path: Path, run: Training, configuration: str) -> None:
    """Continue `run`, freshly started, where the checkpoint stands.

    Raises:
        ValueError: the checkpoint was written with another configuration.
    """
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    differences = differing(json.loads(metadata["configuration"]), json.loads(configuration))
    if differences:
        raise ValueError(
            f"checkpoint {str(path)!r} was written with other options: {differences}; "
            "delete the file or choose another output folder"
        )
    run.weights.set(tensors["weights"])
    run.averaged, run.best = tensors["averaged"], tensors["best"]
    state = {k.removeprefix(_OPTIMISER): v for k, v in tensors.items() if k.startswith(_OPTIMISER)}
    run.optimiser.state[run.weights.values] = state
    run.step, run.best_step = int(metadata["step"]), int(metadata["best_step"])
    run.history = json.loads(metadata["history"])
