"""Files of trained policies: safetensors with a JSON note, checked before it is believed.

Tensors, float32: `actor.<layer>.weight` (out, in) and `actor.<layer>.bias`, layers in order, tanh
between them. The note, under the key `swarm_envs`, says what the policy was trained for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from swarm_envs import TASKS
from swarm_envs.agents.feature_sets import FEATURE_SETS, GOAL
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.envs.observation import Float32Array, observation_layout
from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import written_whole

FORMAT = "swarm-envs-policy-1"
LARGEST = 1e4
"""No weight of a policy that was trained comes near it; one beyond it was damaged."""

Layers = tuple[tuple[Float32Array, Float32Array], ...]
"""Weight (out, in) and bias (out,) of each layer of a network, in order."""


@dataclass(frozen=True)
class PolicyNote:
    """What a policy was trained for, and so where alone it may fly."""

    task: str
    """versioned name, such as `swap_v0`"""
    drones: int
    """largest team it may fly in: that of its training; smaller ones are easier"""
    action: str
    """what its numbers mean"""
    decision_rate: int
    """how often it decides, 1/s"""
    num_neighbors: int
    """K, how many neighbours it observes"""
    features: str = GOAL
    """what is made of an observation row before the network sees it"""

    def check(self) -> None:
        """Refuse a note that speaks of what does not exist here.

        Raises:
            ValueError: naming the entry.
        """
        check_name("task", self.task, TASKS)
        check_name("action", self.action, ACTIONS)
        check_name("features", self.features, FEATURE_SETS)
        check_integer("drones", self.drones, 1)
        check_integer("decision_rate", self.decision_rate, 1)
        check_integer("num_neighbors", self.num_neighbors, 0)


@dataclass(frozen=True)
class Policy:
    """A network that acts, and what it was trained for."""

    note: PolicyNote
    layers: Layers
    provenance: Mapping[str, Any]
    """How it came about: command, seed, steps ..."""

    @property
    def digest(self) -> str:
        """SHA-256 of the weights."""
        return _digest(_tensors(self.layers))


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy, whole or not at all.

    Raises:
        OSError: the folder cannot be made or written.
        ValueError: a weight is not finite.
    """
    tensors = _tensors(policy.layers)
    _check_numbers(tensors)
    note = {
        "format": FORMAT,
        **asdict(policy.note),
        "observation": layout_digest(policy.note.num_neighbors),
        "weights_sha256": _digest(tensors),
        "provenance": dict(policy.provenance),
    }
    with written_whole(path) as partial:
        save_file(tensors, partial, metadata={"swarm_envs": json.dumps(note, allow_nan=False)})
        partial.chmod(0o644)  # safetensors makes files that only their owner can read


def read_policy(path: Path) -> Policy:
    """Read a policy.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, of no format that is known, or of another observation layout.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no {str(path)!r}; train a policy by `swarm-envs train`")
    if path.suffix != ".safetensors":
        raise ValueError(
            f"policy {str(path)!r} is no .safetensors file: a pickle, such as .pt or .zip, can "
            "run any code when it is read, and is refused; write it by `swarm-envs train`"
        )
    try:
        tensors, note = _read(path)
        if note.get("format") != FORMAT:
            raise ValueError(f"its format is {note.get('format')!r}, not {FORMAT!r}")
        if _digest(tensors) != note["weights_sha256"]:
            raise ValueError("its weights are not those that were written")
        about = PolicyNote(**{field.name: note[field.name] for field in fields(PolicyNote)})
        about.check()
        layers = _layers(tensors, about)
        provenance = dict(note["provenance"])
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(
            f"policy {str(path)!r} is damaged or no policy of this version ({error}); train it "
            "again by `swarm-envs train`, or reinstall the package"
        ) from error
    if note.get("observation") != layout_digest(about.num_neighbors):
        raise ValueError(
            f"policy {str(path)!r} was trained on another layout of observations than this "
            "version's; train it again by `swarm-envs train`"
        )
    return Policy(about, layers, provenance)


def layout_digest(num_neighbors: int) -> str:
    """SHA-256 of the observation layout: names, places, units and scales of its fields."""
    said = [
        [field.name, field.where.start, field.where.stop, field.unit, field.scale]
        for field in observation_layout(num_neighbors)
    ]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


def _read(path: Path) -> tuple[dict[str, Float32Array], dict[str, Any]]:
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() or {}
        names = file.keys()  # the file itself cannot be iterated
        tensors = {name: np.asarray(file.get_tensor(name), np.float32) for name in names}
    note = json.loads(metadata.get("swarm_envs", "{}"))
    if not isinstance(note, dict):
        raise ValueError(f"its note is {note!r:.80}, not a JSON object")
    _check_numbers(tensors)
    return tensors, note


def _check_numbers(tensors: Mapping[str, Float32Array]) -> None:
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} holds a number that is not finite")
        if (np.abs(tensor) > LARGEST).any():
            raise ValueError(f"tensor {name!r} holds a number beyond {LARGEST:g}")


def _layers(tensors: Mapping[str, Float32Array], note: PolicyNote) -> Layers:
    count = len(tensors) // 2
    layers = tuple((tensors[f"actor.{k}.weight"], tensors[f"actor.{k}.bias"]) for k in range(count))
    widths = [FEATURE_SETS[note.features].width(note.num_neighbors)]
    for weight, bias in layers:
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"a layer has weights {weight.shape} and biases {bias.shape}")
        widths.append(weight.shape[0])
    fits = all(w.shape[1] == before for (w, _), (before, _) in zip(layers, pairwise(widths)))
    if not layers or not fits or widths[-1] != ACTIONS[note.action].width:
        raise ValueError(
            f"its layers do not lead from {widths[0]} features to the "
            f"{ACTIONS[note.action].width} numbers of action {note.action!r}"
        )
    return layers


def _tensors(layers: Layers) -> dict[str, Float32Array]:
    tensors = {}
    for k, (weight, bias) in enumerate(layers):
        tensors[f"actor.{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
        tensors[f"actor.{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    return tensors


def _digest(tensors: Mapping[str, Float32Array]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(f"{name}{tensors[name].shape}".encode())
        digest.update(tensors[name].tobytes())
    return digest.hexdigest()
