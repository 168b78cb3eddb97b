"""Trained policies: their files and their agent, which needs numpy only.

A policy is a safetensors file with JSON metadata. Its float32 tensors are `actor.<layer>.weight`
(out, in) and `actor.<layer>.bias`, and `phi.<layer>.weight` and `phi.<layer>.bias` of a deep set.
The metadata, under the key `swarm_envs`, describe the task that the policy was trained for.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from swarm_envs import TASKS, task_family
from swarm_envs.agents.features import FeatureSizes, feature_sizes, features_of
from swarm_envs.agents.networks import (
    ACTIVATIONS,
    Network,
    layers_from_tensors,
    to_tensors,
)
from swarm_envs.agents.protocol import RowAgent, check_requirements
from swarm_envs.agents.registry import controller_of, shipped_belief
from swarm_envs.agents.safety import Safety
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.observation import Float32Array, observation_layout
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import parse_note, written_whole
from swarm_envs.tasks.base import Task
from swarm_envs.vehicles import VEHICLES

__all__ = [
    "CHECKPOINT",
    "FILE",
    "Policy",
    "PolicyAgent",
    "PolicyNote",
    "observation_options",
    "read_policy",
    "write_policy",
]

FILE = "policy.safetensors"
"""Name of the policy in the folder of a training run."""
CHECKPOINT = "checkpoint.safetensors"
"""Name of the file from which a killed run resumes."""
FORMAT = "swarm-envs-policy-9"  # Format of the file
MOST_DRONES = 10_000  # Largest team that a policy can have been trained for


@dataclass(frozen=True)
class PolicyNote:
    """The environments that a policy was trained for, and supports."""

    task: str
    """The versioned name of the task, such as `swap_v1`."""
    drones: int
    """The size of the largest team that is supported, that of the training."""
    action: str
    """The action space."""
    decision_rate: int
    """The rate of decisions, Hz."""
    num_neighbors: int
    """K, the number of observed neighbors."""
    types: tuple[str, ...] = ()
    """The vehicle types that are supported, those of the training; empty for all."""
    fewest: int = 1
    """The size of the smallest team that is supported. Missing neighbors are out of distribution if
    they never occurred in training."""
    activation: str = "tanh"
    """The activation function of the hidden layers, one of `ACTIVATIONS`."""
    also: tuple[str, ...] = ()
    """Versioned names of other tasks on which the policy was evaluated with success."""
    num_obstacles: int = 0
    """M, the number of observed obstacles."""
    observe_load: bool = False
    """True if it observes thrust margins, masses and charges."""
    observe_force: bool = False
    """True if it observes the force that the included force model of controllers predicts."""
    observe_setpoint: bool = False
    """True if it observes the velocity and acceleration of its set-point."""
    controller: str = ""
    """The included agent whose tracking controller it needs, such as `downwash-aware`; empty for
    the default controller."""
    safety: Safety | None = None
    """The parameters of its safety filter (`+filter`); None for the default."""

    @property
    def families(self) -> set[str]:
        """The tasks that it supports, without their versions."""
        return {task_family(name) for name in (self.task, *self.also)}

    @property
    def sizes(self) -> FeatureSizes:
        """The numbers of its features."""
        return feature_sizes(*self.form)

    @property
    def form(self) -> tuple[int, int, bool, bool, bool]:
        """K, M, and True for each of loads, forces and set-points that its rows have."""
        extra = (self.observe_load, self.observe_force, self.observe_setpoint)
        return self.num_neighbors, self.num_obstacles, *extra

    @property
    def requires(self) -> dict[str, Any]:
        """The environment options that it requires."""
        return {
            "action": self.action,
            "decision_rate": self.decision_rate,
            "observation": "flat",
            "num_neighbors": self.num_neighbors,
            **observation_options(*self.form[1:], self.controller),
        }

    @property
    def teams(self) -> str:
        """The supported team sizes as text."""
        return f"{self.fewest} to {self.drones}" if self.fewest < self.drones else f"{self.drones}"

    def network(self, tensors: Mapping[str, Float32Array]) -> Network:
        """Return the network of the policy from the tensors of its file.

        Raises:
            ValueError: widths of layers, features or actions differ, or there is an extra tensor.
            KeyError: a tensor is missing.
        """
        inputs, actions, phi = self.sizes.width, ACTIONS[self.action].width, None
        if any(name.startswith("phi.") for name in tensors):
            phi = layers_from_tensors(tensors, "phi", self.sizes.own + self.sizes.neighbor)
            inputs = self.sizes.own + 2 * len(phi[-1][1])
        layers = layers_from_tensors(tensors, "actor", inputs)
        if len(layers[-1][1]) != actions:
            raise ValueError(
                f"its layers do not lead from {inputs} features to the {actions} numbers of "
                f"action {self.action!r}"
            )
        network = Network(layers, phi, self.activation)
        extra = set(tensors) - set(to_tensors(network))
        if extra:
            raise ValueError(f"it has tensors that no network has: {', '.join(sorted(extra))}")
        return network

    def check(self) -> None:
        """Raise ValueError if an entry is invalid, such as a task that does not exist."""
        for name in (self.task, *self.also):
            families = {task_family(task) for task in TASKS}
            if not re.fullmatch(r"\w+_v\d+", str(name)) or task_family(name) in families:
                check_name("task", name, TASKS)  # others are custom tasks
        check_name("action", self.action, ACTIONS)
        check_name("activation", self.activation, ACTIVATIONS)
        for token in self.types:
            check_name("types", token, VEHICLES)
        check_integer("fewest", self.fewest, 1)
        check_integer("drones", self.drones, self.fewest, MOST_DRONES)
        EnvConfig(**self.requires)


@dataclass(frozen=True)
class Policy:
    """A trained policy."""

    note: PolicyNote
    """The environments that it supports."""
    network: Network
    """The network that maps features to the mean action."""
    provenance: Mapping[str, Any]
    """The record of the training: command, seed, steps and so on."""

    @property
    def digest(self) -> str:
        """The SHA-256 of the weights."""
        return _digest(to_tensors(self.network))


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy atomically.

    Raises:
        OSError: the folder cannot be created or written.
        ValueError: a weight is not finite.
    """
    tensors = to_tensors(policy.network)
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} has a number that is not finite")
    note = {
        "format": FORMAT,
        **asdict(policy.note),
        "observation": layout_digest(*policy.note.form),
        "weights_sha256": _digest(tensors),
        "provenance": dict(policy.provenance),
    }
    with written_whole(path) as partial:
        metadata = {"swarm_envs": json.dumps(note, allow_nan=False)}
        partial.write_bytes(save(tensors, metadata))  # `save_file` raises no OSError


