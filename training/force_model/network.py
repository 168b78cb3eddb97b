"""The heterogeneous deep set of Neural-Swarm2 (eq. 10) as a torch module.

    f_i = rho_i( phi_env(-z_i, -v_i) + sum over neighbours j of w_ij phi_type(j)(p_ij, v_ij) )

with p_ij = p_j - p_i and v_ij = v_j - v_i. The output is the vertical force on i in gram-force.
Three things are added to the paper's form, all part of the forward pass, so that training sees
the function that ships: a smooth window w, clamping of the inputs to the measured range, and an
anchor that makes a lone drone aloft feel exactly nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from swarm_envs.vehicles import GRAM_FORCE

_FIRST_WIDTH = 25  # of phi's first hidden layer
_WIDTH = 40  # of every other hidden layer

HARD_LATERAL_M = 0.35
HARD_VERTICAL_M = 1.1
"""Half edges of the interaction volume, where a network without a window cuts off."""


class Window(NamedTuple):
    """Where a pair's contribution fades from 1 to 0: |dx| and |dy|, and |dz|."""

    lateral_m: tuple[float, float] = (0.25, 0.35)
    vertical_m: tuple[float, float] = (0.8, 1.1)


EVERYWHERE = Window((1e3, 1.001e3), (1e3, 1.001e3))
"""A window so wide that every neighbour counts fully."""


@dataclass(frozen=True)
class InputRange:
    """Range that inputs are clamped to before phi: lowest and highest value of each input."""

    pair: tuple[tuple[float, ...], tuple[float, ...]]
    """Of p_ij and v_ij: 6 lowest, 6 highest."""
    environment: tuple[tuple[float, ...], tuple[float, ...]]
    """Of -z_i and -v_i: 4 lowest, 4 highest."""


UNLIMITED = InputRange(((-math.inf,) * 6, (math.inf,) * 6), ((-math.inf,) * 4, (math.inf,) * 4))
"""No clamp at all."""

_FAR = InputRange(((-1e6,) * 6, (1e6,) * 6), ((-1e6,) * 4, (1e6,) * 4))  # JSON has no infinity

OUTER_FADE = Window()
"""The fade of the models that ship: over the outer 0.1 m laterally and 0.3 m vertically."""


@dataclass(frozen=True)
class DeepSetSpec:
    """What a deep set computes beside its weights."""

    types: tuple[str, ...]
    """Vehicle types: each has its own phi and rho."""
    window: Window | None = OUTER_FADE
    """Smooth fade of pairs; None cuts off hard at |dx|, |dy| = 0.35 m and |dz| = 1.1 m."""
    input_range: InputRange | None = None
    """Clamp of the inputs; None leaves them."""
    anchor_height_m: float | None = 0.6
    """At and above this height a lone drone feels exactly zero; None for the paper's form."""
    hidden: int = 20
    """H, the number of outputs of every phi and inputs of every rho (Sec. VII-C)."""
    layers: int = 4
    """L, the number of layers of every phi and rho; 40-wide ones come or go (Sec. VII-C)."""

    def __post_init__(self) -> None:
        """Check the sizes.

        Raises:
            ValueError: there would be no hidden state, or phi no hidden layer.
        """
        if self.hidden < 1:
            raise ValueError(f"hidden is {self.hidden}, but must be at least 1")
        if self.layers < 2:
            raise ValueError(f"layers is {self.layers}, but must be at least 2")

    @property
    def phi_widths(self) -> tuple[int, ...]:
        """Widths of phi after its input (6 for a vehicle, 4 for the environment)."""
        return (_FIRST_WIDTH, *(_WIDTH,) * (self.layers - 2), self.hidden)

    @property
    def rho_widths(self) -> tuple[int, ...]:
        """Widths of rho from its input to its output."""
        return (self.hidden, *(_WIDTH,) * (self.layers - 1), 1)


def without_velocity(spec: DeepSetSpec) -> DeepSetSpec:
    """The same function, blind to velocities: the range they are clamped to is the point 0.

    The environment is a neighbour at rest, so its relative velocity goes too. Being a clamp, the
    blindness is part of the weights file, and every reader of it is as blind.
    """
    limits = spec.input_range or _FAR
    still = (0.0, 0.0, 0.0)
    pair = ((*limits.pair[0][:3], *still), (*limits.pair[1][:3], *still))
    environment = ((limits.environment[0][0], *still), (limits.environment[1][0], *still))
    return replace(spec, input_range=InputRange(pair, environment))


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


class DeepSet(nn.Module):
    """phi per type, phi of the environment, rho per type; see the module's docstring."""

    pair_low: Tensor
    pair_high: Tensor
    environment_low: Tensor
    environment_high: Tensor
    drag: Tensor

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Make a network with torch's default initialisation.

        Args:
            spec: types, window, clamp and anchor.
            dtype: float32 for training, float64 for checks.
        """
        super().__init__()
        self.spec = spec
        phi = {name: perceptron((6, *spec.phi_widths), dtype) for name in spec.types}
        self.phi = nn.ModuleDict(phi)
        self.phi_environment = perceptron((4, *spec.phi_widths), dtype)
        self.rho = nn.ModuleDict({name: perceptron(spec.rho_widths, dtype) for name in spec.types})
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

    def window(self, pair: Tensor) -> Tensor:
        """Weight w of pairs (..., 6): 1 near, 0 outside the interaction volume."""
        x, y, z = pair[..., 0].abs(), pair[..., 1].abs(), pair[..., 2].abs()
        window = self.spec.window
        if window is None:
            inside = (x <= HARD_LATERAL_M) & (y <= HARD_LATERAL_M) & (z <= HARD_VERTICAL_M)
            return inside.to(pair.dtype)
        lateral = fade(x, *window.lateral_m) * fade(y, *window.lateral_m)
        return lateral * fade(z, *window.vertical_m)

    def forward(self, batch: Batch) -> Tensor:
        """Vertical interaction force from the network alone, (R,) in gram-force."""
        environment = batch.environment
        anchor = self.spec.anchor_height_m
        if anchor is not None:
            height = environment[:, :1].clamp(min=-anchor)
            environment = torch.cat([height, environment[:, 1:]], dim=1)
        hidden = self._environment(environment) + self._pairs(batch)
        if anchor is None:
            return self._rho(batch.ego_type, hidden)
        aloft = torch.full_like(environment[:, :1], -anchor)
        reference = self._environment(torch.cat([aloft, environment[:, 1:]], dim=1))
        both = self._rho(batch.ego_type.repeat(2), torch.cat([hidden, reference]))
        force, baseline = both.chunk(2)
        return force - baseline

    def _environment(self, environment: Tensor) -> Tensor:
        inputs = environment.clamp(self.environment_low, self.environment_high)
        hidden: Tensor = self.phi_environment(inputs)
        return hidden

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
        force = hidden.new_zeros(len(hidden))
        for index, name in enumerate(self.spec.types):
            chosen = torch.nonzero(ego_type == index).squeeze(1)
            if len(chosen):
                force = force.index_add(0, chosen, self.rho[name](hidden[chosen]).squeeze(1))
        return force

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
