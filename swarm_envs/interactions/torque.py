"""Interaction torque of a deep set that was fitted with a torque head, in NumPy.

The torque tau_a of Neural-Swarm2's eqs. (8) and (10) is a further linear layer after the last
hidden layer of rho. The physics does not use it: the authors found it small (Sec. VII-B). It is in
the world frame; eq. (1b) has R^T tau_a, in the body frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.forces import check_states, pair_weight, types_array
from swarm_envs.interactions.weights_file import Layers, load_weights, network_layers, read_tensors
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Vehicle, parse_team

__all__ = ["GRAM_CENTIMETRE"]

GRAM_CENTIMETRE = GRAM_FORCE * 0.01
"""One gram-force centimeter, the unit of the head, in N m."""


@dataclass(frozen=True, eq=False)
class TorqueModel:
    """A model of the aerodynamic torques tau_a on drones. Get one with `load_torque`."""

    name: str  # The path from which it was loaded
    types: tuple[str, ...]  # The interaction types
    field: ForceField  # Window, ranges and anchor
    networks: dict[str, Layers]
    """phi by type and of the environment, and rho with the head as its last layer."""

    def torques(
        self, position: npt.ArrayLike, velocity: npt.ArrayLike, team: str | Sequence[Vehicle]
    ) -> FloatArray:
        """Return the torque tau_a (E, N, 3), N m, world frame, on every drone.

        Positions and velocities are (E, N, 3), m and m/s, of the same N vehicles in each
        environment.

        Raises:
            ValueError: a shape does not fit the team, an entry is not finite, or a type is unknown.
        """
        vehicles = parse_team(team)
        p, v = check_states(position, velocity, len(vehicles))
        kinds = tuple(vehicle.interaction_type for vehicle in vehicles)
        types_array(kinds, self.types, f"in interaction model {self.name!r}")  # raises for others
        return np.stack([self._torque(p, v, kinds, i) for i in range(len(kinds))], axis=1)

    def _torque(self, p: FloatArray, v: FloatArray, kinds: tuple[str, ...], i: int) -> FloatArray:
        anchor, rho = self.field.anchor_height, self.networks[f"rho.{kinds[i]}"]
        height = np.minimum(p[:, i, 2], anchor) if anchor > 0.0 else p[:, i, 2]
        code = self._environment(height, v[:, i])
        for j, kind in enumerate(kinds):
            if j != i:
                pair = np.concatenate([p[:, j] - p[:, i], v[:, j] - v[:, i]], axis=1)
                inputs = np.clip(pair, *self.field.pair_range)
                weight = [pair_weight(self.field.window, *offset) for offset in pair[:, :3]]
                code += np.array(weight)[:, None] * _apply(self.networks[f"phi.{kind}"], inputs)
        torque = _apply(rho, code)
        if anchor > 0.0:
            torque -= _apply(rho, self._environment(np.full_like(height, anchor), v[:, i]))
        return torque * GRAM_CENTIMETRE

    def _environment(self, height: FloatArray, velocity: FloatArray) -> FloatArray:
        inputs = -np.concatenate([height[:, None], velocity], axis=1)
        low, high = self.field.environment_range
        return _apply(self.networks["phi.environment"], np.clip(inputs, low, high))


def load_torque(path: str | Path) -> TorqueModel:
    """Load the torque of a deep set fitted by `swarm-envs fit --torque`.

    Raises:
        ValueError: the file is damaged, or has no torque head.
        FileNotFoundError: the file does not exist.
    """
    types, field, _ = load_weights(Path(path))
    tensors, _ = read_tensors(Path(path))
    missing = [n for n in types for k in ("weight", "bias") if f"torque.{n}.{k}" not in tensors]
    if missing:
        raise ValueError(
            f"weights file {str(path)!r} has no torque of type {missing[0]!r}; fit it with --torque"
        )
    networks = {
        f"phi.{name}": network_layers(f"phi.{name}", tensors) for name in (*types, "environment")
    }
    for name in types:
        *rho, last = network_layers(f"rho.{name}", tensors)
        head = (tensors[f"torque.{name}.weight"], tensors[f"torque.{name}.bias"])
        if head[0].shape != (3, last[0].shape[1]) or head[1].shape != (3,):
            raise ValueError(
                f"the torque of type {name!r} has a weight of shape {head[0].shape} and a bias of "
                f"shape {head[1].shape}, which do not fit rho; fit the file again"
            )
        networks[f"rho.{name}"] = [*rho, head]
    return TorqueModel(str(path), types, field, networks)


def _apply(layers: Layers, x: FloatArray) -> FloatArray:
    for weight, bias in layers[:-1]:
        x = np.maximum(x @ weight.T + bias, 0.0)
    weight, bias = layers[-1]
    return np.asarray(x @ weight.T + bias)
