"""Trained policies: their files, checked before they are used, and the agent that flies them.

A file is safetensors with a JSON note. Tensors, float32: `actor.<layer>.weight` (out, in) and
`actor.<layer>.bias`, layers in order, and of a set also `phi.<layer>.weight` and so on. The note,
under the key `swarm_envs`, says what the policy was trained for. numpy is all that a policy needs
to fly.
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
    "read_policy",
    "senses",
    "write_policy",
]

FILE = "policy.safetensors"
"""Name of the policy in the folder of a training run."""
CHECKPOINT = "checkpoint.safetensors"
"""Name of the file from which a killed run resumes."""
FORMAT = "swarm-envs-policy-9"  # What a file of a policy says it is
MOST_DRONES = 10_000  # Largest team that a policy can have been trained for
LARGEST = 1e4  # No weight of a policy that was trained comes near it; one beyond it was damaged


@dataclass(frozen=True)
class PolicyNote:
    """What a policy was trained for, and so where alone it may fly."""

    task: str
    """versioned name, such as `swap_v1`"""
    drones: int
    """largest team it may fly in: that of its training"""
    action: str
    """what its numbers mean"""
    decision_rate: int
    """how often it decides, 1/s"""
    num_neighbors: int
    """K, how many neighbours it observes"""
    types: tuple[str, ...] = ()
    """types of vehicles it was trained with and alone flies; all if none is named"""
    fewest: int = 1
    """smallest team it may fly in: places of neighbours that were never empty in its training can
    mislead it when they are"""
    activation: str = "tanh"
    """what follows every hidden layer: one of `ACTIVATIONS`"""
    also: tuple[str, ...] = ()
    """versioned names of other tasks that it was measured to fly, though trained for one"""
    num_obstacles: int = 0
    """M, how many obstacles it observes"""
    observe_load: bool = False
    """whether it observes thrust margins, masses and charges"""
    observe_force: bool = False
    """whether it observes the force that the shipped belief predicts"""
    observe_setpoint: bool = False
    """whether it observes velocity and acceleration of its set-point"""
    controller: str = ""
    """the shipped agent whose tracking controller it needs, such as `downwash-aware`; the default
    controller if empty"""
    safety: Safety | None = None
    """the safety filter that `+filter` puts around it; None for the default"""

    @property
    def families(self) -> set[str]:
        """Tasks that it flies, whatever their version."""
        return {task_family(name) for name in (self.task, *self.also)}

    @property
    def sizes(self) -> FeatureSizes:
        """How many numbers its features are."""
        return feature_sizes(*self.form)

    @property
    def form(self) -> tuple[int, int, bool, bool, bool]:
        """The K and M of its observation rows, and whether they hold loads, forces, set-points."""
        extra = (self.observe_load, self.observe_force, self.observe_setpoint)
        return self.num_neighbors, self.num_obstacles, *extra

    @property
    def requires(self) -> dict[str, Any]:
        """Options of the environment without which it cannot act."""
        return {
            "action": self.action,
            "decision_rate": self.decision_rate,
            "observation": "flat",
            "num_neighbors": self.num_neighbors,
            **senses(*self.form[1:], self.controller),
        }

    @property
    def teams(self) -> str:
        """Team sizes in which it flies, for people."""
        return f"{self.fewest} to {self.drones}" if self.fewest < self.drones else f"{self.drones}"

    def network(self, tensors: Mapping[str, Float32Array]) -> Network:
        """Return the network that a file holds for such a policy, every layer's widths checked.

        Raises:
            ValueError: layers do not fit each other, features or actions, or a tensor is left over.
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
            raise ValueError(f"it holds tensors that no network has: {', '.join(sorted(extra))}")
        return network

    def check(self) -> None:
        """Refuse a note that speaks of what does not exist here.

        Raises:
            ValueError: naming the entry.
        """
        for name in (self.task, *self.also):
            families = {task_family(task) for task in TASKS}
            if not re.fullmatch(r"\w+_v\d+", str(name)) or task_family(name) in families:
                check_name("task", name, TASKS)  # others are tasks of users' own
        check_name("action", self.action, ACTIONS)
        check_name("activation", self.activation, ACTIVATIONS)
        for token in self.types:
            check_name("types", token, VEHICLES)
        check_integer("fewest", self.fewest, 1)
        check_integer("drones", self.drones, self.fewest, MOST_DRONES)
        EnvConfig(**self.requires)


