"""How close drones came in a round, and how close the next one may plan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.collection.collect import was_cut_short
from swarm_envs.training.collection.table import Flight
from swarm_envs.vehicles import parse_team

PASSING_M = 0.2
"""Drones pass each other while they are so near laterally: within a wake's width."""
QUANTILE = 0.95
"""Of the swaps, whose worst gap errors decide on the next round."""
LARGEST_STEP = 0.3
"""A round plans at least this share of the last one's clearance, so that models extrapolate little.
"""


@dataclass(frozen=True)
class Closeness:
    """How close drones came in the flights of a round, by their logs."""

    gap_error_m: float
    """By how much vertical gaps of passing drones differed from the planned ones: the largest of
    each swap, the 95 % quantile of the swaps. A wake widens them first, and as soon as the lower
    drone has left it, the controller's integral makes up for it and they are too small."""
    least_clearance_m: float
    """Smallest vertical clearance of two spheres that stood over each other in a swap."""
    least_distance_ratio: float
    """Smallest distance of two drones in any flight over the sum of their radii: 1 is a touch."""
    flights: int
    """Flights that were looked at."""
    seconds: float
    """Their length together, s."""
    cut_swaps: int
    """Swaps that ended before their time, at a contact."""
    cut_walks: int
    """Random walks that did."""


class _Pair:
    """Two drones of a flight, seen from one."""

    def __init__(self, flight: Flight, i: int, j: int) -> None:
        team, log = parse_team(flight.team), flight.log
        self.radii = team[i].radius + team[j].radius
        self.apart: FloatArray = log.position[:, j] - log.position[:, i]
        planned = np.abs(log.setpoint[:, j, 2] - log.setpoint[:, i, 2])
        self.lateral: FloatArray = np.hypot(self.apart[:, 0], self.apart[:, 1])
        self.gap: FloatArray = np.abs(self.apart[:, 2])
        self.error: FloatArray = np.abs(planned - self.gap)


def measure(flights: Sequence[Flight], duration_s: float) -> Closeness:
    """Measure closeness in flights of teams, from positions and set-points as logged.

    Args:
        flights: of one round.
        duration_s: how long each was to last.
    """
    swaps = [flight for flight in flights if "swap" in flight.name]
    errors = [max((_worst(p.error, p.lateral) for p in _pairs(f)), default=0.0) for f in swaps]
    over = [float(_over(p).min()) for f in swaps for p in _pairs(f) if len(_over(p))]
    ratios = [
        float(np.linalg.norm(p.apart, axis=1).min() / p.radii)
        for flight in flights
        if len(flight.log.position)
        for p in _pairs(flight)
    ]
    cut = [flight.name for flight in flights if was_cut_short(flight, duration_s)]
    cut_swaps = sum("swap" in name for name in cut)
    return Closeness(
        gap_error_m=round(float(np.quantile(errors, QUANTILE)), 4) if errors else 0.0,
        least_clearance_m=round(min(over), 4) if over else float("nan"),
        least_distance_ratio=round(min(ratios), 3) if ratios else float("nan"),
        flights=len(flights),
        seconds=round(sum(flight.seconds for flight in flights), 1),
        cut_swaps=cut_swaps,
        cut_walks=len(cut) - cut_swaps,
    )


@typed
def next_clearance(
    clearance_m: float, closeness: Closeness, unknown: float, margin: float, least_m: float
) -> float:
    """The clearance that the next round may plan, m.

    Gaps go wrong by the force that the pilot does not know. So the gap error to expect is the one
    that was measured, times the share of the then unknown force that is still unknown. The next
    clearance is at least `margin` times that, at least 0.3 of this round's, at least `least_m`;
    and no smaller than this round's if a swap ended in a contact.

    Args:
        clearance_m: planned in the round that was flown, m.
        closeness: measured in it.
        unknown: RMS error of the new model over that of what the pilot knew, both against the
            labels of the round's held-out flights.
        margin: how many expected gap errors to keep.
        least_m: never less, m.
    """
    expected = closeness.gap_error_m * min(unknown, 1.0)
    wanted = max(margin * expected, LARGEST_STEP * clearance_m, least_m)
    if closeness.cut_swaps:
        wanted = max(wanted, clearance_m)
    return round(wanted, 4)


def _pairs(flight: Flight) -> Iterator[_Pair]:
    for i, j in combinations(range(len(parse_team(flight.team))), 2):
        yield _Pair(flight, i, j)


def _worst(error: FloatArray, lateral: FloatArray) -> float:
    passing: BoolArray = lateral < PASSING_M
    return float(error[passing].max()) if passing.any() else 0.0


def _over(pair: _Pair) -> FloatArray:
    """Vertical clearances while the two spheres stand over each other."""
    return np.asarray(pair.gap[pair.lateral < pair.radii] - pair.radii)