def read_policy(path: Path) -> Policy:
    """Read a policy.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, or has another format or observation layout.
    """
    if path.suffix == ".zip":
        raise ValueError(
            f"policy {str(path)!r} looks like a model of Stable-Baselines3, which is a pickle: it "
            "can run any code when it is read, so commands refuse it. Load a model that you trust "
            "in Python: agent = swarm_envs.agents.from_model(PPO.load(path), env); "
            "fly_episode(env, agent, seed). For commands write a class that loads it, "
            "file.py:Class (docs/how-to/agent.md)"
        )
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no {str(path)!r}; train a policy with `swarm-envs train`, or give a "
            "class, path/to/file.py:Class"
        )
    if path.suffix != ".safetensors":
        raise ValueError(
            f"policy {str(path)!r} is no .safetensors file: a pickle, such as .pt, can "
            "run any code when it is read, and is refused; write it with `swarm-envs train`"
        )
    try:
        tensors, note = _read(path)
        if note.get("format") != FORMAT:
            raise ValueError(f"its format is {note.get('format')!r}, not {FORMAT!r}")
        if _digest(tensors) != note["weights_sha256"]:
            raise ValueError("its weights differ from their checksum")
        about = _about(note)
        network = about.network(tensors)
        provenance = dict(note["provenance"])
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(
            f"policy {str(path)!r} is damaged or no policy of this version ({error}); train it "
            "again with `swarm-envs train`, or reinstall the package"
        ) from error
    if note.get("observation") != layout_digest(*about.form):
        raise ValueError(
            f"policy {str(path)!r} was trained with another layout of observations than that of "
            "this version; train it again with `swarm-envs train`"
        )
    return Policy(about, network, provenance)


def observation_options(
    obstacles: int, load: bool, force: bool, setpoint: bool, controller: str | None
) -> dict[str, Any]:
    """Return environment options for a policy's observations besides neighbors, and controller."""
    found: dict[str, Any] = {
        "num_obstacles": obstacles,
        "observe_load": load,
        "observe_setpoint": setpoint,
    }
    if force:
        found["observe_force"] = shipped_belief()
    if controller:
        found["controller"] = controller_of(controller)
    return found


