"""Row generation: of thousands of rows, only those that a plan would break enter the program."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray


class Rows(NamedTuple):
    """Every row of a program, as what it bounds; those that are in the program, or need not be."""

    base: FloatArray
    """(S, 3) positions at the collision samples for variables of zero, m."""
    by_variables: FloatArray
    """(S, n) positions of an axis by its variables."""
    normals: FloatArray
    """(R, S, 3) of half-spaces."""
    offsets: FloatArray
    """(R, S) least normal . p, m."""
    done: BoolArray
    """(R, S) half-spaces in the program, or out of reach."""
    soft_offsets: FloatArray
    """(C,) least normal . p at the last sample with the soft margin wide open, m."""
    soft_scales: FloatArray
    """(C,) by how much a unit of its soft variable closes a margin, m; 0 if it has none."""
    soft_done: BoolArray
    """(C,) soft rows in the program, or out of reach."""
    bounded_base: FloatArray
    """(B, 3) bounded quantities for variables of zero."""
    bounded_by_variables: FloatArray
    """(B, n) bounded quantities of an axis by its variables."""
    lower: FloatArray
    """(B, 3) least bounded quantities."""
    upper: FloatArray
    """(B, 3) largest bounded quantities."""
    bounds_done: BoolArray
    """(2, B, 3) bounds in the program, lower and upper."""


class Working(NamedTuple):
    """The rows in the program: matrix @ z + scale * (soft variable of the row) >= bound."""

    matrix: FloatArray
    """(m, 3 n)."""
    bound: FloatArray
    """(m,)."""
    scale: FloatArray
    """(m,) 0 for a row without soft variable."""
    source: IntArray
    """(m,) the half-space that a soft row stems from, else -1."""


@kernel
def broken_rows(rows: Rows, z: FloatArray, threshold: float, stride: int) -> Working:
    """Rows not yet done with slack below a threshold, m, at variables z (n, 3), now done.

    Of each trajectory's half-spaces only every `stride`-th, the most broken among them: others
    close in time seldom bind then.
    """
    free = z.shape[0]
    picked = _pick(rows, z, threshold, stride)
    count = picked.shape[0]
    matrix, bound = np.zeros((count, 3 * free)), np.empty(count)
    scale, source = np.zeros(count), np.full(count, -1)
    for m in range(count):
        kind, r, s = picked[m]
        if kind < 2:
            sign = 1.0 if kind == 0 else -1.0
            limit = rows.lower[r, s] if kind == 0 else rows.upper[r, s]
            bound[m] = sign * (limit - rows.bounded_base[r, s])
            for k in range(free):
                matrix[m, s * free + k] = sign * rows.bounded_by_variables[r, k]
            continue
        bound[m] = rows.offsets[r, s]
        if kind == 3:
            bound[m], scale[m], source[m] = rows.soft_offsets[r], rows.soft_scales[r], r
        for i in range(3):
            bound[m] -= rows.normals[r, s, i] * rows.base[s, i]
            for k in range(free):
                matrix[m, i * free + k] = rows.normals[r, s, i] * rows.by_variables[s, k]
    return Working(matrix, bound, scale, source)


@kernel
def _pick(rows: Rows, z: FloatArray, threshold: float, stride: int) -> IntArray:
    """(m, 3) kind (lower, upper, half-space, soft), row and sample or axis of what is broken."""
    most = rows.bounds_done.size + rows.done.size + rows.soft_done.size
    picked, count = np.empty((most, 3), np.int64), 0
    bounded = rows.bounded_base + rows.bounded_by_variables @ z
    for r in range(bounded.shape[0]):
        for i in range(3):
            slacks = (bounded[r, i] - rows.lower[r, i], rows.upper[r, i] - bounded[r, i])
            for kind in range(2):
                if slacks[kind] < threshold and not rows.bounds_done[kind, r, i]:
                    rows.bounds_done[kind, r, i] = True
                    picked[count] = kind, r, i
                    count += 1
    position = rows.base + rows.by_variables @ z
    last = position.shape[0] - 1
    for r in range(rows.normals.shape[0]):
        worst, at = threshold, -1
        for s in range(last + 1):
            if not rows.done[r, s]:
                slack = _along(rows.normals, position, r, s) - rows.offsets[r, s]
                if slack < worst:
                    worst, at = slack, s
        for s in range(at % stride if at >= 0 else last + 1, last + 1, stride):
            slack = _along(rows.normals, position, r, s) - rows.offsets[r, s]
            if slack < threshold and not rows.done[r, s]:
                rows.done[r, s] = True
                picked[count] = 2, r, s
                count += 1
        soft = r < rows.soft_done.shape[0] and not rows.soft_done[r]
        if soft and _along(rows.normals, position, r, last) - rows.soft_offsets[r] < threshold:
            rows.soft_done[r] = True
            picked[count] = 3, r, last
            count += 1
    return picked[:count]


@kernel
def least_slack(positions: FloatArray, normals: FloatArray, offsets: FloatArray) -> float:
    """Least of normal . p - offset over all half-spaces, m; infinite if there are none."""
    least = math.inf
    for r in range(normals.shape[0]):
        for s in range(normals.shape[1]):
            along = -offsets[r, s]
            for i in range(3):
                along += normals[r, s, i] * positions[s, i]
            least = min(least, along)
    return least


@kernel
def _along(normals: FloatArray, positions: FloatArray, r: int, s: int) -> float:
    """Normal . p of half-space r at sample s."""
    return (
        normals[r, s, 0] * positions[s, 0]
        + normals[r, s, 1] * positions[s, 1]
        + normals[r, s, 2] * positions[s, 2]
    )
