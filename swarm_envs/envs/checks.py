"""Checks of what a reset is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.errors import check_array, check_kind, check_name
from swarm_envs.state import BoolArray, FloatArray

_PLACEMENT_OPTIONS = ("start", "goal")
_API_TEST_OPTION = "options"  # PettingZoo's parallel_api_test passes it to every environment


def check_mask(mask: BoolArray | None, num_envs: int) -> BoolArray:
    """The (E,) mask of environments, all of them for None.

    Raises:
        ValueError: it is not one boolean an environment.
    """
    if mask is None:
        return np.ones(num_envs, dtype=np.bool_)
    array = np.array(mask)
    if array.dtype != np.bool_ or array.shape != (num_envs,):
        raise ValueError(
            f"mask has type {array.dtype} and shape {array.shape}, but must be {num_envs} "
            "booleans, one an environment"
        )
    return array


def check_seeds(seeds: Sequence[int | None] | None, num_envs: int) -> None:
    """Refuse seeds that are not one an environment.

    Raises:
        ValueError: their number is another.
    """
    if seeds is not None and len(seeds) != num_envs:
        raise ValueError(f"seeds has {len(seeds)} entries, but must have {num_envs}")


def check_placement_options(options: Mapping[str, Any], num_drones: int) -> dict[str, FloatArray]:
    """Reset options that fix starts or goals, as arrays (N, 3).

    Raises:
        TypeError: the options are no mapping.
        ValueError: an option is unknown, or an array of wrong shape or not finite.
    """
    check_kind("options", options, Mapping, "{'start': [[0, 0, 1], [1, 0, 1]]}")
    given = {name: value for name, value in options.items() if name != _API_TEST_OPTION}
    for name in given:
        check_name("reset option", name, _PLACEMENT_OPTIONS)
    return {name: check_array(name, value, (num_drones, 3)) for name, value in given.items()}
