"""Which drones are planned anew: priorities (Appendix A), in 8 bit, and their order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.state import FloatArray, IntArray

TRIGGERS = ("HT", "RR", "DT")
"""The paper's rules of who is planned next: hybrid, round robin, distance."""
MEASURES = ("end", "next")
"""From where distances to the target count: the plan's end, or the next round's position."""

JUST_PLANNED = 0
"""Priority of a drone that has just been planned: it wins over the maximum."""
DEADLOCKED = 1
"""Priority of a drone in a deadlock."""
_LEAST, _MOST = 2, 254
REINITIALISED = 255
"""Priority of a drone whose trajectory begins anew."""
_FINEST, _COARSEST = 1e-4, 30.0

Levels = npt.NDArray[np.int64]
"""(N,) priorities as messages carry them, 8 bit."""


def urgency(
    trigger: str, distances: FloatArray, ages: IntArray, num_units: int, config: MlrDmpcConfig
) -> FloatArray:
    """(N,) what priorities are made of, (A1)-(A3).

    Args:
        trigger: `RR` by age, `DT` by distance, `HT` by their product.
        distances: (N,) from the target, m; as a share of the box's diagonal.
        ages: (N,) rounds since a drone was last planned, as a share of N / M.
        num_units: M.
        config: the box.
    """
    share = distances / float(np.linalg.norm(np.subtract(*config.box)))
    turns = ages * num_units / len(ages)
    return {"RR": turns, "DT": share, "HT": share * turns}[trigger]


def levels(urgencies: FloatArray) -> Levels:
    """(N,) urgencies in 8 bit, from 2 to 254, finer where they are small; the order is kept."""
    scale = math.log1p(_COARSEST / _FINEST)
    share = np.minimum(np.log1p(urgencies / _FINEST) / scale, 1.0)
    return np.asarray(_LEAST + np.rint(share * (_MOST - _LEAST)), dtype=np.int64)


def consensus(own: Levels, others: Iterable[Mapping[int, int]]) -> Levels:
    """(N,) priorities of all units as one, (11): the largest, but zero where any says zero."""
    joint = own.copy()
    zero = own == JUST_PLANNED
    for theirs in others:
        for drone, level in theirs.items():
            joint[drone] = max(joint[drone], level)
            zero[drone] |= level == JUST_PLANNED
    joint[zero] = JUST_PLANNED
    return joint


def ranked(priorities: Levels, round_: int) -> list[int]:
    """Drones by priority, highest first; ties go round, so that nobody always comes last."""
    count = len(priorities)
    turn = (np.arange(count) - round_) % count
    return [int(i) for i in np.lexsort((turn, -priorities))]
