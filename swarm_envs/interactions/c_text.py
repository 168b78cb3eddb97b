"""C99 source as text: numbers, arrays and comments for the templates in `c_templates/`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib import resources

import numpy as np
import numpy.typing as npt

__all__ = [
    "array_definition",
    "array_rows",
    "check_prefix",
    "comment_lines",
    "fill_templates",
    "literal",
    "type_enumeration",
]

_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
_NUMBERS_A_LINE = 7


def check_prefix(name: str) -> None:
    """Raise ValueError for a name that cannot begin an identifier."""
    if not _PREFIX.fullmatch(name):
        raise ValueError(
            f"name is {name!r}, but must be a letter and up to 30 letters, digits or underscores"
        )


def fill_templates(names: Iterable[str], words: Mapping[str, str]) -> str:
    """Return the concatenated templates, with their @words@ replaced once.

    Args:
        names: names of files in `c_templates/`.
        words: replacements by word.
    """
    folder = resources.files("swarm_envs.interactions").joinpath("c_templates")
    text = "".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    return re.sub(r"@(\w+)@", lambda found: words[found[1]], text)


def comment_lines(lines: Iterable[str]) -> str:
    """Return lines of a block comment, in which comment marks are broken up."""
    return "\n".join(" *   " + line.replace("*/", "* /").replace("/*", "/ *") for line in lines)


def type_enumeration(prefix: str, types: tuple[str, ...], taken: tuple[str, ...]) -> str:
    """Return the constants of an enumeration of vehicle types, and their number.

    Names begin with the prefix and are those of the types, unless two would be equal or one is in
    `taken`, the names of other definitions.
    """
    names = [re.sub(r"\W", "_", kind, flags=re.ASCII) for kind in types]
    if len({*names, *taken}) < len(names) + len(taken):
        names = [f"TYPE_{k}" for k in range(len(names))]
    rows = [f"    {prefix}_{name} = {k}," for k, name in enumerate(names)]
    return "\n".join([*rows, f"    {prefix}_TYPES = {len(types)}"])


def array_definition(name: str, values: npt.ArrayLike) -> str:
    """Return the definition of a constant float32 array of one or two dimensions."""
    numbers = np.asarray(values)
    if numbers.ndim == 1:
        return f"static const float {name}[] = {{\n{_literals(numbers)}}};"
    return f"static const float {name}[][{numbers.shape[1]}] = {{\n{array_rows(numbers)}}};"


def array_rows(numbers: npt.NDArray[np.generic]) -> str:
    """Return the initializers of the rows of a two-dimensional array."""
    return ",\n".join(f"    {{{_literals(row).lstrip()}}}" for row in numbers)


def _literals(numbers: npt.NDArray[np.generic]) -> str:
    words = [literal(number) for number in numbers]
    starts = range(0, len(words), _NUMBERS_A_LINE)
    return ",\n".join(f"    {', '.join(words[k : k + _NUMBERS_A_LINE])}" for k in starts)


def literal(value: float | np.generic) -> str:
    """Return the literal of an integer, or the shortest one of a float32."""
    if isinstance(value, np.integer):
        return str(value)
    return f"{np.float32(value)!s}f"
