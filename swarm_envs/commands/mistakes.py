"""Which word of a command line an option cannot take, said by the option's own rule."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import tyro

from swarm_envs.arguments import Option, options_of
from swarm_envs.errors import unknown_name


def find_mistake(options: type, words: Sequence[str], prefixes: bool = False) -> str | None:
    """The first value that is of the wrong kind, with the rule and the nearest name; None if none.

    Values of the right kind and a wrong size are refused by the options' constructor.

    Args:
        options: the dataclass of a command's options.
        words: the command line after the command's name.
        prefixes: whether options of a nested dataclass are named after it, as `--logs.guard-s`.
    """
    table = dict(_table(options, prefixes))
    for name, value in _values(words, _positional(options)):
        if name in table and not _takes(table[name], value):
            kind = table[name].kind
            if kind.names:
                return unknown_name(name, value, kind.names)
            rule = kind.words.removesuffix(" or None").removesuffix(",")
            return f"{name} is {value!r:.80}, but must be {rule}"
    return None


def _table(options: type, prefixes: bool, prefix: str = "") -> Iterator[tuple[str, Option]]:
    """The options by their names on the command line; positional ones by their own."""
    positional = _positional(options)
    for name, option in options_of(options).items():
        if dataclasses.is_dataclass(option.default):
            nested = f"{prefix}{name}." if prefixes else prefix
            yield from _table(type(option.default), prefixes, nested)
        else:
            yield name if name in positional else _flag(prefix + name), option


def _positional(options: type) -> list[str]:
    hints = typing.get_type_hints(options, include_extras=True)
    names = [field.name for field in dataclasses.fields(options)]
    return [name for name in names if tyro.conf.Positional in typing.get_args(hints[name])]


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _values(words: Sequence[str], positional: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Each value with the option that it follows, or stands for."""
    option, free = "", iter(positional)
    for word in words:
        if word.startswith("--"):
            name, equals, value = word.partition("=")
            option = _flag(name.removeprefix("--"))
            if equals:
                yield option, value
        else:
            yield option or next(free, ""), word


def _takes(option: Option, value: str) -> bool:
    """Whether some reading of the text has the option's type, or that of its elements.

    What flags take is not known here.
    """
    if value == "None" or option.kind.fits(True):
        return True
    return any(
        option.kind.has_type(each) or any(option.kind.has_type((each,) * n) for n in (1, 2, 3))
        for each in _read(value)
    )


def _read(value: str) -> Iterator[object]:
    """What a text can be read as."""
    for kind in (str, int, float, Path):
        with suppress(ValueError):
            yield kind(value)
