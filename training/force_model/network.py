"""The heterogeneous deep set of Neural-Swarm2 (eq. 10) as a torch module.

    f_i = rho_i( phi_env(-z_i, -v_i) + sum over neighbours j of w_ij phi_type(j)(p_ij, v_ij) )

with p_ij = p_j - p_i and v_ij = v_j - v_i. The output is the vertical force on i in gram-force.
Three things are added to the paper's form, all part of the forward pass, so that training sees
the function that ships: a smooth window w, clamping of the inputs to the measured range, and an
anchor that makes a lone drone aloft feel exactly nothing.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from swarm_envs.interactions.field import LATERAL_REACH, VERTICAL_REACH
from swarm_envs.training.force_model.spec import (
    EVERYWHERE,
    OUTER_FADE,
    UNLIMITED,
    DeepSetSpec,
    InputRange,
    Window,
    without_velocity,
)
from swarm_envs.vehicles import GRAM_FORCE

__all__ = [
    "EVERYWHERE",
    "OUTER_FADE",
    "TORQUES",
    "Batch",
    "DeepSet",
    "DeepSetSpec",
    "ForceNetwork",
    "InputRange",
    "Window",
    "fade",
    "layers",
    "perceptron",
    "swarm_batch",
    "without_velocity",
]

TORQUES = 3
"""Numbers of a torque head: the components in the world frame, gram-force centimetre."""


class Batch(NamedTuple):
    """Rows as the network takes them."""

    ego_type: Tensor
    """(R,) index of the drone's type."""
    environment: Tensor
    """(R, 4) -z_i (m), -v_i (m/s)."""
    pair: Tensor
    """(R, K, 6) p_ij (m), v_ij (m/s)."""
    pair_type: Tensor
    """(R, K) type of each neighbour, -1 for none."""


def perceptron(widths: Sequence[int], dtype: torch.dtype = torch.float32) -> nn.Sequential:
    """Fully connected layers with ReLU between them and a linear output (eq. 11)."""
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Linear(before, after, dtype=dtype), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def fade(distance: Tensor, inner: float, outer: float) -> Tensor:
    """Quintic step: 1 up to `inner`, 0 from `outer`, twice continuously differentiable between."""
    u = ((distance - inner) / (outer - inner)).clamp(0.0, 1.0)
    return 1.0 - u * u * u * (u * (6.0 * u - 15.0) + 10.0)


class ForceNetwork(nn.Module, ABC):
    """What networks of the interaction force share: window, clamp, anchor, drag."""

    pair_low: Tensor
    """Lowest pair inputs; lower ones are clamped."""
    pair_high: Tensor
    """Highest pair inputs."""
    environment_low: Tensor
    """Lowest environment inputs."""
    environment_high: Tensor
    """Highest environment inputs."""
    drag: Tensor
    """Linear drag by type, N s/m."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Set the constants that the weights of a subclass come beside.

        Args:
            spec: types, window, clamp and anchor.
            dtype: float32 for training, float64 for checks.
        """
        super().__init__()
        self.spec = spec
        limits = spec.input_range or UNLIMITED
        constants = {
            "pair_low": limits.pair[0],
            "pair_high": limits.pair[1],
            "environment_low": limits.environment[0],
            "environment_high": limits.environment[1],
            "drag": ((0.0,) * 3,) * len(spec.types),  # N s/m, of each type
        }
        for name, value in constants.items():
            self.register_buffer(name, torch.tensor(value, dtype=dtype), persistent=False)

    @property
    def types(self) -> tuple[str, ...]:
        """Vehicle types that it knows."""
        return self.spec.types

    @abstractmethod
    def named_networks(self) -> dict[str, nn.Module]:
        """Return its perceptrons by the names that they have in a weights file."""

    @abstractmethod
    def heads(self, batch: Batch) -> Tensor:
        """Outputs for every row, (R, 1) the vertical force in gram-force.

        With a torque head (R, 4): the force, and the torque in the world frame, gram-force cm.
        """

    def forward(self, batch: Batch) -> Tensor:
        """Vertical interaction force from the network alone, (R,) in gram-force."""
        return self.heads(batch)[:, 0]

    def window(self, pair: Tensor) -> Tensor:
        """Weight w of pairs (..., 6): 1 near, 0 outside the interaction volume."""
        x, y, z = pair[..., 0].abs(), pair[..., 1].abs(), pair[..., 2].abs()
        window = self.spec.window
        if window is None:
            inside = (torch.maximum(x, y) <= LATERAL_REACH) & (z <= VERTICAL_REACH)
            return inside.to(pair.dtype)
        lateral = fade(x, *window.lateral_m) * fade(y, *window.lateral_m)
        return lateral * fade(z, *window.vertical_m)

    def anchored(self, environment: Tensor) -> tuple[Tensor, Tensor | None]:
        """Inputs of the environment (R, 4) below the anchor, and those at it; None without one."""
        anchor = self.spec.anchor_height_m
        if anchor is None:
            return environment, None
        height = environment[:, :1].clamp(min=-anchor)
        aloft = torch.full_like(height, -anchor)
        velocity = environment[:, 1:]
        return torch.cat([height, velocity], dim=1), torch.cat([aloft, velocity], dim=1)

    def clamped(self, environment: Tensor) -> Tensor:
        """Inputs of the environment (R, 4) moved into the measured range."""
        return environment.clamp(self.environment_low, self.environment_high)

    def force_g(
        self, position: Tensor, velocity: Tensor, type_names: Sequence[str], drag: bool = True
    ) -> Tensor:
        """Vertical interaction force of every drone of every swarm, in gram-force.

        Args:
            position: (E, N, 3) positions in E separate swarms, m.
            velocity: (E, N, 3) velocities, m/s.
            type_names: N interaction types, the same in every swarm.
            drag: add the vertical drag -c v_z of the drone's type, as the shipped model does.

        Returns:
            (E, N) vertical force, gram-force.
        """
        batch = swarm_batch(position, velocity, [self.spec.types.index(n) for n in type_names])
        force: Tensor = self(batch).reshape(position.shape[:2])
        if drag:
            coefficient = self.drag[batch.ego_type, 2].reshape(force.shape)
            force = force - coefficient * velocity[..., 2] / GRAM_FORCE
        return force


