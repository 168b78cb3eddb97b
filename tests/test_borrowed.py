"""Named tuples that kernels borrow: from each other, and from Python by `lend`."""

from __future__ import annotations

import gc
from typing import Any, NamedTuple, cast

import numba
import numpy as np
import numpy.typing as npt
import pytest
from numba.core.caching import NullCache

from swarm_envs.borrowed import Borrowed, lend
from swarm_envs.compiled import borrowing_kernel, entry_point, kernel


class Inner(NamedTuple):
    """Flags side by side, and arrays of several kinds and dimensions."""

    first: bool
    second: bool
    table: npt.NDArray[np.float32]
    number: int
    cube: npt.NDArray[np.float64]
    third: bool


class Outer(NamedTuple):
    """A tuple in a tuple, between numbers."""

    scale: float
    inner: Inner
    marks: npt.NDArray[np.bool_]
    last: bool
    out: npt.NDArray[np.int64]


def outer(seed: int = 0) -> Outer:
    rng = np.random.default_rng(seed)
    first, second, third, last = (bool(b) for b in rng.integers(2, size=4))
    cube = rng.normal(size=(2, 3, 4))
    cube.flags.writeable = False
    table = rng.normal(size=(3, 5)).astype(np.float32)
    inner = Inner(first, second, table, int(rng.integers(9)), cube, third)
    marks = rng.integers(2, size=6).astype(np.bool_)
    return Outer(float(rng.normal()), inner, marks, last, np.zeros(4, np.int64))


@borrowing_kernel
def flags(inner: Inner) -> int:
    return 1 * inner.first + 2 * inner.second + 4 * inner.third + 8 * inner.number


@borrowing_kernel
def total(k: int, given: Outer) -> float:
    sum_ = given.scale * flags(given.inner) + 1000.0 * given.last
    for row in range(given.inner.table.shape[0]):
        sum_ += given.inner.table[row, k] * given.inner.cube[1, row, k] * (1 + given.marks[row])
    given.out[k] += 1
    return sum_


def plain(k: int, given: Outer) -> float:
    inner = given.inner
    products = inner.table[:, k] * inner.cube[1, :, k] * (1 + given.marks[:3])
    coded = inner.first + 2 * inner.second + 4 * inner.third + 8 * inner.number
    return float(given.scale * coded + 1000.0 * given.last + products.sum())


@pytest.mark.parametrize("seed", range(8))
def test_a_lent_tuple_reads_as_the_tuple_and_its_arrays_are_written(seed: int) -> None:
    given = outer(seed)
    lent = lend(given)
    entry = entry_point(total, 0, lent)
    for k in range(4):
        expected = pytest.approx(plain(k, given), rel=1e-12)
        assert total(k, given) == total(k, lent) == entry(k, lent) == expected
    assert given.out.tolist() == [3] * 4


def test_what_is_lent_stays_alive() -> None:
    lent, expected = lend(outer(3)), plain(2, outer(3))
    gc.collect()
    noise = [np.full(100, 7.0) for _ in range(1000)]  # over whatever has been freed
    assert total(2, lent) == pytest.approx(expected, rel=1e-12)
    assert len(noise) == 1000


def test_where_nothing_is_compiled_the_tuple_stands_for_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = outer()
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)
    assert lend(given) is given


@kernel
def twice(inner: Inner) -> tuple[int, int]:
    k, sum_ = 0, 0
    while k < 2:
        sum_ += pick(inner, k)
        k += 1
    return sum_, pick(inner, 7)


@borrowing_kernel
def pick(inner: Inner, k: int) -> int:
    return inner.number + k


def test_a_kernel_is_compiled_once_for_its_callers_and_borrows() -> None:
    """Constants are integers as others are; the tuple is one argument."""
    inner, whole = outer(5).inner, cast(Any, twice)
    whole._cache = NullCache()  # what is read from the disk has no parts
    assert twice(inner) == (2 * inner.number + 1, inner.number + 7)
    part: Any = pick
    (found,) = part.get_overload.__self__.overloads
    assert [type(kind) for kind in found] == [Borrowed, numba.types.Integer]


def test_an_unknown_field_is_refused() -> None:
    @kernel
    def wrong(inner: Inner) -> int:
        return missing(inner)

    @borrowing_kernel
    def missing(inner: Inner) -> int:
        return inner.nothing  # type: ignore[attr-defined]

    with pytest.raises(numba.core.errors.TypingError, match="nothing"):
        wrong(outer().inner)
