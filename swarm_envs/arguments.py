"""Options declared once: an annotation says what an argument may be, `typed` refuses others.

    @typed
    @dataclass(frozen=True)
    class Layout:
        radius_m: Annotated[float, POSITIVE_M] = 1.5
        '''Radius of the circle.'''

Type, range and unit are read from the annotation, and the sentence from the docstring below: by the
constructor that refuses bad values, and by `options_of` for the documentation and the tests.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import math
import os
import sys
import textwrap
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import unknown_name

__all__ = [
    "FINITE",
    "NOT_NEGATIVE",
    "POSITIVE",
    "POSITIVE_M",
    "POSITIVE_S",
    "Count",
    "Divides",
    "Interval",
    "NotEmpty",
    "OneOf",
    "Option",
    "Range",
    "Seed",
    "check_value",
    "options_of",
    "parse_pairs",
    "typed",
    "typed_options",
]

Target = TypeVar("Target", bound=Callable[..., Any])


class WrongKind(TypeError, ValueError):
    """An argument is of another kind than its annotation; checks of values raise ValueError."""


class Kind(NamedTuple):
    """What an annotation asks for."""

    words: str  # Such as "an integer"
    fits: Callable[[Any], bool]  # Whether a value is of this kind
    names: tuple[str, ...] = ()  # What text it may be, where only some
    typed: Callable[[Any], bool] | None = None
    """Whether a value has the right type, whatever its size; None: if it fits."""

    def has_type(self, value: object) -> bool:
        """Whether a value has the right type, whatever its size."""
        return (self.typed or self.fits)(value)


@dataclass(frozen=True)
class Range:
    """A finite number between two ends, which belong to the range unless said otherwise."""

    least: float = -math.inf
    """The lower end."""
    most: float = math.inf
    """The upper end."""
    above: bool = False
    """Whether the lower end is left out."""
    below: bool = False
    """Whether the upper end is left out."""
    unit: str = ""
    """Unit of the number; empty if it has none."""

    def restrict(self, kind: Kind) -> Kind:
        """Numbers of a kind in this range."""
        integer = kind.fits(0) and not kind.fits(0.5)
        words = self._of_integers() if integer else self._of_numbers()
        most = math.inf if integer else sys.float_info.max  # else it becomes a float

        def fits(value: Any) -> bool:
            return kind.fits(value) and self.holds(value) and abs(value) <= most

        return Kind(words, fits, (), kind.has_type)

    def holds(self, value: float) -> bool:
        """Whether a number lies in the range."""
        low = value > self.least if self.above else value >= self.least
        high = value < self.most if self.below else value <= self.most
        return bool(low and high and abs(value) < math.inf)  # an integer may pass any float

    def _of_integers(self) -> str:
        upper = "" if self.most == math.inf else f" and at most {self.most:,}"
        return f"an integer of at least {self.least}{upper}"

    def _of_numbers(self) -> str:
        unit = f", in {self.unit}" if self.unit else ""
        if self.most < math.inf:
            left, right = "(" if self.above else "[", ")" if self.below else "]"
            return f"a number in {left}{self.least:g}, {self.most:g}{right}{unit}"
        if self.least == 0.0:
            return ("positive and finite" if self.above else "finite and not negative") + unit
        lower = f" {'above' if self.above else 'of at least'} {self.least:g}"
        return f"a finite number{lower if self.least > -math.inf else ''}{unit}"


@dataclass(frozen=True)
class Interval:
    """Two finite numbers (low, high) with low <= high, between which something is drawn."""

    within: Range = Range(0.0, above=True)
    """Where both must lie."""

    def restrict(self, kind: Kind) -> Kind:
        """Pairs that are such an interval."""
        least, most = self.within.least, self.within.most
        lower = f"{least:g} {'<' if self.within.above else '<='} " if least > -math.inf else ""
        upper = f" <= {most:g}" if most < math.inf else ""
        unit = f", in {self.within.unit}" if self.within.unit else ""
        words = f"(low, high) with {lower}low <= high{upper}{unit}"
        return Kind(words, lambda v: kind.fits(v) and self.holds(v), (), kind.has_type)

    def holds(self, ends: Sequence[float]) -> bool:
        """Whether two numbers are such an interval."""
        return all(map(self.within.holds, ends)) and ends[0] <= ends[1]


class NotEmpty:
    """A sequence that holds something."""

    def restrict(self, kind: Kind) -> Kind:
        """Sequences of a kind with one element or more."""
        words = f"{kind.words}, and not empty"
        return Kind(words, lambda v: kind.fits(v) and len(v) > 0, (), kind.has_type)


@dataclass(frozen=True)
class OneOf:
    """One of some names."""

    names: tuple[str, ...]
    """The names."""

    def restrict(self, kind: Kind) -> Kind:
        """These names alone."""
        return _one_of(self.names)._replace(typed=kind.fits)


@dataclass(frozen=True)
class Divides:
    """An integer that divides another."""

    whole: int
    """What is divided."""

    def restrict(self, kind: Kind) -> Kind:
        """Integers that divide the whole."""
        some = [self.whole // k for k in (1, 2, 5, 10, 24)]
        words = f"{self.whole} over an integer, such as {', '.join(map(str, some[:-1]))}"
        return Kind(
            f"{words} or {some[-1]}",
            lambda v: kind.fits(v) and v > 0 and self.whole % v == 0,
            (),
            kind.has_type,
        )


POSITIVE, POSITIVE_M, POSITIVE_S = (Range(0.0, above=True, unit=unit) for unit in ("", "m", "s"))
"""A positive number; one of metres; one of seconds."""
FINITE = Range()
"""A finite number."""
NOT_NEGATIVE = Range(0.0)
"""A number that is zero or positive."""
Count = Annotated[int, Range(1)]
"""How many, at least one."""
Seed = Annotated[int, Range(0)]
"""What random numbers are drawn from."""


def typed(target: Target, owner: str | None = None) -> Target:
    """Have a function, or a class's constructor, refuse arguments that its annotations exclude.

    Python does not check annotations, and a wrong type would raise an unclear error somewhere
    inside. NumPy numbers are accepted as numbers, booleans are not. Ranges in `Annotated` are
    checked; NaN, shapes and the contents of mappings are not.

    Args:
        target: the function or class.
        owner: what messages put before the name of an argument; None: the class's name and a dot,
            nothing for a function. After `--`, names are written as on the command line.

    Raises:
        WrongKind: by what is returned, naming the argument, its value and what it must be.
        ValueError: likewise, if only the size of a value is wrong.
        TypeError: likewise, if there is no such argument; the message names the nearest.
    """
    if not inspect.isclass(target):
        return cast(Target, _guarded(target, owner or "", lambda: _of_function(target)))
    kind: Any = target
    prefix = f"{target.__name__}." if owner is None else owner
    kind.__init__ = _guarded(kind.__init__, prefix, lambda: _of_class(kind))
    return target


typed_options = functools.partial(typed, owner="")
"""`typed` for a class whose fields users know as arguments of a function."""


def _guarded(
    function: Callable[..., Any], owner: str, read: Callable[[], dict[str, Kind]]
) -> Callable[..., Any]:
    parameters = inspect.signature(function).parameters
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    names = [name for name in parameters if name != "self"]
    by_place = [name for name, p in parameters.items() if p.kind is not p.KEYWORD_ONLY]
    kinds = functools.cache(read)  # at the first call, when whatever annotations name is defined

    @functools.wraps(function)
    def checked(*args: Any, **options: Any) -> Any:
        wanted = kinds()
        for name, value in (*zip(by_place, args), *options.items()):
            if name in wanted:
                _check(owner, name, value, wanted[name])
            elif name not in parameters and not open_ended:
                raise TypeError(unknown_name("option", name, names))
        return function(*args, **options)

    return checked


def _check(owner: str, name: str, value: object, kind: Kind) -> None:
    if kind.fits(value):
        return
    label, rule = name, kind.words
    if owner.startswith("--"):  # what is not given is None
        label, rule = name.replace("_", "-"), rule.removesuffix(" or None").removesuffix(",")
    if isinstance(value, str) and kind.names:
        message = unknown_name(label, value, kind.names)
    else:
        message = f"{owner}{label} is {value!r:.80}, but must be {rule}"
    raise ValueError(message) if kind.has_type(value) else WrongKind(message)


def parse_pairs(name: str, text: str, example: str) -> list[tuple[str, list[float]]]:
    """Names and numbers of an option's text, such as `mass=0.9:1.1,gust_acceleration=1`.

    Raises:
        ValueError: a part of it is no name with numbers; the message gives the example.
    """
    try:
        parts = [part.split("=") for part in text.split(",")]
        return [(key.strip(), [float(n) for n in numbers.split(":")]) for key, numbers in parts]
    except ValueError as error:
        rule = f"must be names with numbers, such as {example}"
        raise ValueError(f"{name} is {text!r:.80}, but {rule}") from error


def check_value(name: str, value: object, annotation: Any) -> None:
    """Refuse a value that an annotation excludes: what `typed` does with an argument.

    Raises:
        WrongKind: naming the value and what it must be.
        ValueError: likewise, if only its size is wrong.
    """
    _check("", name, value, kind_of(annotation))


def _of_function(function: Callable[..., Any]) -> dict[str, Kind]:
    space = vars(sys.modules[function.__module__])
    parameters = inspect.signature(function).parameters
    return {
        name: kind_of(_meaning(p.annotation, space))
        for name, p in parameters.items()
        if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    }


def _of_class(owner: type) -> dict[str, Kind]:
    """What a constructor takes, each annotation read where its class stands."""
    if not dataclasses.is_dataclass(owner):
        kinds = _of_function(cast(Any, owner).__init__)
        return {name: kind for name, kind in kinds.items() if name != "self"}
    found = {}
    for base in reversed(owner.__mro__):
        space = vars(sys.modules[base.__module__])
        for name, annotation in inspect.get_annotations(base).items():
            found[name] = (annotation, space)
    fields = [field.name for field in dataclasses.fields(owner) if field.init]
    return {name: kind_of(_meaning(*found[name])) for name in fields}


class Option(NamedTuple):
    """One option of a class of settings."""

    name: str
    """Its name."""
    kind: Kind
    """What it may be."""
    default: Any
    """Its value if it is not given; `dataclasses.MISSING` if it must be."""
    meaning: str
    """What it is, in a sentence."""


def options_of(settings: type) -> dict[str, Option]:
    """The fields of a dataclass: their rules, and the docstrings below them, by name.

    Meanings are empty where the source is not there.
    """
    kinds, meanings = _of_class(settings), field_docstrings(settings)
    found = {}
    for field in dataclasses.fields(settings):
        made = field.default_factory
        default = field.default if made is dataclasses.MISSING else made()
        meaning = meanings.get(field.name, "")
        found[field.name] = Option(field.name, kinds[field.name], default, meaning)
    return found


def field_docstrings(settings: type) -> dict[str, str]:
    """The docstring below each field of a dataclass on one line, its base classes' included."""
    found: dict[str, str] = {}
    for base in reversed(settings.__mro__):
        if dataclasses.is_dataclass(base):
            found |= _own_docstrings(base)
    return found


