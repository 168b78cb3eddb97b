"""The eight cases of Neural-Swarm2's Fig. 5: who stands where, and what the paper reads there.

The paper's text gives the drones of (a), (e) and (g), the speed in (d), and says that a small
drone feels the force; the rest stands in the picture alone. Each case says what is whose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

EGO = "S"
"""The drone that feels the force: small in all eight cases (Sec. VII-C)."""

WITHOUT_GROUND_M = 1.0
"""How far the cases without a ground are lifted: the flights show no ground effect there."""


class Neighbour(NamedTuple):
    """A drone that blows: everything lies in the plane x = 0."""

    kind: str
    """`S` or `L`."""
    y: float
    """m."""
    z: float
    """m."""
    vy: float = 0.0
    """m/s."""


@dataclass(frozen=True)
class Case:
    """One heat map."""

    letter: str
    """Of the panel in the figure."""
    title: str
    """What flies."""
    neighbours: tuple[Neighbour, ...]
    """Those that blow."""
    ground: bool
    """Whether the map begins at the ground; otherwise it begins `WITHOUT_GROUND_M` above."""
    stated: str
    """What the paper's text says of it."""
    assumed: str
    """What we chose, since only the picture shows it."""

    @property
    def floor_m(self) -> float:
        """Height at which the map begins."""
        return 0.0 if self.ground else WITHOUT_GROUND_M


_UP = 0.5 + WITHOUT_GROUND_M
_THREE = ((0.0, 0.6), (-0.1, 0.5), (0.1, 0.5))

CASES = (
    Case("a", "ground only", (), True, "no neighbour; ground at z = 0", ""),
    Case(
        "b",
        "S over the ground",
        (Neighbour("S", 0.0, 0.5),),
        True,
        "one small neighbour over the ground, which mitigates its downwash",
        "its place (0, 0.5)",
    ),
    Case(
        "c",
        "S aloft, hovering",
        (Neighbour("S", 0.0, _UP),),
        False,
        "one neighbour, hovering",
        "small, at (0, 0.5), without ground: else (c) would be (b)",
    ),
    Case(
        "d",
        "S aloft, moving at 0.8 m/s",
        (Neighbour("S", 0.0, _UP, 0.8),),
        False,
        "one neighbour moving at 0.8 m/s",
        "as (c); towards +y",
    ),
    Case(
        "e",
        "L and S",
        (Neighbour("L", -0.1, 0.5), Neighbour("S", 0.1, 0.5)),
        True,
        "large at (-0.1, 0.5), small at (0.1, 0.5)",
        "",
    ),
    Case(
        "f",
        "L and L",
        (Neighbour("L", -0.1, 0.5), Neighbour("L", 0.1, 0.5)),
        True,
        "nothing",
        "two large ones where (e) has its two",
    ),
    Case(
        "g",
        "three S",
        tuple(Neighbour("S", y, z) for y, z in _THREE),
        True,
        "four vehicles, three of them small neighbours, over the ground",
        "at (0, 0.6), (-0.1, 0.5), (0.1, 0.5)",
    ),
    Case(
        "h",
        "L and two S",
        tuple(Neighbour(kind, y, z) for kind, (y, z) in zip("LSS", _THREE, strict=True)),
        True,
        "four vehicles",
        "as (g) with a large one at the top",
    ),
)
"""The panels of Fig. 5."""


class Reading(NamedTuple):
    """A number that the paper reads off Fig. 5."""

    name: str
    """Of the number that is read off."""
    what: str
    """What it says."""
    paper_g: float
    """The paper's value, g."""
    published_weights_g: float
    """The same from the weights that the authors published."""


READINGS = (
    Reading("ground_effect", "(a): small drone at (0, 0.05)", 5.0, 1.7),
    Reading("two_above", "(e): small drone at (0, 0.3)", -10.0, -12.4),
    Reading("superposition_gap", "(g): largest gap to the sum of pairs", 11.4, 3.7),
)
"""The first and the last are not reproduced by the published weights: nothing is tuned to them."""