class DeepSet(ForceNetwork):
    """phi per type, phi of the environment, rho per type; see the module's docstring."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Make a network with torch's default initialisation.

        Args:
            spec: types, window, clamp, anchor, sizes, whether there is a torque head.
            dtype: float32 for training, float64 for checks.
        """
        super().__init__(spec, dtype)
        phi = {name: perceptron((6, *spec.phi_widths), dtype) for name in spec.types}
        self.phi = nn.ModuleDict(phi)
        self.phi_environment = perceptron((4, *spec.phi_widths), dtype)
        self.rho = nn.ModuleDict({name: perceptron(spec.rho_widths, dtype) for name in spec.types})
        if spec.torque:
            width = spec.rho_widths[-2]
            heads = {name: nn.Linear(width, TORQUES, dtype=dtype) for name in spec.types}
            self.torque = nn.ModuleDict(heads)

    def named_networks(self) -> dict[str, nn.Module]:
        """Return its perceptrons by the names that they have in a weights file."""
        phi = {f"phi.{name}": module for name, module in self.phi.items()}
        rho = {f"rho.{name}": module for name, module in self.rho.items()}
        return {**phi, "phi.environment": self.phi_environment, **rho}

    def heads(self, batch: Batch) -> Tensor:
        """Outputs for every row, (R, 1) or (R, 4); see `ForceNetwork.heads`."""
        environment, aloft = self.anchored(batch.environment)
        hidden: Tensor = self.phi_environment(self.clamped(environment))
        hidden = hidden + self._pairs(batch)
        if aloft is None:
            return self._rho(batch.ego_type, hidden)
        reference: Tensor = self.phi_environment(self.clamped(aloft))
        both = self._rho(batch.ego_type.repeat(2), torch.cat([hidden, reference]))
        force, baseline = both.chunk(2)
        return force - baseline

    def _pairs(self, batch: Batch) -> Tensor:
        rows, slots = batch.pair_type.shape
        pair = batch.pair.reshape(rows * slots, 6)
        weight = self.window(pair)
        kind = torch.where(weight > 0, batch.pair_type.reshape(-1), -1)
        total = pair.new_zeros(rows, self.spec.hidden)
        for index, name in enumerate(self.spec.types):
            chosen = torch.nonzero(kind == index).squeeze(1)
            if len(chosen):
                inputs = pair[chosen].clamp(self.pair_low, self.pair_high)
                value = self.phi[name](inputs) * weight[chosen, None]
                total = total.index_add(0, chosen // slots, value)
        return total

    def _rho(self, ego_type: Tensor, hidden: Tensor) -> Tensor:
        outputs = hidden.new_zeros(len(hidden), 1 + TORQUES * self.spec.torque)
        for index, name in enumerate(self.spec.types):
            chosen = torch.nonzero(ego_type == index).squeeze(1)
            if len(chosen):
                outputs = outputs.index_add(0, chosen, self._of_type(name, hidden[chosen]))
        return outputs

    def _of_type(self, name: str, hidden: Tensor) -> Tensor:
        rho = self.rho[name]
        if not self.spec.torque:
            force: Tensor = rho(hidden)
            return force
        assert isinstance(rho, nn.Sequential)
        last: Tensor = rho[:-1](hidden)
        return torch.cat([rho[-1](last), self.torque[name](last)], dim=1)


def swarm_batch(position: Tensor, velocity: Tensor, types: Sequence[int]) -> Batch:
    """Rows of every drone of (E, N, 3) swarms, with all others as its neighbours."""
    envs, drones = position.shape[:2]
    others = torch.tensor([[j for j in range(drones) if j != i] for i in range(drones)])
    others = others.reshape(drones, drones - 1).long()
    kind = torch.tensor(list(types))
    state = torch.cat([position, velocity], dim=-1)
    pair = state[:, others] - state[:, :, None]
    environment = -torch.cat([position[..., 2:], velocity], dim=-1)
    return Batch(
        ego_type=kind.repeat(envs),
        environment=environment.reshape(envs * drones, 4),
        pair=pair.reshape(envs * drones, drones - 1, 6),
        pair_type=kind[others].repeat(envs, 1),
    )


def layers(network: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a perceptron in order."""
    return [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
