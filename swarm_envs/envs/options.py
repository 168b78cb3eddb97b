"""Checks of the options that users give to environment constructors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.envs.episodes import PLACEMENT_OPTIONS
from swarm_envs.errors import check_array, check_integer, check_kind, check_name, unknown_name
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import Team, Vehicle, parse_team

_API_TEST_OPTION = "options"  # PettingZoo's parallel_api_test passes it to every environment


def refuse_unknown(constructor: Callable[..., object], unknown: Mapping[str, object]) -> None:
    """Refuse keyword arguments that a constructor does not have.

    Raises:
        TypeError: there is one; the message names the nearest that exists.
    """
    valid = [name for name in inspect.signature(constructor).parameters if name != "unknown"]
    for name in unknown:
        raise TypeError(unknown_name("option", name, valid))


def team_of(team: str | Sequence[Vehicle] | None, num_drones: int) -> Team:
    """The team that was asked for: as given, else `num_drones` small ones.

    Raises:
        ValueError: there would be no drone, or a token is unknown.
    """
    if team is not None:
        return parse_team(team)
    return parse_team("S" * check_integer("num_drones", num_drones, 1))


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
        check_name("reset option", name, PLACEMENT_OPTIONS)
    return {name: check_array(name, value, (num_drones, 3)) for name, value in given.items()}