@functools.cache
def _own_docstrings(settings: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(settings))
    except OSError:
        return {}
    body = cast(ast.ClassDef, ast.parse(source).body[0]).body
    return {
        ast.unparse(node.target): " ".join(ast.literal_eval(after.value).split())
        for node, after in itertools.pairwise(body)
        if isinstance(node, ast.AnnAssign) and isinstance(after, ast.Expr)
    }


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
        return _any_of([kind_of(part) for part in inner])
    if origin is Annotated:
        rules = [rule for rule in inner[1:] if hasattr(rule, "restrict")]
        return functools.reduce(lambda kind, rule: rule.restrict(kind), rules, kind_of(inner[0]))
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
    plain = inspect.isclass(annotation) and not typing.is_typeddict(annotation)
    if not plain or annotation is object or getattr(annotation, "_is_protocol", False):
        return ANYTHING
    return Kind(f"a {annotation.__name__}", lambda value: isinstance(value, annotation))


def _any_of(parts: Sequence[Kind]) -> Kind:
    joint = ", or " if any("," in part.words for part in parts) else " or "
    return Kind(
        joint.join(part.words for part in parts),
        lambda value: any(part.fits(value) for part in parts),
        tuple(name for part in parts for name in part.names),
        lambda value: any(part.has_type(value) for part in parts),
    )


