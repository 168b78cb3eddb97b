"""Checks of options and arguments: messages name the value, the rule it broke, and the fix."""

from __future__ import annotations

import difflib
import inspect
import math
import typing
from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any, cast

import numpy as np
import numpy.typing as npt

__all__ = [
    "as_numbers",
    "check_array",
    "check_bool",
    "check_divisor",
    "check_integer",
    "check_interval",
    "check_name",
    "check_number",
    "check_numbers",
    "check_parameters",
    "check_type",
    "nearest",
    "parse_pairs",
    "unknown_name",
]


def unknown_name(kind: str, name: object, valid: Iterable[str], where: str = "") -> str:
    """Return the message for an invalid name, with the valid names and the most similar of them.

    Args:
        kind: the kind of name, such as `"action"`.
        name: the invalid name.
        valid: every valid name.
        where: the context of the name, appended to the first clause.
    """
    context = f" {where}" if where else ""
    return f"unknown {kind} {name!r}{context}; {nearest(name, valid)}"


def nearest(name: object, valid: Iterable[str]) -> str:
    """Return the hint of an error message: the most similar valid name, if any, and all of them."""
    names = sorted(valid)
    written = {each.lower(): each for each in names}
    near = difflib.get_close_matches(str(name).lower(), written, n=1)
    hint = f"did you mean {written[near[0]]!r}? " if near else ""
    return f"{hint}valid: {', '.join(map(repr, names))}"


def check_name(kind: str, name: object, valid: Iterable[str]) -> str:
    """Return `name` if it is among the valid ones.

    Raises:
        ValueError: it is not; the message names the most similar valid one.
    """
    names = tuple(valid)
    if not isinstance(name, str) or name not in names:
        raise ValueError(unknown_name(kind, name, names))
    return name


def check_integer(
    name: str, value: object, at_least: int | None = None, at_most: int | None = None
) -> int:
    """Return `value` as an int if it is an integer, of Python or NumPy, in this range.

    Raises:
        ValueError: it is not; booleans are not integers here.
    """
    low = -math.inf if at_least is None else at_least
    high = math.inf if at_most is None else at_most
    if _is_a(Integral, value) and low <= cast(int, value) <= high:
        return int(cast(int, value))
    bounds = [] if at_least is None else [f"of at least {at_least}"]
    bounds += [] if at_most is None else [f"at most {at_most:,}"]
    raise ValueError(_refusal(name, value, " ".join(["an integer", " and ".join(bounds)]).strip()))


def check_number(
    name: str,
    value: object,
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
    below: float | None = None,
    unit: str = "",
) -> None:
    """Raise ValueError unless `value` is a finite number in a range; booleans are no numbers.

    Args:
        name: the name of the option or argument.
        value: its value.
        at_least: the least number that is allowed.
        above: the exclusive lower bound.
        at_most: the greatest number that is allowed.
        below: the exclusive upper bound.
        unit: the unit, for the message.
    """
    if not _in_range(value, at_least, above, at_most, below):
        rule = _range_in_words(at_least, above, at_most, below)
        raise ValueError(_refusal(name, value, rule + (f", in {unit}" if unit else "")))


def check_interval(
    name: str,
    value: object,
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
    unit: str = "",
) -> None:
    """Raise ValueError unless `value` is `(low, high)`, two finite ascending numbers in a range."""
    pair: Any = value if isinstance(value, tuple | list) and len(value) == 2 else None
    inside = pair and all(_in_range(end, at_least, above, at_most, None) for end in pair)
    if inside and pair[0] <= pair[1]:
        return
    lower = "" if above is None else f"{above:g} < "
    lower = lower if at_least is None else f"{at_least:g} <= "
    upper = "" if at_most is None else f" <= {at_most:g}"
    rule = f"(low, high) with {lower}low <= high{upper}"
    raise ValueError(_refusal(name, value, rule + (f", in {unit}" if unit else "")))


def check_numbers(
    name: str,
    value: object,
    count: int,
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
) -> None:
    """Raise ValueError unless `value` is a tuple or list of `count` finite numbers in a range."""
    if (
        not isinstance(value, tuple | list)
        or len(value) != count
        or not all(_in_range(each, at_least, above, at_most, None) for each in value)
    ):
        rule = _range_in_words(at_least, above, at_most, None)
        raise ValueError(_refusal(name, value, f"a tuple of {count} numbers, each {rule}"))


