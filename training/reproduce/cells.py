"""The cells of Neural-Swarm2's Table III, with its values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cell:
    """One cell of the table: what differs from H = 20, L = 4, velocities seen, weights clipped."""

    name: str
    """Also its folder's name."""
    paper_mean: float | None = None
    """Validation MSE in the paper, g^2; None where it gives none."""
    paper_deviation: float | None = None
    hidden: int = 20
    layers: int = 4
    relative_velocity: bool = True
    clipped: bool = True


CELLS = (
    Cell("H=20,L=4", 6.42, 0.18),
    Cell("H=10", 6.70, 0.05, hidden=10),
    Cell("H=40", 6.63, 0.35, hidden=40),
    Cell("L=3", 6.52, 0.17, layers=3),
    Cell("L=5", 7.21, 0.28, layers=5),
    Cell("no-relative-velocity", 7.60, relative_velocity=False),
    Cell("no-spectral-norm", clipped=False),
)
"""Table III, and from Sec. VII-C the networks that do not see velocities; the paper says nothing
of networks without spectral normalisation."""
