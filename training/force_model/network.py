"""The deep set of Neural-Swarm2, and what networks of the interaction force share.

The heterogeneous deep set (eq. 10) is

    f_i = rho_i( phi_env(-z_i, -v_i) + sum over neighbors j of w_ij phi_type(j)(p_ij, v_ij) )

with p_ij = p_j - p_i and v_ij = v_j - v_i. The output is the vertical force on i in gram-force.
Three things are added to the paper's form, all part of the forward pass, so that training sees
the function that ships: a smooth window w, clamping of the inputs to the measured range, and an
anchor that makes a lone drone aloft feel exactly nothing.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from swarm_envs.errors import check_integer, check_number

__all__ = ["InputRange"]

NetworkKind = Literal["deep-set", "composed", "wake"]
"""`deep-set`: Neural-Swarm2, eq. 10; `composed`: pushes of pairs that are joined,
`composed.Composed`; `wake`: the closed form, `wake.Wake`."""

_FIRST_WIDTH = 25  # of phi's first hidden layer
_WIDTH = 40  # of every other hidden layer


class FadeWindow(NamedTuple):
    """Where a pair's contribution fades from 1 to 0: |dx| and |dy|, and |dz|."""

    lateral_m: tuple[float, float] = (0.25, 0.35)
    """Where pairs begin to fade laterally, and where they are gone, m."""
    vertical_m: tuple[float, float] = (0.8, 1.1)  # The same in height, m


EVERYWHERE = FadeWindow((1e3, 1.001e3), (1e3, 1.001e3))
"""A window so wide that every neighbor counts fully."""


@dataclass(frozen=True)
class InputRange:
    """Range that inputs are clamped to before phi: lowest and highest value of each input."""

    pair: tuple[tuple[float, ...], tuple[float, ...]]
    """Of p_ij and v_ij: 6 lowest, 6 highest."""
    environment: tuple[tuple[float, ...], tuple[float, ...]]
    """Of -z_i and -v_i: 4 lowest, 4 highest."""


UNLIMITED = InputRange(((-1e6,) * 6, (1e6,) * 6), ((-1e6,) * 4, (1e6,) * 4))
"""No clamp of any input that there is; JSON has no infinity."""

OUTER_FADE = FadeWindow()
"""The fade of the models that ship: over the outer 0.1 m laterally and 0.3 m vertically."""


@dataclass(frozen=True)
class DeepSetSpec:
    """The function of a network, without its weights."""

    types: tuple[str, ...]
    """Vehicle types: each has its own phi and rho."""
    window: FadeWindow = OUTER_FADE
    """Smooth fade of pairs."""
    input_range: InputRange | None = None
    """Clamp of the inputs; None leaves them."""
    anchor_height_m: float | None = 0.6
    """At and above this height a lone drone feels exactly zero; None for the paper's form."""
    hidden: int = 20
    """H, the number of outputs of every phi and inputs of every rho (Sec. VII-C)."""
    layers: int = 4
    """L, the number of layers of every phi and rho; 40-wide ones come or go (Sec. VII-C)."""
    kind: NetworkKind = "deep-set"
    """Which function of the neighbors it is."""
    torque: bool = False
    """True if rho gives the torque too; of a deep set alone."""

    def __post_init__(self) -> None:
        """Refuse values that a network cannot have."""
        _check_types(self.types)
        if self.anchor_height_m is not None:
            check_number("anchor_height_m", self.anchor_height_m, above=0.0, unit="m")
        check_integer("hidden", self.hidden, at_least=1)
        check_integer("layers", self.layers, at_least=2)
        if self.torque and self.kind != "deep-set":
            raise ValueError(f"a {self.kind} network gives no torque; only a deep set does")

    @property
    def phi_widths(self) -> tuple[int, ...]:
        """Widths of phi after its input (6 for a vehicle, 4 for the environment)."""
        return (_FIRST_WIDTH, *(_WIDTH,) * (self.layers - 2), self.hidden)

    @property
    def rho_widths(self) -> tuple[int, ...]:
        """Widths of rho from its input to its output."""
        return (self.hidden, *(_WIDTH,) * (self.layers - 1), 1)


def _check_types(types: tuple[str, ...]) -> None:
    for name in types:
        if not name or "." in name or name == "environment" or hasattr(nn.ModuleDict(), name):
            raise ValueError(
                f"{name!r} cannot name a vehicle type, since weights are filed by it; choose a "
                "name without full stop, such as 'XL'"
            )
    if len(set(types)) < len(types) or not types:
        raise ValueError(f"types are {types}, but must be one or more different names")


