"""The deep set of Neural-Swarm2, and the base class of networks of the interaction force.

The heterogeneous deep set (eq. 10) is

    f_i = rho_i( phi_env(-z_i, -v_i) + sum over neighbors j of w_ij phi_type(j)(p_ij, v_ij) )

with p_ij = p_j - p_i and v_ij = v_j - v_i. The output is the vertical force on i in gram-force.
The forward pass has three additions to the paper's form: a smooth window w, clamping of the inputs
to the measured range, and an anchor that makes the force on a lone drone aloft exactly zero.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

__all__ = ["InputRange"]

NetworkKind = Literal["deep-set", "composed", "wake"]
"""`deep-set`: Neural-Swarm2, eq. 10; `composed`: `composed.Composed`; `wake`: the closed form,
`wake.Wake`."""

_FIRST_WIDTH = 25  # Width of phi's first hidden layer
_WIDTH = 40  # Width of every other hidden layer


class FadeWindow(NamedTuple):
    """The distances over which a pair's contribution fades from 1 to 0."""

    lateral_m: tuple[float, float] = (0.25, 0.35)
    """|dx| and |dy| at which the fade begins and ends, m."""
    vertical_m: tuple[float, float] = (0.8, 1.1)
    """|dz| at which the fade begins and ends, m."""


EVERYWHERE = FadeWindow((1e3, 1.001e3), (1e3, 1.001e3))
"""A window in which every neighbor counts fully."""


@dataclass(frozen=True)
class InputRange:
    """The range to which inputs are clamped: lowest and highest value of each input."""

    pair: tuple[tuple[float, ...], tuple[float, ...]]
    """The range of p_ij and v_ij: 6 lowest, 6 highest."""
    environment: tuple[tuple[float, ...], tuple[float, ...]]
    """The range of -z_i and -v_i: 4 lowest, 4 highest."""


UNLIMITED = InputRange(((-1e6,) * 6, (1e6,) * 6), ((-1e6,) * 4, (1e6,) * 4))
"""A range without effect; JSON has no infinity."""

OUTER_FADE = FadeWindow()
"""The fade of the included models: over the outer 0.1 m horizontally and 0.3 m vertically."""


@dataclass(frozen=True)
class DeepSetSpec:
    """The function of a network, without its weights."""

    types: tuple[str, ...]
    """The vehicle types; each has its own phi and rho."""
    window: FadeWindow = OUTER_FADE
    """The smooth fade of pairs."""
    input_range: InputRange | None = None
    """The clamp of the inputs; None for no clamp."""
    anchor_height_m: float | None = 0.6
    """The height, m, from which the force on a lone drone is zero; None for the paper's form."""
    hidden: int = 20
    """H, the number of outputs of every phi and inputs of every rho (Sec. VII-C)."""
    layers: int = 4
    """L, the number of layers of every phi and rho (Sec. VII-C)."""
    kind: NetworkKind = "deep-set"
    """The function of the neighbors."""
    torque: bool = False
    """True if rho outputs the torque too; for a deep set only."""

    def __post_init__(self) -> None:
        """Raise ValueError for names of vehicle types that weights cannot have."""
        _check_types(self.types)

    @property
    def phi_widths(self) -> tuple[int, ...]:
        """The widths of phi after its input (6 for a vehicle, 4 for the environment)."""
        return (_FIRST_WIDTH, *(_WIDTH,) * (self.layers - 2), self.hidden)

    @property
    def rho_widths(self) -> tuple[int, ...]:
        """The widths of rho from its input to its output."""
        return (self.hidden, *(_WIDTH,) * (self.layers - 1), 1)


def _check_types(types: tuple[str, ...]) -> None:
    for name in types:
        if not name or "." in name or name == "environment" or hasattr(nn.ModuleDict(), name):
            raise ValueError(
                f"{name!r} cannot be the name of a vehicle type, because it is used in names of "
                "weights; choose another without a period, such as 'XL'"
            )
    if len(set(types)) < len(types) or not types:
        raise ValueError(f"types are {types}, but must be one or more different names")


def without_velocity(spec: DeepSetSpec) -> DeepSetSpec:
    """Return the function without velocities as inputs: they are clamped to 0.

    This includes the drone's own velocity, which is relative to the environment. The clamp is part
    of the weights file.
    """
    limits = spec.input_range or UNLIMITED
    still = (0.0, 0.0, 0.0)
    pair = ((*limits.pair[0][:3], *still), (*limits.pair[1][:3], *still))
    environment = ((limits.environment[0][0], *still), (limits.environment[1][0], *still))
    return replace(spec, input_range=InputRange(pair, environment))


TORQUES = 3  # Outputs of a torque head: the components in the world frame, gram-force centimeter


class Batch(NamedTuple):
    """The network's inputs of R rows."""

    ego_type: Tensor  # (R,) index of the drone's type
    environment: Tensor  # (R, 4) -z_i (m), -v_i (m/s)
    pair: Tensor  # (R, K, 6) p_ij (m), v_ij (m/s)
    pair_type: Tensor  # (R, K) type of each neighbor, -1 for none


def perceptron(widths: Sequence[int], dtype: torch.dtype = torch.float32) -> nn.Sequential:
    """Return fully connected layers with ReLU between them and a linear output (eq. 11)."""
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Linear(before, after, dtype=dtype), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def fade(distance: Tensor, inner: float, outer: float) -> Tensor:
    """Return the quintic step: 1 up to `inner`, 0 from `outer`, twice differentiable."""
    u = ((distance - inner) / (outer - inner)).clamp(0.0, 1.0)
    return 1.0 - u * u * u * (u * (6.0 * u - 15.0) + 10.0)


