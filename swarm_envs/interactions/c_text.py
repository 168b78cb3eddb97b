"""C99 source as text: numbers, arrays and comments, filled into the templates of `c_templates/`."""

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
    """Refuse what cannot begin an identifier.

    Raises:
        ValueError: naming it.
    """
    if not _PREFIX.fullmatch(name):
        raise ValueError(
            f"name is {name!r}, but must be a letter and up to 30 letters, digits or underscores"
        )


def fill_templates(names: Iterable[str], words: Mapping[str, str]) -> str:
    """The text of templates, one after another, with their @words@ replaced.

    Args:
        names: of files in `c_templates/`.
        words: by name; what replaces a word is not searched for further words.
    """
    folder = resources.files("swarm_envs.interactions").joinpath("c_templates")
    text = "".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    return re.sub(r"@(\w+)@", lambda found: words[found[1]], text)


def comment_lines(lines: Iterable[str]) -> str:
    """Lines of a block comment, which they cannot end."""
    return "\n".join(" *   " + line.replace("*/", "* /").replace("/*", "/ *") for line in lines)


def type_enumeration(prefix: str, types: tuple[str, ...], taken: tuple[str, ...]) -> str:
    """Constants of types of vehicles, under their names as far as C takes them, and their number.

    Each begins with the prefix; `taken` are names after it that mean something else.
    """
    names = [re.sub(r"\W", "_", kind, flags=re.ASCII) for kind in types]
    if len({*names, *taken}) < len(names) + len(taken):
        names = [f"TYPE_{k}" for k in range(len(names))]
    rows = [f"    {prefix}_{name} = {k}," for k, name in enumerate(names)]
    return "\n".join([*rows, f"    {prefix}_TYPES = {len(types)}"])


def array_definition(name: str, values: npt.ArrayLike) -> str:
    """Definition of a constant array of float32, of one dimension or two."""
    numbers = np.asarray(values)
    if numbers.ndim == 1:
        return f"static const float {name}[] = {{\n{_literals(numbers)}}};"
    return f"static const float {name}[][{numbers.shape[1]}] = {{\n{array_rows(numbers)}}};"


def array_rows(numbers: npt.NDArray[np.generic]) -> str:
    """Initialisers of the rows of an array of two dimensions."""
    return ",\n".join(f"    {{{_literals(row).lstrip()}}}" for row in numbers)


def _literals(numbers: npt.NDArray[np.generic]) -> str:
    words = [literal(number) for number in numbers]
    starts = range(0, len(words), _NUMBERS_A_LINE)
    return ",\n".join(f"    {', '.join(words[k : k + _NUMBERS_A_LINE])}" for k in starts)


def literal(value: float | np.generic) -> str:
    """An integer, or the shortest text that gives the same float32."""
    if isinstance(value, np.integer):
        return str(value)
    return f"{np.float32(value)!s}f"
