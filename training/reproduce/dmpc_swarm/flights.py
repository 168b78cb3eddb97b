"""A swarm that flies through a sequence of targets, and what is kept of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm
from swarm_envs.state import FloatArray

CRASH_M = 0.12
"""Scaled distance at which the paper counts a crash."""
_SAMPLES = 10
"""Instants kept of each round."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """How a swarm is run."""

    compute_units: int = 3
    """M."""
    trigger: str = "HT"
    """`HT`, `RR` or `DT`."""
    loss: LossModel | float = 0.0
    """Of messages."""
    recovery: bool | str = True
    """As for `simulate`."""
    seed: int = 0
    """Of losses and detours."""


@dataclass(frozen=True)
class Flight:
    """What the references of N drones did. T samples, a fiftieth of a second apart."""

    time: FloatArray
    """(T,) s."""
    position: FloatArray
    """(T, N, 3) m."""
    target: FloatArray
    """(T, N, 3) m."""
    arrivals_s: tuple[float, ...]
    """When all had arrived at each formation that they reached."""
    wanted: int
    """Formations to reach."""
    scaled_distance: FloatArray
    """(T,) least scaled distance of any two references, m."""

    @property
    def total_s(self) -> float | None:
        """When the last formation was reached, s; None if it was not."""
        return self.arrivals_s[-1] if len(self.arrivals_s) == self.wanted else None

    @property
    def legs_s(self) -> list[float]:
        """Time for each formation reached, s."""
        return [float(leg) for leg in np.diff([0.0, *self.arrivals_s])]


def fly(
    starts: FloatArray,
    formations: Sequence[FloatArray],
    setting: Setting,
    limit_s: float,
    config: MlrDmpcConfig,
) -> Flight:
    """Fly from one formation to the next, each begun in the round after the last was reached.

    Args:
        starts: (N, 3) m.
        formations: targets (N, 3), m, in order.
        setting: how the swarm is run.
        limit_s: when to give up, s.
        config: parameters.
    """
    swarm = MlrDmpcSwarm(
        starts,
        formations[0],
        config=config,
        compute_units=setting.compute_units,
        trigger=setting.trigger,
        loss=setting.loss,
        recovery=setting.recovery,
        seed=setting.seed,
    )
    since = np.arange(_SAMPLES, dtype=np.float64) * (config.round_s / _SAMPLES)
    positions: list[FloatArray] = []
    targets: list[FloatArray] = []
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
    time = np.arange(len(position), dtype=np.float64) * (config.round_s / _SAMPLES)
    closest = _least_scaled(position, config)
    return Flight(
        time, position, np.concatenate(targets), tuple(arrivals), len(formations), closest
    )


def _least_scaled(position: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    first, second = np.triu_indices(position.shape[1], 1)
    apart = (position[:, first] - position[:, second]) * config.inverse_scaling
    return np.asarray(np.linalg.norm(apart, axis=-1).min(axis=-1))
