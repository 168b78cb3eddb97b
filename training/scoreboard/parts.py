"""A JSON object that is taken apart: what is missing or of a wrong kind is named by its place."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

_MUST = object()
"""Stands for no default: the key must be there."""


def finite(constant: str) -> NoReturn:
    """Refuse NaN and infinities: for `json.loads(parse_constant=...)`.

    Raises:
        ValueError: always.
    """
    raise ValueError(f"it holds {constant}, which is no number; null says that there is none")


@dataclass(frozen=True)
class Part:
    """A JSON object and where it stands in the file.

    Each method raises ValueError, which names the place, the value and the rule, unless the key
    holds what is asked for.
    """

    content: Mapping[str, Any]
    """The object."""
    where: str
    """Such as `cells[3]`; empty for the whole file."""

    def place(self, key: str) -> str:
        """Where a key stands."""
        return f"{self.where}.{key}".lstrip(".")

    def raw(self, key: str, default: Any = _MUST) -> Any:
        """Whatever the key holds."""
        if key in self.content:
            return self.content[key]
        if default is _MUST:
            raise ValueError(f"{self.place(key)} is missing")
        return default

    def _refuse(self, key: str, value: object, rule: str) -> NoReturn:
        raise ValueError(f"{self.place(key)} is {value!r:.80}, but must be {rule}")

    def text(self, key: str, default: Any = _MUST) -> str:
        """A string; null counts as missing where there is a default."""
        value = self.raw(key, default)
        if value is None and default is not _MUST:
            value = default
        if not isinstance(value, str):
            self._refuse(key, value, "a string")
        return value

    def one_of(self, key: str, allowed: Collection[str]) -> str:
        """A string out of those that are known."""
        value = self.text(key)
        if value not in allowed:
            self._refuse(key, value, f"one of {', '.join(sorted(allowed)):.200}")
        return value

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self.raw(key)
        if not isinstance(value, bool):
            self._refuse(key, value, "true or false")
        return value

    def integer(self, key: str, default: Any = _MUST) -> int:
        """A whole number from 0 on."""
        value = self.raw(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            self._refuse(key, value, "a whole number, 0 or more")
        return value

    def number(self, key: str) -> float | None:
        """A finite number, or null."""
        value = self.raw(key)
        return None if value is None else self._checked(key, value)

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...]:
        """A list of finite numbers, so many if a count is given."""
        value = self.raw(key)
        if not isinstance(value, list) or count not in (None, len(value)):
            of = "" if count is None else f" of {count}"
            self._refuse(key, value, f"a list{of} of numbers")
        return tuple(self._checked(key, each) for each in value)

    def interval(self, key: str) -> tuple[float, float] | None:
        """Two numbers in order, or null."""
        if self.raw(key, None) is None:
            return None
        low, high = self.numbers(key, 2)
        if low > high:
            self._refuse(key, [low, high], "two numbers in order")
        return low, high

    def part(self, key: str) -> Part:
        """An object."""
        value = self.raw(key)
        if not isinstance(value, dict):
            self._refuse(key, value, "an object")
        return Part(value, self.place(key))

    def parts(self, key: str) -> list[Part]:
        """A list of objects."""
        value = self.raw(key)
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            self._refuse(key, value, "a list of objects")
        return [Part(each, f"{self.place(key)}[{k}]") for k, each in enumerate(value)]

    def named(self, allowed: Collection[str]) -> Iterator[tuple[str, Part]]:
        """Its keys, each of them known, and the object that each holds."""
        for key in self.content:
            if key not in allowed:
                raise ValueError(f"{self.where} names {key!r}, which the file does not list")
            yield key, self.part(key)

    def _checked(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._refuse(key, value, "a number")
        if not math.isfinite(value):
            self._refuse(key, value, "finite")
        return float(value)


def part_of(content: object) -> Part:
    """A whole file.

    Raises:
        ValueError: it holds no object.
    """
    if not isinstance(content, dict):
        raise ValueError(f"it holds {content!r:.80}, but must hold an object")
    return Part(content, "")