def without_velocity(spec: DeepSetSpec) -> DeepSetSpec:
    """The same function, blind to velocities: the range they are clamped to is the point 0.

    The environment is a neighbor at rest, so its relative velocity goes too. Being a clamp, the
    blindness is part of the weights file, and every reader of it is as blind.
    """
    limits = spec.input_range or UNLIMITED
    still = (0.0, 0.0, 0.0)
    pair = ((*limits.pair[0][:3], *still), (*limits.pair[1][:3], *still))
    environment = ((limits.environment[0][0], *still), (limits.environment[1][0], *still))
    return replace(spec, input_range=InputRange(pair, environment))


TORQUES = 3  # Numbers of a torque head: the components in the world frame, gram-force centimeter


class Batch(NamedTuple):
    """Rows as the network takes them."""

    ego_type: Tensor  # (R,) index of the drone's type
    environment: Tensor  # (R, 4) -z_i (m), -v_i (m/s)
    pair: Tensor  # (R, K, 6) p_ij (m), v_ij (m/s)
    pair_type: Tensor  # (R, K) type of each neighbor, -1 for none


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


def of_types(kind: Tensor, count: int) -> Iterator[tuple[int, Tensor]]:
    """Each of `count` types that some of the entries (R,) have, and their places."""
    for index in range(count):
        places = torch.nonzero(kind == index).squeeze(1)
        if len(places):
            yield index, places


class ForceNetwork(nn.Module, ABC):
    """The parts that all networks of the interaction force share: window, clamp, anchor, drag."""

    pair_low: Tensor  # Lowest pair inputs; lower ones are clamped
    pair_high: Tensor  # Highest pair inputs
    environment_low: Tensor  # Lowest environment inputs
    environment_high: Tensor  # Highest environment inputs
    drag: Tensor  # Linear drag by type, N s/m

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Set what a subclass has beside weights, in float32 for training, float64 for checks."""
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
    def silence_drone(self, index: int) -> None:
        """Let a type, by its index, feel nothing by itself: no row shows what it feels."""

    @abstractmethod
    def heads(self, batch: Batch) -> Tensor:
        """Outputs for every row, (R, 1) the vertical force in gram-force.

        Of a composed model (R, 3): then the force in x and y. With a torque head (R, 4): then the
        torque in the world frame, gram-force cm.
        """

    def forward(self, batch: Batch) -> Tensor:
        """Vertical interaction force from the network alone, (R,) in gram-force."""
        return self.heads(batch)[:, 0]

    def window(self, pair: Tensor) -> Tensor:
        """Weight w of pairs (..., 6): 1 near, 0 outside the interaction volume."""
        x, y, z = pair[..., 0].abs(), pair[..., 1].abs(), pair[..., 2].abs()
        window = self.spec.window
        lateral = fade(x, *window.lateral_m) * fade(y, *window.lateral_m)
        return lateral * fade(z, *window.vertical_m)

    def slots(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Slots of all rows as one list: pairs (P, 6), weights, types (-1 without weight), rows."""
        rows, count = batch.pair_type.shape
        pair = batch.pair.reshape(rows * count, 6)
        weight = self.window(pair)
        kind = torch.where(weight > 0, batch.pair_type.reshape(-1), -1)
        return pair, weight, kind, torch.arange(rows).repeat_interleave(count)

    def pair_kinds(self, batch: Batch, kind: Tensor, row: Tensor) -> Iterator[tuple[int, Tensor]]:
        """Pairs of types, numbered [neighbor, drone] in rows, and the slots that have them."""
        count = len(self.types)
        both = torch.where(kind < 0, -1, kind * count + batch.ego_type[row])
        return of_types(both, count * count)

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


class DeepSet(ForceNetwork):
    """phi per type, phi of the environment, rho per type; see the module's docstring."""

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
        """Return its perceptrons by the names that they have in a weights file."""
        phi = {f"phi.{name}": module for name, module in self.phi.items()}
        rho = {f"rho.{name}": module for name, module in self.rho.items()}
        return {**phi, "phi.environment": self.phi_environment, **rho}

    def silence_drone(self, index: int) -> None:
        """Let rho and the torque of a type give zero."""
        name = self.types[index]
        silence(self.rho[name])
        if self.spec.torque:
            silence(self.torque[name])

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
    """Let a perceptron give zero."""
    last = layers(network)[-1]
    last.weight.zero_()
    last.bias.zero_()
