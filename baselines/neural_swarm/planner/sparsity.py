"""A sparse constraint matrix whose pattern is fixed once and whose values change."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray, IntArray


class ConstraintPattern:
    """Rows l <= A z <= u, added in named groups; then values and bounds are set by name.

    Rows that are never given bounds, or infinite ones, bind nothing.
    """

    def __init__(self) -> None:
        self.rows: dict[str, slice] = {}
        """The rows of each group."""
        self._count = 0
        self._parts: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._blocks: dict[str, tuple[slice, tuple[int, ...]]] = {}
        self._filled = 0

    def add_rows(self, name: str, *shape: int) -> IntArray:
        """Add a group of rows; returns their indices, of the given shape."""
        count = int(np.prod(shape))
        self.rows[name] = slice(self._count, self._count + count)
        self._count += count
        return np.arange(self._count - count, self._count).reshape(shape)

    def put(
        self, rows: IntArray, columns: npt.ArrayLike, value: npt.ArrayLike, name: str = ""
    ) -> None:
        """Put entries where rows and columns, broadcast, meet; a name lets `set` change them."""
        r, c, v = np.broadcast_arrays(rows, columns, np.asarray(value, dtype=np.float64))
        if name:
            self._blocks[name] = (slice(self._filled, self._filled + r.size), r.shape)
        self._filled += r.size
        self._parts.append((r.ravel(), np.asarray(c).ravel(), v.ravel()))

    def finish(self, variables: int) -> None:
        """Fix the pattern, for so many variables; nothing can be added afterwards."""
        from scipy.sparse import csc_matrix

        rows, columns, values = (np.concatenate(part) for part in zip(*self._parts))
        order = np.lexsort((rows, columns))
        self._values, self._order = values, order
        start = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=variables))])
        shape = (self._count, variables)
        self.matrix: Any = csc_matrix((values[order], rows[order], start), shape=shape)
        self.lower = np.full(self._count, -np.inf)
        self.upper = np.full(self._count, np.inf)

    def set(self, name: str, value: npt.ArrayLike) -> None:
        """Set the entries that were put under a name."""
        where, shape = self._blocks[name]
        self._values[where] = np.broadcast_to(value, shape).ravel()

    def bound(self, name: str, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None:
        """Set the bounds of a group of rows; arrays of the group's shape, or one number."""
        where = self.rows[name]
        self.lower[where], self.upper[where] = np.ravel(lower), np.ravel(upper)

    def update(self) -> Any:
        """The matrix, (rows, variables), with the present values."""
        self.matrix.data[:] = self._values[self._order]
        return self.matrix
