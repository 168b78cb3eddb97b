"""What a force network computes beside its weights: types, window, clamp, anchor, sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from torch import nn

from swarm_envs.arguments import typed

NetworkKind = Literal["deep-set", "pairwise"]
"""`deep-set`: Neural-Swarm2, eq. 10; `pairwise`: the sum over pairs, `pairwise.PairwiseSum`."""

_FIRST_WIDTH = 25  # of phi's first hidden layer
_WIDTH = 40  # of every other hidden layer


class Window(NamedTuple):
    """Where a pair's contribution fades from 1 to 0: |dx| and |dy|, and |dz|."""

    lateral_m: tuple[float, float] = (0.25, 0.35)
    """Where pairs begin to fade laterally, and where they are gone, m."""
    vertical_m: tuple[float, float] = (0.8, 1.1)
    """The same in height, m."""


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


@typed
@dataclass(frozen=True)
class DeepSetSpec:
    """What a deep set computes beside its weights."""

    types: tuple[str, ...]
    """Vehicle types: each has its own phi and rho."""
    window: Window | None = OUTER_FADE
    """Smooth fade of pairs; None cuts off hard at the edges of the interaction volume."""
    input_range: InputRange | None = None
    """Clamp of the inputs; None leaves them."""
    anchor_height_m: float | None = 0.6
    """At and above this height a lone drone feels exactly zero; None for the paper's form."""
    hidden: int = 20
    """H, the number of outputs of every phi and inputs of every rho (Sec. VII-C)."""
    layers: int = 4
    """L, the number of layers of every phi and rho; 40-wide ones come or go (Sec. VII-C)."""
    kind: NetworkKind = "deep-set"
    """Which function of the neighbours it is."""
    torque: bool = False
    """Whether rho gives the torque too; of a deep set alone."""

    def __post_init__(self) -> None:
        """Check names and sizes.

        Raises:
            ValueError: there would be no hidden state, or phi no hidden layer; a type's name
                cannot stand in a weights file; a torque is asked of a sum over pairs; or the anchor
                is not above the ground.
        """
        _check_types(self.types)
        if self.torque and self.kind != "deep-set":
            raise ValueError(f"a {self.kind} network gives no torque; only a deep set does")
        if self.hidden < 1:
            raise ValueError(f"hidden is {self.hidden}, but must be at least 1")
        if self.layers < 2:
            raise ValueError(f"layers is {self.layers}, but must be at least 2")
        if self.anchor_height_m is not None and not self.anchor_height_m > 0.0:
            raise ValueError(
                f"anchor_height_m is {self.anchor_height_m}, but must be above 0; give None for no "
                "anchor"
            )

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

    The environment is a neighbour at rest, so its relative velocity goes too. Being a clamp, the
    blindness is part of the weights file, and every reader of it is as blind.
    """
    limits = spec.input_range or _FAR
    still = (0.0, 0.0, 0.0)
    pair = ((*limits.pair[0][:3], *still), (*limits.pair[1][:3], *still))
    environment = ((limits.environment[0][0], *still), (limits.environment[1][0], *still))
    return replace(spec, input_range=InputRange(pair, environment))
