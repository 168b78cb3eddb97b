"""Numbers and comments as C99 source has them, for the headers that models are exported to."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")


def check_prefix(name: str) -> None:
    """Refuse what cannot begin an identifier.

    Raises:
        ValueError: naming it.
    """
    if not _PREFIX.fullmatch(name):
        raise ValueError(
            f"name is {name!r}, but must be a letter and up to 30 letters, digits or underscores"
        )


def filled(text: str, words: Mapping[str, str]) -> str:
    """A text with its @words@ replaced."""
    return re.sub(r"@(\w+)@", lambda found: words[found[1]], text)


def comment(lines: Iterable[str]) -> str:
    """Lines of a block comment, which they cannot end."""
    return "\n".join(" *   " + line.replace("*/", "* /").replace("/*", "/ *") for line in lines)


def enumeration(prefix: str, types: tuple[str, ...], taken: tuple[str, ...]) -> str:
    """Constants of types of vehicles, under their names as far as C takes them, and their number.

    Args:
        prefix: of each, in capitals.
        types: their names.
        taken: names after the prefix that mean something else.
    """
    names = [re.sub(r"\W", "_", kind, flags=re.ASCII) for kind in types]
    if len({*names, *taken}) < len(names) + len(taken):
        names = [f"TYPE_{k}" for k in range(len(names))]
    rows = [f"    {prefix}_{name} = {k}," for k, name in enumerate(names)]
    return "\n".join([*rows, f"    {prefix}_TYPES = {len(types)}"])


def array(name: str, values: npt.ArrayLike) -> str:
    """Definition of a constant array of float32, of one dimension or two."""
    numbers = np.asarray(values)
    if numbers.ndim == 1:
        return f"static const float {name}[] = {{\n{lines(map(number, numbers))}}};"
    return f"static const float {name}[][{numbers.shape[1]}] = {{\n{rows(numbers)}}};"


def rows(numbers: npt.NDArray[np.generic]) -> str:
    """Initialisers of the rows of an array of two dimensions."""
    return ",\n".join(f"    {{{lines(map(number, row)).lstrip()}}}" for row in numbers)


def lines(words: Iterable[str], each: int = 7) -> str:
    """Words with commas between them, so many a line."""
    given = list(words)
    joined = [", ".join(given[k : k + each]) for k in range(0, len(given), each)]
    return ",\n".join(f"    {line}" for line in joined)


def number(value: float) -> str:
    """An integer, or the shortest text that gives the same float32."""
    if isinstance(value, np.integer):
        return str(value)
    return f"{np.float32(value)!s}f"
