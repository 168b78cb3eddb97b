"""Simulations of the references of MLR-DMPC, without drones and tracking errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from examples.papers.common import Array
from swarm_envs.baselines.mlr_dmpc import MlrDmpcConfig, MlrDmpcSwarm
from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, circle_swap, formation

CRASH_M = 0.12
"""Scaled distance at which the paper counts a crash, m."""
PUBLISHED: dict[str, Any] = {
    "config": MlrDmpcConfig.published(measure="end"),
    "recovery": "paper",
}
"""Options of `MlrDmpcSwarm` as published, with priorities by the end of plans: so does the public
simulation, of which the times are; (A2) and (A3) say the position in the next round."""
OURS: dict[str, Any] = {"config": MlrDmpcConfig(), "recovery": True}
"""The defaults of this package."""
_SEQUENCE_LIMIT_S, _CIRCLE_LIMIT_S = 120.0, 60.0  # when a flight is given up
_RADIUS_M, _HEIGHT_M = 1.5, 1.0  # of the circle
_SAMPLES = 10  # instants that are kept of each round


@dataclass(frozen=True)
class ReferenceFlight:
    """The references of N drones at T samples, a fiftieth of a second apart."""

    time: Array  # (T,) s
    position: Array  # (T, N, 3) m
    target: Array  # (T, N, 3) m
    arrivals_s: tuple[float, ...]  # when all had arrived, for each formation that was reached
    wanted: int  # number of formations to reach
    scaled_distance: Array  # (T,) least scaled distance of any two references, m

    @property
    def total_s(self) -> float | None:
        """Time at which the last formation was reached, s; None if it was not."""
        return self.arrivals_s[-1] if len(self.arrivals_s) == self.wanted else None

    @property
    def legs_s(self) -> list[float]:
        """Time for each formation that was reached, s."""
        return [float(leg) for leg in np.diff([0.0, *self.arrivals_s])]


def fly_sequence(drones: int, **options: Any) -> ReferenceFlight:
    """Fly plane, pyramid, cube, sphere and plane (Fig. 3a); options are those of `MlrDmpcSwarm`."""
    places = [formation(name, drones) for name in SEQUENCE]
    return fly_references(places[0], places[1:], _SEQUENCE_LIMIT_S, **options)


def fly_circle(drones: int, **options: Any) -> ReferenceFlight:
    """Fly each drone to the opposite side of a circle; options are those of `MlrDmpcSwarm`."""
    starts, targets = circle(drones)
    return fly_references(starts, [targets], _CIRCLE_LIMIT_S, **options)


def circle(drones: int) -> tuple[Array, Array]:
    """Return the starts and targets (N, 3), m, of the circle."""
    return circle_swap(drones, _RADIUS_M, _HEIGHT_M)


def fly_references(
    starts: Array,
    formations: Sequence[Array],
    limit_s: float,
    config: MlrDmpcConfig,
    **options: Any,
) -> ReferenceFlight:
    """Fly from one formation (N, 3), m, to the next, begun in the round after that was reached.

    The flight is given up after `limit_s`; options are those of `MlrDmpcSwarm`.
    """
    swarm = MlrDmpcSwarm(starts, formations[0], config=config, **options)
    since = np.arange(_SAMPLES, dtype=np.float64) * (config.round_s / _SAMPLES)
    positions, targets = list[Array](), list[Array]()
    arrivals: list[float] = []
    for k in range(round(limit_s / config.round_s)):
        target = formations[len(arrivals)]
        flown = swarm.reference(since)[:, :, 0].transpose(1, 0, 2)
        positions.append(flown)
        targets.append(np.broadcast_to(target, flown.shape))
        away = np.linalg.norm(flown - target, axis=-1).max(axis=-1)
        near = np.flatnonzero(away <= config.arrival_m)
        if len(near):
            arrivals.append(k * config.round_s + float(since[near[0]]))
            if len(arrivals) == len(formations):
                break
        swarm.run_round(targets=formations[len(arrivals)])
    position = np.concatenate(positions)
    return ReferenceFlight(
        time=np.arange(len(position), dtype=np.float64) * (config.round_s / _SAMPLES),
        position=position,
        target=np.concatenate(targets),
        arrivals_s=tuple(arrivals),
        wanted=len(formations),
        scaled_distance=least_scaled(position, config),
    )


def least_scaled(position: Array, config: MlrDmpcConfig) -> Array:
    """Return the least scaled distance (T,) of any two of the positions (T, N, 3), m."""
    first, second = np.triu_indices(position.shape[1], 1)
    apart = (position[:, first] - position[:, second]) * config.inverse_scaling
    return np.asarray(np.linalg.norm(apart, axis=-1).min(axis=-1))


def measure(flights: Sequence[ReferenceFlight]) -> dict[str, Any]:
    """Return the numbers of the flights of a case, ready for JSON."""
    totals = [flight.total_s for flight in flights]
    least = [float(flight.scaled_distance.min()) for flight in flights]
    return {
        "total_s": totals,
        "legs_s": [flight.legs_s for flight in flights],
        "arrived": sum(total is not None for total in totals),
        "least_scaled_distance_m": least,
        "crashes": sum(distance < CRASH_M for distance in least),
    }


def median_total(case: Mapping[str, Any]) -> float:
    """Return the median of the times to the last arrival, s; NaN unless at least half arrived."""
    totals = sorted(float("inf") if t is None else float(t) for t in case["total_s"])
    middle = totals[(len(totals) - 1) // 2]
    return float("nan") if middle == float("inf") else middle
