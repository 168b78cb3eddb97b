"""Messages of exceptions: the value that was given, the rule it broke, and the fix."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Integral

import numpy as np
import numpy.typing as npt

__all__ = ["check_array", "check_integer", "check_name", "unknown_name"]


def unknown_name(kind: str, name: object, valid: Iterable[str], where: str = "") -> str:
    """Message for a name that is not among the valid ones, with the nearest of them.

    Args:
        kind: what is named, such as `"action"`.
        name: what was given.
        valid: every name that would do.
        where: where it was given, appended to the first clause.
    """
    names = sorted(valid)
    written = {each.lower(): each for each in names}
    near = difflib.get_close_matches(str(name).lower(), written, n=1)
    place = f" {where}" if where else ""
    hint = f"did you mean {written[near[0]]!r}? " if near else ""
    return f"unknown {kind} {name!r}{place}; {hint}valid: {', '.join(map(repr, names))}"


def check_name(kind: str, name: object, valid: Iterable[str]) -> str:
    """Return `name` if it is among the valid ones.

    Raises:
        ValueError: it is not; the message names the nearest valid one.
    """
    names = tuple(valid)
    if not isinstance(name, str) or name not in names:
        raise ValueError(unknown_name(kind, name, names))
    return name


def check_integer(name: str, value: object, least: int, most: int | None = None) -> int:
    """Return `value` as an int if it is an integer, of Python or numpy, in this range.

    Raises:
        ValueError: it is not; booleans are not integers here.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, Integral) or value < least:
        raise ValueError(f"{name} is {value!r:.80}, but must be an integer of at least {least}")
    if most is not None and int(value) > most:
        raise ValueError(f"{name} is {value!r:.80}, but must be at most {most:,}")
    return int(value)


def check_array(
    name: str, value: npt.ArrayLike, shape: tuple[int, ...], rule: str = ""
) -> npt.NDArray[np.float64]:
    """Return `value` as a finite, contiguous float64 array of exactly the given shape.

    Raises:
        ValueError: it is no array of numbers, the shape is another, or an entry is NaN or infinite;
            the message names the value, the rule and where it was broken.
    """
    extra = f" ({rule})" if rule else ""
    try:
        array = np.asarray(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} is {value!r:.80}, but must be numbers of shape {shape}{extra}"
        ) from error
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, but must have shape {shape}{extra}")
    if np.count_nonzero(np.isfinite(array)) < array.size:
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(
            f"{name} is {array[index]} at index {index}; every entry must be a finite number"
        )
    return array
