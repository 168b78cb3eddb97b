"""Options of environments that `fly`, `evaluate` and `train` share."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf
from typing import Any, Literal

from swarm_envs.envs.config import EnvConfig

__all__ = ["WorldOptions", "parse_values"]

_OTHER_NAMES = {"num_drones": "drones", "num_neighbors": "neighbors"}
"""Options of environments that have other names on the command line."""
_TASK_OPTIONS = ("layout", "obstacles", "task", "team")  # options of commands, not of `EnvConfig`
_CONSTANTS = {"true": True, "yes": True, "false": False, "no": False, "none": None, "null": None}


@dataclass(frozen=True, kw_only=True)
class WorldOptions:
    """Options of the world. An option that is None has the task's default."""

    world: Literal["ideal", "hall"] | None = None
    """World: `ideal`, or `hall`, a motion-capture hall with random forces and state estimation
    errors. If None, the task's default."""
    randomization: str | None = None
    """Domain randomization, such as `mass=0.9:1.1,gust_acceleration=1`; the names are fields of
    `swarm_envs.envs.randomization.Randomization`. If None, the task's default."""
    obstacles: str | None = None
    """Obstacles, such as `buildings=2:2,column=1:1:0.15` (x, y and radius, m) or
    `box=0:0:0:1:1:2` (two corners, m). If None, the task's default."""
    on_contact: Literal["end_team", "end_pair", "bounce"] | None = None
    """Effect of a contact: `end_team` ends the episode of the whole team, `end_pair` that of the
    drones in contact; with `bounce`, they bounce off and continue. If None, the task's default."""

    observe_range_m: float | None = None
    """Communication range, m; neighbors farther away are not observed. If None, unlimited."""
    observe_delay_s: float | None = None
    """Communication delay of observed neighbors, s, rounded up to decisions. If None, 0."""
    observe_loss: float | None = None
    """Packet loss: probability that a neighbor is not observed in a decision. If None, 0."""

    env: tuple[str, ...] = ()
    """Other options of the environment as NAME=VALUE, such as fields of a custom task, or with
    quotes "reward_weights={'crash': -2.0}". Values are numbers, True, False, None, strings, or
    lists and dictionaries of these."""

    def world_options(self) -> dict[str, Any]:
        """Return the options that were given, as values for JSON; raises as `env_options` does."""
        names = [field.name for field in fields(WorldOptions) if field.name != "env"]
        given = {name: value for name in names if (value := getattr(self, name)) is not None}
        return given | self.env_options()

    def env_options(self) -> dict[str, Any]:
        """Return the options of `env`, as values for JSON.

        Raises:
            ValueError: an entry is not NAME=VALUE, a value has another type, or the command has an
                option of its own for it.
        """
        others = parse_values("--env", self.env, "spacing_m=0.8")
        shared = {field.name for field in fields(EnvConfig)} | {*_OTHER_NAMES, *_TASK_OPTIONS}
        for name in filter(shared.__contains__, others):
            own = _OTHER_NAMES.get(name, name)
            if hasattr(self, own) or hasattr(self, name):
                option = f"--{own.replace('_', '-')}"
                raise ValueError(f"--env has {name!r}, which has its own option; use {option}")
        return {name: _plain(name, value) for name, value in others.items()}


def _plain(name: str, value: Any) -> Any:
    """Return a value that JSON represents exactly, with lists in place of tuples."""
    if isinstance(value, list | tuple):
        return [_plain(name, each) for each in value]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: _plain(name, each) for key, each in value.items()}
    if isinstance(value, str) and value.lower() in _CONSTANTS:
        constant = _CONSTANTS[value.lower()]
        raise ValueError(f"--env has {name}={value}, which is a string; write {name}={constant}")
    if value is None or (isinstance(value, str | int | float) and value not in (inf, -inf)):
        return value
    raise ValueError(
        f"--env has {name}={value!r}, but values are finite numbers, True, False, None, strings, "
        "or lists and dictionaries of these, whose keys are strings"
    )


def parse_values(option: str, entries: Sequence[str], example: str) -> dict[str, Any]:
    """Return the values of entries NAME=VALUE, Python literals or else strings, by name.

    Raises:
        ValueError: an entry has another form, which the message shows by the example, or a name
            stands twice.
    """
    found: dict[str, Any] = {}
    for entry in entries:
        name, equals, value = entry.partition("=")
        if not (name.isidentifier() and equals):
            raise ValueError(f"{option} has {entry!r}, but must have NAME=VALUE, as in {example}")
        if name in found:
            raise ValueError(f"{option} has {name!r} twice; give one value")
        try:
            found[name] = ast.literal_eval(value)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            found[name] = value  # a string, such as auto
    return found
