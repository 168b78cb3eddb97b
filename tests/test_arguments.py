"""Arguments of another kind than annotated are refused by name; all others go through untouched."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pytest

from swarm_envs.arguments import Range, WrongKind, kind_of, typed
from swarm_envs.state import FloatArray

if TYPE_CHECKING:
    from nowhere import Unknown  # type: ignore[import-not-found]


@typed
def job(
    count: int = 0,
    share: float | None = None,
    name: str = "",
    mode: Literal["a", "b"] = "a",
    yes: bool = True,
    path: Path = Path(),
    sizes: tuple[float, float] = (0.0, 1.0),
    names: tuple[str, ...] = (),
    shape: Sequence[int] = (),
    points: npt.ArrayLike = 0.0,
    array: FloatArray | None = None,
    weights: Mapping[str, float] | None = None,
    watch: Callable[[str], None] | None = None,
    unknown: Unknown = None,
    **others: Any,
) -> dict[str, Any]:
    return locals()


GOOD: list[dict[str, Any]] = [
    {"count": 3},
    {"count": np.int64(3), "share": np.float32(0.5)},
    {"share": 1, "names": ["a"], "sizes": [1, 2.5]},
    {"share": float("nan")},
    {"mode": "b", "yes": np.bool_(False), "shape": np.array([3, 4])},
    {"points": [[0, 1], [2, 3]], "array": np.zeros(3), "weights": {"a": 1.0}},
    {"watch": print, "unknown": object(), "whatever": None, "share": None},
]
BAD: list[tuple[str, Any, str]] = [
    ("count", True, "an integer"),
    ("count", 1.0, "an integer"),
    ("count", "1", "an integer"),
    ("share", "0.5", "a number or None"),
    ("share", 1j, "a number or None"),
    ("name", None, "text"),
    ("mode", 1, "'a' or 'b'"),
    ("yes", 1, "True or False"),
    ("path", "here", "a pathlib.Path"),
    ("sizes", (1.0,), "a tuple: a number, a number"),
    ("names", "abc", "a sequence, each text"),
    ("names", ("a", 1), "a sequence, each text"),
    ("shape", 3, "a sequence, each an integer"),
    ("points", "abc", "an array of numbers"),
    ("points", [[1.0], [1.0, 2.0]], "an array of numbers"),
    ("array", [None], "an array of numbers or None"),
    ("weights", [("a", 1.0)], "a mapping or None"),
    ("watch", "print", "a function or None"),
]


@pytest.mark.parametrize("given", GOOD)
def test_what_fits_goes_through(given):
    found = job(**given)
    assert all(found[name] is value for name, value in given.items() if name in found)


@pytest.mark.parametrize(("name", "value", "words"), BAD)
def test_what_does_not_fit_is_named_with_its_value(name, value, words):
    with pytest.raises(WrongKind) as error:
        job(**{name: value})
    assert str(error.value) == f"{name} is {value!r:.80}, but must be {words}"
    assert isinstance(error.value, TypeError) and isinstance(error.value, ValueError)


def test_text_that_is_none_of_those_that_may_be_is_told_the_nearest():
    with pytest.raises(WrongKind, match=r"unknown mode 'c'; .*valid: 'a', 'b'"):
        job(mode="c")  # type: ignore[arg-type]


def test_arguments_by_place_are_looked_at_too():
    with pytest.raises(WrongKind, match="share is 'x'"):
        job(1, "x")  # type: ignore[arg-type]


def test_what_goes_by_name_alone_is_not_taken_by_place():
    @typed
    def named(*, first: int = 0) -> int:
        return first

    with pytest.raises(TypeError, match="takes 0 positional arguments but 1 was given"):
        named(1)  # type: ignore[call-arg]


@typed
@dataclass(frozen=True)
class Settings:
    size: float
    name: str = "a"


def test_a_class_stays_what_it_was():
    one = Settings(2, name="b")
    assert one == pickle.loads(pickle.dumps(one))  # noqa: S301  # our own
    assert [f.name for f in fields(Settings)] == ["size", "name"]
    assert list(inspect.signature(Settings).parameters) == ["size", "name"]
    with pytest.raises(WrongKind, match="size is None, but must be a number"):
        Settings(None)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'size'"):
        Settings()  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (Range(), "a finite number"),
        (Range(0.0), "finite and not negative"),
        (Range(1.0, unit="m"), "a finite number of at least 1, in m"),
        (Range(-2.5, above=True), "a finite number above -2.5"),
        (Range(-1.0, 2.0, below=True), "a number in [-1, 2)"),
    ],
)
def test_a_range_names_its_ends(rule, words):
    assert kind_of(Annotated[float, rule]).words == words


def test_integers_beyond_every_float_are_refused_or_taken_without_overflow():
    huge = 10**400
    number, integer = kind_of(Annotated[float, Range(0.0)]), kind_of(Annotated[int, Range(0)])
    assert not number.fits(huge) and number.fits(10**300)
    assert integer.fits(huge)
