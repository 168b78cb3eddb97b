"""Checks of positions and indices that a swarm is given."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.errors import as_numbers, check_integer
from swarm_envs.state import FloatArray


def checked_points(
    what: str, points: FloatArray, config: MlrDmpcConfig, count: int | None = None
) -> FloatArray:
    """Return a copy of points (N, 3), m, or raise ValueError if drones cannot all hover there."""
    array = as_numbers(what, points).copy()
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise ValueError(f"{what} have shape {array.shape}, but must be (N, 3) in meters")
    if count is not None and len(array) != count:
        raise ValueError(f"there are {len(array)} {what}, but {count} drones")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} hold values that are not finite: {array.tolist()}")
    lower, upper = np.array(config.box)
    outside = ((array < lower) | (array > upper)).any(axis=1)
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise ValueError(
            f"{what}[{i}] = {array[i].tolist()} is outside the box {config.box}: move it, or set "
            "another box in MlrDmpcConfig"
        )
    gap = np.linalg.norm((array[:, None] - array) * config.inverse_scaling, axis=-1)
    np.fill_diagonal(gap, np.inf)
    if gap.min() < config.sampled_distance_m:
        i, j = sorted(int(k) for k in np.unravel_index(np.argmin(gap), gap.shape))
        raise ValueError(
            f"{what}[{i}] and {what}[{j}] are {gap.min():.3f} m apart when heights are divided by "
            f"{config.scaling[2] / config.scaling[0]:g}, but drones keep "
            f"{config.sampled_distance_m:.4f} m at samples, so as to keep {config.distance_m} m: "
            "move them apart"
        )
    return array


def checked_indices(
    what: str, given: Mapping[int, int], count: int, noun: str = "drone"
) -> dict[int, int]:
    """Return rounds by index of a drone or unit; raise ValueError for an unknown index."""
    for index, round_ in given.items():
        check_integer(f"{what}[{index!r}]", round_, 0)
        if check_integer(f"an index of {what}", index, 0) >= count:
            raise ValueError(
                f"{what} names {noun} {index}, but there are {count}: 0 to {count - 1}"
            )
    return dict(given)
