"""Models of interaction forces, for the simulation or for a controller's feed-forward.

A model is a shipped one, a weights file, or a function:

    def push_down(position, velocity, types):
        force = np.zeros_like(position)
        force[..., 2] = -0.01 * (types == "S")
        return force

    env = swarm_envs.make("swap_v1", interactions=push_down)
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import (
    check_array,
    check_name,
    check_parameters,
    unknown_name,
)
from swarm_envs.interactions.field import NONE, WAKE, ForceField, empty_field
from swarm_envs.interactions.forces import all_forces, check_states, types_array
from swarm_envs.interactions.packed import PackedField, packed
from swarm_envs.interactions.wake import load_wake
from swarm_envs.interactions.weights_file import load_weights
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.user_files import load_from_file
from swarm_envs.vehicles import VEHICLES, Vehicle, parse_team

TypeArray = npt.NDArray[np.str_]  # An array of interaction types
ForceFunction = Callable[[FloatArray, FloatArray, TypeArray], npt.ArrayLike]
"""A force model as a function of positions (E, N, 3), velocities (E, N, 3) and types (E, N)."""
MODELS = ("none", "wake", "learned", "deep-set")  # The names of the shipped models
PRECISIONS = ("float64", "float32")  # Precisions of networks


@dataclass(frozen=True, eq=False)
class InteractionModel:
    """A model of the aerodynamic forces f_a on drones besides rotor thrust. Get one with `load`.

    Models are equal only if they are the same object.
    """

    name: str
    """The name or path from which it was loaded."""
    types: tuple[str, ...]
    """The interaction types of the model; see `Vehicle.interaction_type`."""
    field: ForceField
    """The parameters."""
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Provenance and errors, from the weights file."""
    function: ForceFunction | None = None
    """The function that computes the forces; None for compiled models."""

    def type_indices(self, team: Sequence[Vehicle]) -> IntArray:
        """Return the index (N,) of each vehicle's interaction type among the model's types.

        The model `none` accepts every type.

        Raises:
            ValueError: the model lacks a vehicle's type.
        """
        return self._indices(interaction_types(team))

    def _indices(self, types: TypeArray) -> IntArray:
        """Return the indices of interaction types, an array of any shape; see `type_indices`."""
        if self.field.kind == NONE:
            return np.zeros(types.shape, np.int64)
        names, where = np.unique(types, return_inverse=True)
        found = types_array(
            tuple(names.tolist()), self.types, f"in interaction model {self.name!r}"
        )
        return found[where].reshape(types.shape)

    def with_precision(self, precision: str) -> InteractionModel:
        """Return this model with networks in another precision.

        Loaded models have `"float64"`. `"float32"` is faster, with errors of about 1e-4 g.

        Raises:
            ValueError: the precision is neither `"float64"` nor `"float32"`.
        """
        check_name("precision", precision, PRECISIONS)
        if self.field.kind in (NONE, WAKE):
            return self  # they have no networks
        field = self.field._replace(weights=self.field.weights.astype(precision))
        return dataclasses.replace(self, field=field)

    @cached_property
    def packed(self) -> PackedField:
        """The parameters in the form of kernels.

        Raises:
            ValueError: the model has more types than kernels support.
        """
        return packed(self.field)

    @cached_property
    def fingerprint(self) -> str:
        """The SHA-256 of the model's parameters."""
        digest = hashlib.sha256(self.name.encode() if self.name in ("none", "wake") else b"")
        for value in self.field:
            digest.update(np.ascontiguousarray(value).tobytes())
        return digest.hexdigest()

    def forces(
        self,
        position: npt.ArrayLike,
        velocity: npt.ArrayLike,
        team: str | Sequence[Vehicle] | TypeArray,
    ) -> FloatArray:
        """Return the forces on every drone of every environment.

        Args:
            position: (E, N, 3) m, world frame.
            velocity: (E, N, 3) m/s, world frame.
            team: the N vehicles, the same in each environment; or an array of interaction types
                (E, N), as a force function gets it.

        Returns:
            (E, N, 3) forces f_a, N, world frame.

        Raises:
            ValueError: a shape does not fit the team, or an entry is not finite.
        """
        given = team if isinstance(team, np.ndarray) else interaction_types(parse_team(team))
        p, v = check_states(position, velocity, given.shape[-1] if given.ndim else 0)
        if given.shape not in (p.shape[:2], p.shape[1:2]):
            raise ValueError(f"team has shape {given.shape}, but must be {p.shape[:2]}: (E, N)")
        if self.function is not None:
            return self.call(p, v, np.broadcast_to(given, p.shape[:2]))
        types, out = np.empty(p.shape[:2], np.int64), np.empty(p.shape)
        types[:] = self._indices(given)
        all_forces(self.packed, types, p, v, out)
        return out

    def call(self, position: FloatArray, velocity: FloatArray, types: TypeArray) -> FloatArray:
        """Return the forces of the model's function, which must not be None.

        Args:
            position: (E, N, 3) m, world frame.
            velocity: (E, N, 3) m/s, world frame.
            types: (E, N) interaction types.

        Returns:
            (E, N, 3) forces f_a, N, world frame.

        Raises:
            ValueError: the function returned another shape, or an entry that is not finite.
        """
        assert self.function is not None
        given = self.function(position, velocity, types)
        return check_array(f"force of {self.name}", given, position.shape, "newton")


