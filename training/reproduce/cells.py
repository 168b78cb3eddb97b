"""The cells of Neural-Swarm2's Table III, with its values, and the comparisons beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cell:
    """One cell of the table: what differs from H = 20, L = 4, velocities seen, weights clipped."""

    name: str
    """Also its folder's name."""
    paper_mean: float | None = None
    """Validation MSE in the paper, g^2; None where it gives none."""
    paper_deviation: float | None = None
    """The paper's standard deviation; None if it gives none."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Options of a fit by name that are set otherwise."""


CELLS = (
    Cell("H=20,L=4", 6.42, 0.18),
    Cell("H=10", 6.70, 0.05, {"hidden": 10}),
    Cell("H=40", 6.63, 0.35, {"hidden": 40}),
    Cell("L=3", 6.52, 0.17, {"layers": 3}),
    Cell("L=5", 7.21, 0.28, {"layers": 5}),
    Cell("no-relative-velocity", 7.60, None, {"relative_velocity": False}),
    Cell("no-spectral-norm", changes={"spectral": "none"}),
    Cell("exact-spectral-norm", changes={"spectral": "exact"}),
    Cell("pairwise", changes={"model": "pairwise"}),
)
"""Table III; from Sec. VII-C the networks that do not see velocities; and what the paper gives no
number for: no spectral normalisation, or eq. (12) to the letter, and a sum over pairs."""