def _one_of(names: Sequence[Any]) -> Kind:
    return Kind(
        " or ".join(map(repr, names)),
        lambda value: any(type(value) is type(name) and value == name for name in names),
        tuple(name for name in names if isinstance(name, str)),
    )


def _tuple_of(inner: Sequence[Any]) -> Kind:
    if len(inner) == 2 and inner[1] is Ellipsis:
        return _many_of(kind_of(inner[0]), (tuple, list))
    kinds = [kind_of(part) for part in inner]
    words = f"a tuple: {', '.join(kind.words for kind in kinds)}"
    if any(kind.typed for kind in kinds):
        words = f"a tuple of {len(kinds)} values, each {kinds[0].words}"
    return Kind(
        words,
        lambda value: (
            isinstance(value, tuple | list)
            and len(value) == len(kinds)
            and all(kind.fits(part) for kind, part in zip(kinds, value))
        ),
    )


def _many_of(kind: Kind, holders: tuple[type, ...]) -> Kind:
    return Kind(
        f"a sequence, each {kind.words}",
        lambda value: (
            isinstance(value, holders)
            and not isinstance(value, str | bytes)
            and all(map(kind.fits, cast(Iterable[Any], value)))
        ),
    )


def _is(kind: type, value: object) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool | np.bool_)


def _is_numbers(value: object) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):  # rows of different lengths
        return False


ANYTHING = Kind("anything", lambda value: True)
"""What an annotation asks for that says nothing here."""
_SIMPLE: Mapping[Any, Kind] = {
    Any: ANYTHING,
    int: Kind("an integer", functools.partial(_is, Integral)),
    float: Kind("a number", functools.partial(_is, Real)),
    bool: Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: Kind("text", lambda value: isinstance(value, str)),
    Path: Kind("a pathlib.Path", lambda value: isinstance(value, Path)),
    type(None): Kind("None", lambda value: value is None),
    np.random.Generator: Kind(
        "a numpy Generator", lambda value: isinstance(value, np.random.Generator)
    ),
}
