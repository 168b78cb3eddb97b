"""Arrival times under MLR-DMPC, as published and by default.

    python -m benchmarks.mlr_arrivals [--flights 6] [--scenes swap formations circle ...]

A flight's excess is its time over the longest that one of its drones would need alone, from rest to
rest at the limits of speed, acceleration and jerk.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.rows import Row, sentence
from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, circle_swap, formation
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.simulate import simulate
from swarm_envs.state import FloatArray
from tests.helpers.mlr_rounds import scattered

DRONES, LIMIT_S = 16, 60.0
SCENES: dict[str, dict[str, Any]] = {
    "circle": {"compute_units": 3},
    "circle, one unit": {"compute_units": 1},
    "circle, 1 % loss": {"loss": 0.01},
    "circle, 10 % loss": {"loss": 0.1},
    "swap": {},
    "formations": {},
    "circle of 64": {"compute_units": 8},
}
"""Options of `simulate` by scene."""
WAYS: tuple[dict[str, Any], ...] = (
    {"config": MlrDmpcConfig.published(), "recovery": "paper"},
    {"config": MlrDmpcConfig(), "recovery": True},
)
"""Options of `simulate`: as published, and by default."""


def places(scene: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """Starts and targets (N, 3) of a flight, m."""
    if scene == "circle of 64":
        return circle_swap(64, 3.5, 1.0)
    if scene.startswith("circle"):
        return circle_swap(DRONES, 1.5, 1.0)
    if scene == "formations":
        legs = list(itertools.pairwise(SEQUENCE))
        first, second = legs[seed % len(legs)]
        return formation(first, DRONES), formation(second, DRONES)
    rng = np.random.default_rng(seed)
    starts = scattered(DRONES, MlrDmpcConfig(), rng)
    return starts, rng.permutation(starts)


def alone_s(starts: FloatArray, targets: FloatArray, config: MlrDmpcConfig) -> float:
    """Longest least time of a drone from rest to rest, if no other is there, s."""
    far = float(np.abs(targets - starts).max())
    speed, jerk = config.speed_limit, config.jerk_limit
    peak = min(config.acceleration_limit, np.sqrt(speed * jerk), np.cbrt(far * jerk**2 / 2.0))
    top = min(speed, np.sqrt((peak**2 / jerk) ** 2 / 4.0 + peak * far) - peak**2 / jerk / 2.0)
    return float(far / top + top / peak + peak / jerk)


def flown(scene: str, seed: int, way: dict[str, Any]) -> tuple[float, float]:
    """Time of a flight and its excess, s; infinite if it does not end."""
    starts, targets = places(scene, seed)
    config = way["config"]
    if scene == "circle of 64":
        config = replace(config, box=((-3.7, -3.7, 0.3), (3.7, 3.7, 3.0)))
    options = {"duration_s": LIMIT_S, **way, "config": config, **SCENES[scene]}
    flight = simulate(starts, targets, seed=seed, **options)
    assert not flight.violations
    time = np.inf if flight.arrival_time_s is None else flight.arrival_time_s
    return time, time - alone_s(starts, targets, config)


def row(scene: str, flights: int) -> Row:
    """A scene's times: median and worst, by default and as published, s."""
    paper, ours = (np.array([flown(scene, s, way) for s in range(flights)]) for way in WAYS)
    medians = np.median(ours, axis=0), np.median(paper, axis=0)
    return {
        "scene": scene,
        "median_s": medians[0][0],
        "worst_s": ours[:, 0].max(),
        "excess_s": medians[0][1],
        "published_median_s": medians[1][0],
        "published_worst_s": paper[:, 0].max(),
        "published_excess_s": medians[1][1],
        "excess_ratio": medians[0][1] / medians[1][1],
    }


def main(arguments: list[str] | None = None) -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--flights", type=int, default=6, help="of each scene")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), help="which")
    options = parser.parse_args(arguments)
    for scene in tqdm(options.scenes, unit="scene"):
        tqdm.write(sentence(row(scene, options.flights)))


if __name__ == "__main__":
    main()
