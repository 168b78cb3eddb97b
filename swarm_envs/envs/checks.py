"""Checks of what a reset is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.errors import check_array, check_integer, check_kind, check_name
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import Team, parse_team

_RESET_OPTIONS = ("start", "goal", "team")
_API_TEST_OPTION = "options"  # PettingZoo's parallel_api_test passes it to every environment

_MOST_ENVS = 1_000_000


def check_num_envs(num_envs: object) -> int:
    """How many environments fly at once.

    Raises:
        ValueError: it is no integer of at least 1, or more than any memory holds.
    """
    return check_integer("num_envs", num_envs, 1, _MOST_ENVS)


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


class ResetOptions(NamedTuple):
    """What a reset was told, checked."""

    team: Team | None
    """Who flies; None for the constructor's team."""
    placement: dict[str, FloatArray]
    """What of `start` and `goal`, (N, 3) m, was given."""


def check_reset_options(options: Mapping[str, Any], num_drones: int) -> ResetOptions:
    """Reset options in the form that environments take.

    Raises:
        TypeError: the options are no mapping.
        ValueError: an option is unknown, an array of wrong shape or not finite, or a team unknown.
    """
    check_kind("options", options, Mapping, "{'start': [[0, 0, 1], [1, 0, 1]]}")
    given = {name: value for name, value in options.items() if name != _API_TEST_OPTION}
    for name in given:
        check_name("reset option", name, _RESET_OPTIONS)
    team = given.pop("team", None)
    return ResetOptions(
        None if team is None else parse_team(team),
        {name: check_array(name, value, (num_drones, 3)) for name, value in given.items()},
    )