def interaction_types(team: Sequence[Vehicle]) -> TypeArray:
    """Return the interaction type (N,) of each vehicle, such as `S` or `L`."""
    return np.array([vehicle.interaction_type for vehicle in team])


def _of_function(function: ForceFunction, label: str) -> InteractionModel:
    """Return the model of a function, which messages call by a label."""
    if isinstance(function, type):
        raise ValueError(f"{label} is a class, but a force must be a function or an object")
    check_parameters(label, function, "position", "velocity", "types")
    return InteractionModel(label, (), empty_field(1), function=function)


def load(name: str | Path | InteractionModel | ForceFunction) -> InteractionModel:
    """Load an interaction model.

    A function is called as `f(position, velocity, types)` with the positions (E, N, 3), m, and
    velocities (E, N, 3), m/s, of the drones of E environments in the world frame, and their
    interaction types (E, N), such as `"S"` and `"L"`. It returns their forces (E, N, 3), N, which
    are held until the next call, `force_rate` times per second. E changes from call to call, since
    it counts the environments whose force is due; environments are independent. Drones whose
    episode has ended are 1e6 m or more away.

    Args:
        name: `"none"` (no force), `"wake"` (closed form), `"learned"` (wakes with networks of
            pairs), `"deep-set"` (the architecture of Neural-Swarm2), or the path of a file of
            `swarm-envs fit`: safetensors, or JSON for a wake; or a function, also as
            `path/to/file.py:function`. A model is returned unchanged.

    Raises:
        ValueError: the name is none of these, or the file is damaged.
        FileNotFoundError: the file does not exist.
    """
    if isinstance(name, InteractionModel):
        return name
    if callable(name):
        label = f"{name.__module__}:{getattr(name, '__qualname__', type(name).__qualname__)}"
        return _of_function(name, label)
    if not isinstance(name, str | Path):
        raise ValueError(
            f"interaction model is {name!r:.80}, but must be a name, a path, a function or an "
            "InteractionModel"
        )
    text = str(name)
    if text == "none":
        types = tuple(sorted({vehicle.interaction_type for vehicle in VEHICLES.values()}))
        return InteractionModel("none", types, empty_field(len(types)))
    if text == "wake":
        return InteractionModel("wake", *load_wake())
    if text in MODELS:
        weights = resources.files("swarm_envs.interactions").joinpath("weights")
        with resources.as_file(weights.joinpath(f"{text}.safetensors")) as path:
            return InteractionModel(text, *load_weights(path))
    if ".py:" in text:
        found = load_from_file(text)
        if callable(found):
            return _of_function(found, text)
        if not isinstance(found, InteractionModel | str | Path):
            raise ValueError(f"{text!r} is {found!r:.80}, but must be a function or a model")
        return dataclasses.replace(load(found), name=text)
    if text.lower().endswith(".json"):
        return InteractionModel(text, *load_wake(Path(text)))
    if Path(text).is_dir():
        raise ValueError(f"{text!r} is a folder; name its file of weights, .safetensors or .json")
    if not text.lower().endswith(".safetensors"):
        valid = (*MODELS, "a path that ends in .safetensors or .json", "file.py:function")
        raise ValueError(unknown_name("interaction model", text, valid))
    return InteractionModel(text, *load_weights(Path(text)))
