"""Arguments of the wrong kind, refused by name before anything is computed: `typed`."""

from __future__ import annotations

import functools
import inspect
import os
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import unknown_name

Target = TypeVar("Target", bound=Callable[..., Any])


class WrongKind(TypeError, ValueError):
    """An argument is of another kind than its annotation.

    A ValueError too, since checks of values raise that for the same mistake.
    """


class Kind(NamedTuple):
    """What an annotation asks for."""

    words: str
    """Such as "an integer"."""
    fits: Callable[[Any], bool]
    """Whether a value is of this kind."""
    names: tuple[str, ...] = ()
    """What text it may be, where only some."""


def typed(target: Target) -> Target:
    """Have a function, or a class's constructor, refuse arguments of another kind than annotated.

    Python does not look at annotations: text in place of a number is found out somewhere inside, in
    words that name nobody. Here numpy's numbers are numbers, and booleans are none. Signs, ranges,
    shapes, NaN, and what is in mappings are left to the function.

    Raises:
        WrongKind: by what is returned, naming the argument, its value and what it must be.
    """
    if not inspect.isclass(target):
        return cast(Target, _guarded(target, target.__module__))
    kind: Any = target
    kind.__init__ = _guarded(kind.__init__, kind.__module__)
    return target


def _guarded(function: Callable[..., Any], module: str) -> Callable[..., Any]:
    parameters = inspect.signature(function).parameters
    named = {n: p for n, p in parameters.items() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}

    @functools.cache
    def kinds() -> dict[str, Kind]:
        """Read at the first call, when whatever the annotations name is defined."""
        space = vars(sys.modules[module])
        return {n: kind_of(_meaning(p.annotation, space)) for n, p in named.items()}

    @functools.wraps(function)
    def checked(*args: Any, **options: Any) -> Any:
        wanted = kinds()
        for name, value in (*zip(parameters, args), *options.items()):
            if name in wanted and not wanted[name].fits(value):
                raise WrongKind(_refusal(name, value, wanted[name]))
        return function(*args, **options)

    return checked


def _refusal(name: str, value: object, kind: Kind) -> str:
    if isinstance(value, str) and kind.names:
        return unknown_name(name, value, kind.names)
    return f"{name} is {value!r:.80}, but must be {kind.words}"


def _meaning(annotation: Any, space: dict[str, Any]) -> Any:
    """What an annotation names; Any if there is none, or one for type checkers alone."""
    if annotation is inspect.Parameter.empty:
        return Any
    if not isinstance(annotation, str):
        return annotation
    try:  # numpy's ArrayLike is a long union, text among it: arrays of numbers are meant
        plain = annotation.replace("npt.ArrayLike", "_Numbers")
        return eval(plain, {**space, "_Numbers": npt.NDArray[Any]})
    except (NameError, AttributeError, TypeError):
        return Any


def kind_of(annotation: Any) -> Kind:
    """The kind of value that an annotation means; one that all fit if it cannot be told."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation in _SIMPLE:
        return _SIMPLE[annotation]
    if origin in (Union, types.UnionType):
        parts = [kind_of(part) for part in inner]
        return Kind(
            " or ".join(part.words for part in parts),
            lambda value: any(part.fits(value) for part in parts),
            tuple(name for part in parts for name in part.names),
        )
    if origin is Annotated:
        return kind_of(inner[0])
    if origin is Literal:
        return _one_of(inner)
    if origin is np.ndarray:
        return Kind("an array of numbers", _is_numbers)
    if origin is os.PathLike:
        return Kind("a path", lambda value: isinstance(value, os.PathLike))
    if origin is tuple:
        return _tuple_of(inner)
    if origin in (list, Sequence):
        return _many_of(kind_of(inner[0]), (Sequence, np.ndarray))
    if inspect.isclass(origin) and issubclass(origin, Mapping):
        return Kind("a mapping", lambda value: isinstance(value, Mapping))
    if origin is Callable or annotation is Callable:
        return Kind("a function", callable)
    return _class(annotation)


def _class(kind: Any) -> Kind:
    if not inspect.isclass(kind) or kind is object or typing.is_typeddict(kind):
        return ANYTHING
    if getattr(kind, "_is_protocol", False):
        return ANYTHING
    return Kind(f"a {kind.__name__}", lambda value: isinstance(value, kind))


def _one_of(names: Sequence[Any]) -> Kind:
    return Kind(
        " or ".join(map(repr, names)),
        lambda value: any(type(value) is type(name) and value == name for name in names),
        tuple(name for name in names if isinstance(name, str)),
    )


def _all_fit(kinds: Iterable[Kind], values: Iterable[Any]) -> bool:
    return all(kind.fits(value) for kind, value in zip(kinds, values))


def _tuple_of(inner: Sequence[Any]) -> Kind:
    if len(inner) == 2 and inner[1] is Ellipsis:
        return _many_of(kind_of(inner[0]), (tuple, list))
    kinds = [kind_of(part) for part in inner]
    return Kind(
        f"a tuple: {', '.join(kind.words for kind in kinds)}",
        lambda value: (
            isinstance(value, tuple | list) and len(value) == len(kinds) and _all_fit(kinds, value)
        ),
    )


def _each_fits(kind: Kind, values: Iterable[Any]) -> bool:
    return all(map(kind.fits, values))


def _many_of(kind: Kind, holders: tuple[type, ...]) -> Kind:
    return Kind(
        f"a sequence, each {kind.words}",
        lambda value: (
            isinstance(value, holders)
            and not isinstance(value, str | bytes)
            and _each_fits(kind, cast(Iterable[Any], value))
        ),
    )


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def _is_integer(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool | np.bool_)


def _is_numbers(value: object) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):  # rows of different lengths
        return False


ANYTHING = Kind("anything", lambda value: True)
"""What an annotation asks for that says nothing here."""
_SIMPLE: Mapping[Any, Kind] = {
    Any: ANYTHING,
    int: Kind("an integer", _is_integer),
    float: Kind("a number", _is_number),
    bool: Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: Kind("text", lambda value: isinstance(value, str)),
    Path: Kind("a pathlib.Path", lambda value: isinstance(value, Path)),
    type(None): Kind("None", lambda value: value is None),
    np.random.Generator: Kind(
        "a numpy Generator", lambda value: isinstance(value, np.random.Generator)
    ),
}