def layout_digest(*form: int) -> str:
    """Return the SHA-256 of names, columns, units and scales of the fields of observation rows."""
    layout = [
        [field.name, field.where.start, field.where.stop, field.unit, field.scale]
        for field in observation_layout(*form)
    ]
    return hashlib.sha256(json.dumps(layout).encode()).hexdigest()


def _read(path: Path) -> tuple[dict[str, Float32Array], dict[str, Any]]:
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() or {}
        names = file.keys()  # the file itself cannot be iterated
        tensors = {name: np.asarray(file.get_tensor(name), np.float32) for name in names}
    note = parse_note(metadata.get("swarm_envs", "{}"))
    return tensors, note


def _about(note: Mapping[str, Any]) -> PolicyNote:
    """Return the note, checked."""
    known = {field.name: note[field.name] for field in fields(PolicyNote)}
    known |= {name: tuple(known[name]) for name in ("types", "also")}
    if known["safety"] is not None:
        known["safety"] = Safety(**known["safety"])
    about = PolicyNote(**known)
    about.check()
    return about


def _digest(tensors: Mapping[str, Float32Array]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(f"{name}{tensors[name].shape}".encode())
        digest.update(tensors[name].tobytes())
    return digest.hexdigest()


class PolicyAgent(RowAgent):
    """Agent in which every drone acts with the same policy on its own observations.

    Args:
        policy: the policy.
    """

    def __init__(self, policy: Policy) -> None:
        note = policy.note
        self.policy = policy
        # Stored episodes depend on the note too, because it determines the supported tasks.
        self.digest = hashlib.sha256(f"{policy.digest} {note}".encode()).hexdigest()
        self.requires: Mapping[str, Any] = note.requires
        self.avoids_obstacles = bool(note.num_obstacles)  # policies that observe them avoid them

    @classmethod
    def load(cls, path: Path) -> PolicyAgent:
        """Return the agent of a policy's file, or of the folder of a training run.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, a pickle, or of another version.
        """
        if (path / CHECKPOINT).is_file() and not (path / FILE).exists():
            raise FileNotFoundError(
                f"the training run in {str(path)!r} has saved no policy yet; continue it with the "
                "same `swarm-envs train`"
            )
        return cls(read_policy(path / FILE if path.is_dir() else path))

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Check that the policy supports the environment; nothing is random.

        Raises:
            ValueError: the environment has other options than required, or see `check`.
        """
        check_requirements(env, self)
        self.check(env.core.task)

    def check(self, task: Task) -> None:
        """Raise ValueError if the policy does not support a task, its team, or its obstacles."""
        note, num_drones = self.policy.note, len(task.team)
        if task_family(task.name) not in note.families:
            raise ValueError(
                f"this policy supports {', '.join(sorted(note.families))}, but the environment's "
                f"task is {task_family(task.name)}; set the task (--task), or train another policy"
            )
        if not note.fewest <= num_drones <= note.drones:
            raise ValueError(
                f"this policy was trained for teams of {note.teams} drones, but the environment "
                f"has {num_drones}; set {note.teams} (--drones), or use another agent"
            )
        others = {vehicle.token for vehicle in task.team} - set(note.types)
        if note.types and others:
            raise ValueError(
                f"this policy was trained for vehicles {', '.join(note.types)}, but the team has "
                f"{', '.join(sorted(others))}; train one for them with `swarm-envs train --team`"
            )
        if task.obstacles and not note.num_obstacles:
            raise ValueError(
                "this policy was trained without obstacles and does not observe those of the "
                "environment; choose an agent by `recommended(..., obstacles=True)`, or train one "
                "with `swarm-envs train --num-obstacles`"
            )

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return the mean actions (..., width) for observation rows (..., row width).

        Raises:
            ValueError: the rows have another width.
        """
        note = self.policy.note
        means = self.policy.network(features_of(rows, *note.form), note.sizes)
        actions: Float32Array = np.clip(means, -1.0, 1.0)
        return actions


def shipped_policy(name: str) -> PolicyAgent:
    """Return the agent of an included policy; see `weights/MODEL_CARD.md`."""
    weights = resources.files("swarm_envs.agents").joinpath("weights")
    with resources.as_file(weights.joinpath(f"{name}.safetensors")) as path:
        if not path.is_file():
            raise FileNotFoundError(
                f"the weights of the included policy {name!r} are hidden, as while an assignment "
                "is graded: hand in your own policy. Elsewhere, reinstall the package"
            )
        return PolicyAgent.load(path)