def of_types(kind: Tensor, count: int) -> Iterator[tuple[int, Tensor]]:
    """Yield each of `count` types that occurs in the entries (R,), and the indices of these."""
    for index in range(count):
        places = torch.nonzero(kind == index).squeeze(1)
        if len(places):
            yield index, places


class ForceNetwork(nn.Module, ABC):
    """Base class of networks of the interaction force, with window, clamp, anchor and drag."""

    pair_low: Tensor  # Lowest pair inputs; lower ones are clamped
    pair_high: Tensor  # Highest pair inputs
    environment_low: Tensor  # Lowest environment inputs
    environment_high: Tensor  # Highest environment inputs
    drag: Tensor  # Linear drag by type, N s/m

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Set the constants, in float32 for training or float64 for checks."""
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
        """The vehicle types."""
        return self.spec.types

    @abstractmethod
    def named_networks(self) -> dict[str, nn.Module]:
        """Return the perceptrons by their names in a weights file."""

    @abstractmethod
    def silence_drone(self, index: int) -> None:
        """Set the force on a type without training rows, by its index, to zero."""

    @abstractmethod
    def heads(self, batch: Batch) -> Tensor:
        """Return the outputs for every row: (R, 1), the vertical force, gram-force.

        A composed model has (R, 3), with the force in x and y. With a torque head it is (R, 4),
        with the torque in the world frame, gram-force cm.
        """

    def forward(self, batch: Batch) -> Tensor:
        """Return the vertical interaction force without drag, (R,), gram-force."""
        return self.heads(batch)[:, 0]

    def window(self, pair: Tensor) -> Tensor:
        """Return the weights w of pairs (..., 6): 1 near, 0 outside the interaction volume."""
        x, y, z = pair[..., 0].abs(), pair[..., 1].abs(), pair[..., 2].abs()
        window = self.spec.window
        lateral = fade(x, *window.lateral_m) * fade(y, *window.lateral_m)
        return lateral * fade(z, *window.vertical_m)

    def slots(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return all slots as one list: pairs (P, 6), weights, types (-1 without weight), rows."""
        rows, count = batch.pair_type.shape
        pair = batch.pair.reshape(rows * count, 6)
        weight = self.window(pair)
        kind = torch.where(weight > 0, batch.pair_type.reshape(-1), -1)
        return pair, weight, kind, torch.arange(rows).repeat_interleave(count)

    def pair_kinds(self, batch: Batch, kind: Tensor, row: Tensor) -> Iterator[tuple[int, Tensor]]:
        """Yield the index of each type pair [neighbor, drone] that occurs, and its slots."""
        count = len(self.types)
        both = torch.where(kind < 0, -1, kind * count + batch.ego_type[row])
        return of_types(both, count * count)

    def anchored(self, environment: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return the environment's inputs (R, 4) up to the anchor, and those at it or None."""
        anchor = self.spec.anchor_height_m
        if anchor is None:
            return environment, None
        height = environment[:, :1].clamp(min=-anchor)
        aloft = torch.full_like(height, -anchor)
        velocity = environment[:, 1:]
        return torch.cat([height, velocity], dim=1), torch.cat([aloft, velocity], dim=1)

    def clamped(self, environment: Tensor) -> Tensor:
        """Return the environment's inputs (R, 4) clamped to the measured range."""
        return environment.clamp(self.environment_low, self.environment_high)


class DeepSet(ForceNetwork):
    """The heterogeneous deep set: phi and rho per type, and phi of the environment."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Make a network with torch's default initialization."""
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
        """Return the perceptrons by their names in a weights file."""
        phi = {f"phi.{name}": module for name, module in self.phi.items()}
        rho = {f"rho.{name}": module for name, module in self.rho.items()}
        return {**phi, "phi.environment": self.phi_environment, **rho}

    def silence_drone(self, index: int) -> None:
        """Set the outputs of rho and the torque head of a type to zero."""
        name = self.types[index]
        silence(self.rho[name])
        if self.spec.torque:
            silence(self.torque[name])

    def heads(self, batch: Batch) -> Tensor:
        """Return the outputs for every row, (R, 1) or (R, 4); see `ForceNetwork.heads`."""
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
        pair, weight, kind, row = self.slots(batch)
        total = pair.new_zeros(len(batch.ego_type), self.spec.hidden)
        for index, chosen in of_types(kind, len(self.types)):
            inputs = pair[chosen].clamp(self.pair_low, self.pair_high)
            value = self.phi[self.types[index]](inputs) * weight[chosen, None]
            total = total.index_add(0, row[chosen], value)
        return total

    def _rho(self, ego_type: Tensor, hidden: Tensor) -> Tensor:
        outputs = hidden.new_zeros(len(hidden), 1 + TORQUES * self.spec.torque)
        for index, chosen in of_types(ego_type, len(self.types)):
            value = self._of_type(self.types[index], hidden[chosen])
            outputs = outputs.index_add(0, chosen, value)
        return outputs

    def _of_type(self, name: str, hidden: Tensor) -> Tensor:
        rho = self.rho[name]
        if not self.spec.torque:
            force: Tensor = rho(hidden)
            return force
        assert isinstance(rho, nn.Sequential)
        last: Tensor = rho[:-1](hidden)
        return torch.cat([rho[-1](last), self.torque[name](last)], dim=1)


def layers(network: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a perceptron in order."""
    return [layer for layer in network.modules() if isinstance(layer, nn.Linear)]


@torch.no_grad()
def silence(network: nn.Module) -> None:
    """Set the output of a perceptron to zero."""
    last = layers(network)[-1]
    last.weight.zero_()
    last.bias.zero_()
