"""Reads a command line into options, and says by their own rules what a command does not take."""

from __future__ import annotations

import dataclasses
import difflib
import io
import math
import re
import typing
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import redirect_stderr, suppress
from pathlib import Path
from typing import TypeVar

import tyro

from swarm_envs import TASKS, task_family
from swarm_envs.arguments import Option, options_of
from swarm_envs.commands.checks import Misuse
from swarm_envs.errors import unknown_name

Options = TypeVar("Options")

_SYNONYMS = (
    {"agent", "agents", "model", "policy", "algorithm"},
    {"drones", "num-drones", "n-drones", "agents", "n", "robots"},
    {"task", "env", "environment", "scenario", "assignment"},
    {"out", "o", "output", "output-dir", "dir", "folder", "log-dir"},
    {"learning-rate", "lr", "rate"},
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


def read_options(
    options: type[Options],
    words: Sequence[str],
    program: str,
    prefixes: bool = False,
    description: str | None = None,
) -> Options:
    """Read the options of a command line into their dataclass.

    Args:
        options: the dataclass of a command's options.
        words: the command line after the command's name.
        program: the command, such as `swarm-envs fly`.
        prefixes: whether options of a nested dataclass are named after it, as `--logs.guard-s`.
        description: what the help begins with.

    Raises:
        Misuse: the command does not take these words, or the dataclass refuses their values.
        SystemExit: the help was asked for and printed.
    """
    mistake = find_mistake(options, words, prefixes)
    if mistake is None:
        config = () if prefixes else (tyro.conf.OmitArgPrefixes,)
        printed = io.StringIO()
        try:
            with redirect_stderr(printed):
                return tyro.cli(
                    options, args=[*words], description=description, prog=program, config=config
                )
        except SystemExit as end:
            if not end.code:
                raise
            mistake = _reason(end) or " ".join(printed.getvalue().split())
        except ValueError as error:
            mistake = str(error)
    raise Misuse(f"{mistake} (see `{program} --help`)")


def _reason(end: SystemExit) -> str:
    """What a constructor said before tyro printed it and ended the program; empty if none did."""
    error = end.__context__
    while error is not None and not isinstance(error, ValueError):
        error = error.__context__
    return "" if error is None else str(error)


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
    name, given, free = "", dict[str, list[str]](), _positional(options)
    for word in words:
        if re.match(r"--|-[A-Za-z]", word):
            name, equals, value = word.partition("=")
            name = name.replace("_", "-")
            if name not in table:
                near = _nearest(name.lstrip("-"), [n.lstrip("-") for n in table])
                return f"unknown option {name!r}" + (f"; did you mean '--{near}'?" if near else "")
            given[name] = [value] if equals else []
        elif name and len(given[name]) < _most_values(table[name]):
            given[name].append(word)
        elif free:
            name = free.pop(0)
            given[name] = [word]
        elif name and _is_switch(table[name]):
            return f"{name} takes no value, but got {word!r:.80}"
        else:
            return f"unexpected argument {word!r}" + _meant(table, word)
    mistakes = (_mistake(table[name], name, values) for name, values in given.items())
    return next(filter(None, mistakes), None) or _missing(table, given)


def _missing(table: dict[str, Option], given: Iterable[str]) -> str | None:
    """The options that must be given and are not."""
    there = [table[name] for name in given]
    missing = [
        f"{name} {{{','.join(option.kind.names)}}}" if option.kind.names else name
        for name, option in table.items()
        if option.default is dataclasses.MISSING and not any(option is each for each in there)
    ]
    return f"the following arguments are required: {', '.join(missing)}" if missing else None


def _mistake(option: Option, name: str, values: Sequence[str]) -> str | None:
    """Why an option does not take such values, if it does not."""
    if _is_switch(option):
        return f"{name} takes no value, but got {values[0]!r:.80}" if values else None
    kind, most = option.kind, _most_values(option)
    rule = kind.words.removesuffix(" or None").removesuffix(",").replace("pathlib.Path", "path")
    if not values:
        return f"{name} has no value, but must be {rule}"
    if len(values) < most < math.inf:
        return f"{name} is {' '.join(values)!r:.80}, but must be {rule}"
    value = next((value for value in values if not _takes(option, value)), None)
    if value is None:
        return None
    if kind.names:
        return unknown_name(name, value, kind.names)
    return f"{name} is {value!r:.80}, but must be {rule}" + _as_integers(option, value)


def _as_integers(option: Option, value: str) -> str:
    """The integer that a number such as 1e5 is, or the integers of 64,64, if they are taken."""
    parts = value.split(",")
    with suppress(ValueError, OverflowError):
        if all(float(part).is_integer() for part in parts):
            words = [str(int(float(part))) for part in parts]
            if all(_takes(option, word) for word in words) and _most_values(option) >= len(words):
                return f"; did you mean {' '.join(words)!r}?"
    return ""


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
    same += [n for n in known if n.endswith(f".{name}")]
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
        if tyro.conf.Suppress in typing.get_args(hints[name]):
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


def _most_values(option: Option) -> float:
    """How many values an option takes at most."""
    if _is_switch(option):
        return 0
    if option.kind.has_type([]):
        return math.inf
    numbers = [
        n for n in (2, 3) for each in (0, 0.5, "", Path()) if option.kind.has_type((each,) * n)
    ]
    return max(numbers, default=1)


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
    if value in ("True", "False"):
        yield value == "True"
    for kind in (str, int, float, Path):
        with suppress(ValueError):
            yield kind(value)
