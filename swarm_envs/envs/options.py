"""Checks of the options that users give to environment constructors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence

from swarm_envs.errors import check_integer, unknown_name
from swarm_envs.vehicles import Team, Vehicle, parse_team


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