def check_bool(name: str, value: object) -> None:
    """Raise ValueError unless `value` is True or False, of Python or NumPy."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(_refusal(name, value, "True or False"))


def check_divisor(name: str, value: object, whole: int) -> None:
    """Raise ValueError unless `value` is a positive divisor of `whole`."""
    if _is_a(Integral, value) and cast(int, value) > 0 and whole % cast(int, value) == 0:
        return
    some = ", ".join(str(whole // k) for k in (1, 2, 5, 10))
    rule = f"{whole} over an integer, such as {some} or {whole // 24}"
    raise ValueError(_refusal(name, value, rule))


def check_type(name: str, value: object, kind: Any) -> None:
    """Raise ValueError unless `value` has the type `kind`, such as `Hall | str | None`."""
    if not isinstance(value, kind):
        kinds = typing.get_args(kind) or (kind,)
        words = [f"{'an' if k.__name__[0] in 'AEIOU' else 'a'} {k.__name__}" for k in kinds]
        raise ValueError(_refusal(name, value, " or ".join(words).replace("a NoneType", "None")))


def _refusal(name: str, value: object, rule: str) -> str:
    return f"{name} is {value!r:.80}, but must be {rule}"


def _is_a(kind: type, value: object) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool | np.bool_)


def _in_range(
    value: Any,
    at_least: float | None,
    above: float | None,
    at_most: float | None,
    below: float | None,
) -> bool:
    """Return True if a value is a finite number in a range."""
    try:
        number = float(value) if _is_a(Real, value) else math.nan
    except OverflowError:  # an integer that no float holds
        return False
    return (
        math.isfinite(number)
        and (at_least is None or number >= at_least)
        and (above is None or number > above)
        and (at_most is None or number <= at_most)
        and (below is None or number < below)
    )


def _range_in_words(
    at_least: float | None, above: float | None, at_most: float | None, below: float | None
) -> str:
    high = below if at_most is None else at_most
    low = above if at_least is None else at_least
    if high is not None:
        left = "(-inf" if low is None else f"{'(' if at_least is None else '['}{low:g}"
        return f"a number in {left}, {high:g}{')' if at_most is None else ']'}"
    if low == 0.0:
        return "positive and finite" if at_least is None else "finite and not negative"
    if low is None:
        return "a finite number"
    return f"a finite number {'above' if at_least is None else 'of at least'} {low:g}"


def parse_pairs(name: str, text: str, example: str) -> list[tuple[str, list[float]]]:
    """Return the names and numbers of a text such as `mass=0.9:1.1,gust_acceleration=1`.

    Raises:
        ValueError: a part of it is not a name with numbers; the message gives the example.
    """
    try:
        parts = [part.split("=") for part in text.split(",")]
        return [(key.strip(), [float(n) for n in numbers.split(":")]) for key, numbers in parts]
    except ValueError as error:
        rule = f"must be names with numbers, such as {example}"
        raise ValueError(f"{name} is {text!r:.80}, but {rule}") from error


def as_numbers(
    name: str, value: npt.ArrayLike, rule: str = "an array of numbers"
) -> npt.NDArray[np.float64]:
    """Return `value` as a contiguous float64 array of any shape.

    Raises:
        ValueError: it is not numeric, such as a string, or rows of different lengths.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ValueError(_refusal(name, value, rule)) from error
    if array.dtype.kind not in "biuf":  # booleans, integers, numbers
        raise ValueError(_refusal(name, value, rule))
    return np.asarray(array, dtype=np.float64, order="C")


def check_array(
    name: str, value: npt.ArrayLike, shape: tuple[int, ...], rule: str = ""
) -> npt.NDArray[np.float64]:
    """Return `value` as a finite, contiguous float64 array of exactly the given shape.

    Raises:
        ValueError: it is no array of numbers, has another shape, or has an entry that is NaN or
            infinite; the message names the value, the rule and the index.
    """
    extra = f" ({rule})" if rule else ""
    array = as_numbers(name, value, f"numbers of shape {shape}{extra}")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, but must have shape {shape}{extra}")
    if np.count_nonzero(np.isfinite(array)) < array.size:
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(
            f"{name} is {array[index]} at index {index}; every entry must be a finite number"
        )
    return array


def check_parameters(name: str, function: Callable[..., Any], *parameters: str) -> None:
    """Raise ValueError if a function cannot be called with these arguments, named for messages.

    Other callables are not checked: what they accept may differ from their signature.
    """
    if not inspect.isroutine(function):
        return
    try:
        inspect.signature(function, follow_wrapped=False).bind(*parameters)
    except TypeError as error:
        raise ValueError(
            f"{name} must be a function of {', '.join(parameters)}, but its signature differs: "
            f"{error}"
        ) from error
    except ValueError:  # a function in C, which has no signature
        return
