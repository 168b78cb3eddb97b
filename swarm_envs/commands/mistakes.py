"""What of a command line a command does not take, said by the options' own rules."""

from __future__ import annotations

import dataclasses
import difflib
import re
import typing
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import tyro

from swarm_envs import TASKS, task_family
from swarm_envs.arguments import Option, options_of
from swarm_envs.errors import unknown_name

_SYNONYMS = (
    {"agent", "agents", "model", "policy", "algorithm"},
    {"drones", "num-drones", "n-drones", "agents", "n", "robots"},
    {"task", "env", "environment", "scenario", "assignment"},
    {"out", "o", "output", "output-dir", "dir", "folder", "log-dir"},
    {"learning-rate", "lr", "rate"},
    {"n-epochs", "epochs", "num-epochs"},
    {"steps", "timesteps", "total-timesteps", "n-timesteps"},
    {"environments", "num-envs", "n-envs"},
    {"episodes", "flights", "num-episodes", "n-eval-episodes", "swaps"},
    {"workers", "num-workers", "jobs", "processes"},
    {"hidden", "net-arch", "layers"},
    {"video", "film", "movie"},
    {"replay", "page", "html", "render"},
    {"horizon-s", "time-limit", "horizon", "duration", "time-limit-s"},
    {"interactions", "forces", "force", "force-model", "model"},
    {"seed", "s", "random-seed"},
)
"""Names of one thing in other programs, or in other commands."""


def find_mistake(options: type, words: Sequence[str], prefixes: bool = False) -> str | None:
    """The first word that the command does not take, with the nearest that it does; None if none.

    Values of the right kind and a wrong size are refused by the options' constructor.

    Args:
        options: the dataclass of a command's options.
        words: the command line after the command's name.
        prefixes: whether options of a nested dataclass are named after it, as `--logs.guard-s`.
    """
    if not {"-h", "--help"}.isdisjoint(words):
        return None
    table = dict(_table(options, prefixes))
    for name, value in _values(words, _positional(options)):
        mistake = _mistake(table, name, value)
        if mistake is not None:
            return mistake
    return None


def _mistake(table: dict[str, Option], name: str, value: str | None) -> str | None:
    if not name:
        return f"unexpected argument {value!r}" + _meant(table, str(value))
    option = table.get(name)
    if option is None:
        near = _nearest(name.lstrip("-"), [n.lstrip("-") for n in table])
        return f"unknown option {name!r}" + (f"; did you mean '--{near}'?" if near else "")
    if value is None or _takes(option, value):
        return None
    kind = option.kind
    if kind.names:
        return unknown_name(name, value, kind.names)
    if _is_switch(option):
        return f"{name} takes no value, but got {value!r:.80}"
    rule = kind.words.removesuffix(" or None").removesuffix(",")
    return f"{name} is {value!r:.80}, but must be {rule}"


def _meant(table: Container[str], value: str) -> str:
    """The option that a value without one is for, if it names a task or an agent."""
    from swarm_envs.agents.registry import SHIPPED

    tasks = {*TASKS, *map(task_family, TASKS)}
    for option, names in (("--task", tasks), ("--agent", SHIPPED)):
        if option in table and (value in names or (option == "--agent" and ".py:" in value)):
            return f"; did you mean '{option} {value}'?"
    return ""


def _nearest(name: str, valid: Iterable[str]) -> str | None:
    """The option that another program calls by this name, or one that is written like it."""
    known = [*valid]
    same = [n for group in _SYNONYMS if name in group for n in known if n in group]
    near = same or difflib.get_close_matches(name, known, 1, 0.65)
    return near[0] if near else None


def _table(options: type, prefixes: bool, prefix: str = "") -> Iterator[tuple[str, Option]]:
    """The options by their names on the command line; positional ones by their own."""
    hints = typing.get_type_hints(options, include_extras=True)
    positional = _positional(options)
    for name, option in options_of(options).items():
        if dataclasses.is_dataclass(option.default):
            nested = f"{prefix}{name}." if prefixes else prefix
            yield from _table(type(option.default), prefixes, nested)
            continue
        yield name if name in positional else _flag(prefix + name), option
        for mark in typing.get_args(hints[name]):
            yield from ((alias, option) for alias in getattr(mark, "aliases", None) or ())
        if _is_switch(option):
            yield _flag(f"{prefix}no-{name}"), option


def _positional(options: type) -> list[str]:
    hints = typing.get_type_hints(options, include_extras=True)
    names = [field.name for field in dataclasses.fields(options)]
    return [name for name in names if tyro.conf.Positional in typing.get_args(hints[name])]


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _values(words: Sequence[str], positional: Sequence[str]) -> Iterator[tuple[str, str | None]]:
    """Each option, and each value with the option that it follows, or stands for."""
    option, free = "", iter(positional)
    for word in words:
        if re.match(r"--|-[A-Za-z]", word):
            name, equals, value = word.partition("=")
            option = name.replace("_", "-")
            yield option, value if equals else None
        else:
            yield option or next(free, ""), word


def _is_switch(option: Option) -> bool:
    """Whether it is given without a value: `--labels` or `--no-labels`."""
    return option.kind.words == "True or False"


def _takes(option: Option, value: str) -> bool:
    """Whether some reading of the text has the option's type, or that of its elements."""
    if _is_switch(option):
        return False
    return value == "None" or any(
        option.kind.has_type(each) or any(option.kind.has_type((each,) * n) for n in (1, 2, 3))
        for each in _read(value)
    )


def _read(value: str) -> Iterator[object]:
    """What a text can be read as."""
    for kind in (str, int, float, Path):
        with suppress(ValueError):
            yield kind(value)