@dataclass(frozen=True)
class Policy:
    """A network that acts, and what it was trained for."""

    note: PolicyNote
    """What it was trained for."""
    network: Network
    """The map from features to the mean action."""
    provenance: Mapping[str, Any]
    """How it came about: command, seed, steps ..."""

    @property
    def digest(self) -> str:
        """SHA-256 of the weights."""
        return _digest(to_tensors(self.network))

    def actions(self, rows: Float32Array) -> Float32Array:
        """Actions (..., width) for observation rows (..., row width) of any number of drones.

        Raises:
            ValueError: the rows have another width.
        """
        values = features_of(rows, *self.note.form)
        actions: Float32Array = np.clip(self.network(values, self.note.sizes), -1.0, 1.0)
        return actions


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy, whole or not at all.

    Raises:
        OSError: the folder cannot be made or written.
        ValueError: a weight is not finite.
    """
    tensors = to_tensors(policy.network)
    _check_numbers(tensors)
    note = {
        "format": FORMAT,
        **asdict(policy.note),
        "observation": layout_digest(*policy.note.form),
        "weights_sha256": _digest(tensors),
        "provenance": dict(policy.provenance),
    }
    with written_whole(path) as partial:
        metadata = {"swarm_envs": json.dumps(note, allow_nan=False)}
        partial.write_bytes(save(tensors, metadata))  # its own writer raises no OSError


def read_policy(path: Path) -> Policy:
    """Read a policy.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, of no format that is known, or of another observation layout.
    """
    if path.suffix == ".zip":
        raise ValueError(
            f"policy {str(path)!r} looks like a model of Stable-Baselines3, which is a pickle: it "
            "can run any code when it is read, so commands refuse it. Read a model of your own in "
            "Python and fly it there: agent = swarm_envs.agents.from_model(PPO.load(path), env); "
            "fly_episode(env, agent, seed)"
        )
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no {str(path)!r}; train a policy by `swarm-envs train`, or name an agent's "
            "class, path/to/file.py:Class"
        )
    if path.suffix != ".safetensors":
        raise ValueError(
            f"policy {str(path)!r} is no .safetensors file: a pickle, such as .pt, can "
            "run any code when it is read, and is refused; write it by `swarm-envs train`"
        )
    try:
        tensors, note = _read(path)
        if note.get("format") != FORMAT:
            raise ValueError(f"its format is {note.get('format')!r}, not {FORMAT!r}")
        if _digest(tensors) != note["weights_sha256"]:
            raise ValueError("its weights are not those that were written")
        about = _about(note)
        network = about.network(tensors)
        provenance = dict(note["provenance"])
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(
            f"policy {str(path)!r} is damaged or no policy of this version ({error}); train it "
            "again by `swarm-envs train`, or reinstall the package"
        ) from error
    if note.get("observation") != layout_digest(*about.form):
        raise ValueError(
            f"policy {str(path)!r} was trained on another layout of observations than this "
            "version's; train it again by `swarm-envs train`"
        )
    return Policy(about, network, provenance)


def senses(
    obstacles: int, load: bool, force: bool, setpoint: bool, controller: str | None
) -> dict[str, Any]:
    """Options of an environment for what a policy observes besides neighbors, and its actions."""
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
    """SHA-256 of the layout of rows of a form: names, places, units and scales of its fields."""
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
    _check_numbers(tensors)
    return tensors, note


def _check_numbers(tensors: Mapping[str, Float32Array]) -> None:
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} holds a number that is not finite")
        if (np.abs(tensor) > LARGEST).any():
            raise ValueError(f"tensor {name!r} holds a number beyond {LARGEST:g}")


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
    """Every drone flown by one network, each by what it observes itself.

    Args:
        policy: the network and what it was trained for.
    """

    def __init__(self, policy: Policy) -> None:
        note = policy.note
        self.policy = policy
        # The note too: it says which tasks are refused, and episodes are kept by this digest.
        self.digest = hashlib.sha256(f"{policy.digest} {note}".encode()).hexdigest()
        self.requires: Mapping[str, Any] = note.requires
        self.avoids_obstacles = bool(note.num_obstacles)  # it observes them, and was trained so

    @classmethod
    def load(cls, path: Path) -> PolicyAgent:
        """The agent in a file, or in the folder of a training run.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, a pickle, or of another version; the message says which.
        """
        if (path / CHECKPOINT).is_file() and not (path / FILE).exists():
            raise FileNotFoundError(
                f"the training run in {str(path)!r} has kept no policy yet; the same `swarm-envs "
                "train` continues with it"
            )
        return cls(read_policy(path / FILE if path.is_dir() else path))

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Check that this is what the policy was trained for; it draws nothing at random.

        Raises:
            ValueError: another action or observation, or as `check`.
        """
        check_requirements(env, self)
        self.check(env.core.task)

    def check(self, task: Task) -> None:
        """Refuse a task for which the policy was not trained.

        Raises:
            ValueError: another task, more or fewer drones, types that it was not trained with, or
                obstacles.
        """
        note, num_drones = self.policy.note, len(task.team)
        if task_family(task.name) not in note.families:
            raise ValueError(
                f"this policy flies {', '.join(sorted(note.families))}, but the environment's "
                f"task is {task_family(task.name)}; set the task (--task), or train another policy"
            )
        if not note.fewest <= num_drones <= note.drones:
            raise ValueError(
                f"this policy was trained for teams of {note.teams} drones, but the environment "
                f"has {num_drones}; set {note.teams} (--drones), or fly another agent"
            )
        others = {vehicle.token for vehicle in task.team} - set(note.types)
        if note.types and others:
            raise ValueError(
                f"this policy was trained for vehicles {', '.join(note.types)}, but the team has "
                f"{', '.join(sorted(others))}; train one with them by `swarm-envs train --team`"
            )
        if task.obstacles and not note.num_obstacles:
            raise ValueError(
                f"this policy was trained without obstacles and sees none of the "
                f"{len(task.obstacles)} here; train one by `swarm-envs train --num-obstacles`"
            )

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """The mean (..., width) of what the policy would draw, for rows (..., row width).

        Raises:
            ValueError: the rows have another width.
        """
        return self.policy.actions(rows)


def shipped_policy(name: str) -> PolicyAgent:
    """The agent of a policy that ships; see `weights/MODEL_CARD.md`."""
    weights = resources.files("swarm_envs.agents").joinpath("weights")
    with resources.as_file(weights.joinpath(f"{name}.safetensors")) as path:
        return PolicyAgent.load(path)
