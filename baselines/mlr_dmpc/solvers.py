"""Solvers of the small quadratic programs: DAQP, and two more to check it by.

All solve min |y|^2 / 2 + slope . y with matrix @ y >= bound.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.state import BoolArray, FloatArray

SOLVERS = ("daqp", "quadprog", "osqp")
"""Names of the solvers."""
_OSQP_TOLERANCE = 1e-6
_TOLERANCE = 1e-8


class Solution(NamedTuple):
    """What a solver found."""

    y: FloatArray
    """(n,) the minimum, if there is one."""
    active: BoolArray
    """(m,) rows that hold with equality, to start the next program from."""
    solved: bool
    """Whether there is a minimum, to the solver's tolerance."""
    iterations: int
    """Steps that the solver took."""


Solver = Callable[[FloatArray, FloatArray, FloatArray, BoolArray], Solution]
"""Called with slope (n,), matrix (m, n), bound (m,) and the rows (m,) to try as active first."""


def solver(name: str) -> Solver:
    """A solver by its name.

    Raises:
        ValueError: there is no such solver; the message names the nearest.
        ImportError: it is not installed; the message says how to install it.
    """
    return _SOLVERS[check_name("solver", name, SOLVERS)]


def _daqp(slope: FloatArray, matrix: FloatArray, bound: FloatArray, active: BoolArray) -> Solution:
    sense = active.astype(np.int32)
    y, _, flag, info = _module("daqp").solve(
        _identity(len(slope)), slope, -matrix, -bound, sense=sense, primal_tol=_TOLERANCE
    )
    return Solution(y, np.asarray(info["lam"]) != 0.0, flag == 1, info["iterations"])


def _quadprog(
    slope: FloatArray, matrix: FloatArray, bound: FloatArray, active: BoolArray
) -> Solution:
    if not len(bound):  # it wants one row at least
        return Solution(-slope, active, True, 0)
    try:
        y, _, _, iterations, multiplier, _ = _module("quadprog").solve_qp(
            np.array(_identity(len(slope))), -slope, matrix.T.copy(), bound
        )
    except ValueError:  # how it says that no point satisfies every row
        return Solution(np.zeros_like(slope), active, False, 0)
    return Solution(y, multiplier > 0.0, True, int(iterations[0]))


def _osqp(slope: FloatArray, matrix: FloatArray, bound: FloatArray, active: BoolArray) -> Solution:
    from scipy import sparse

    program: Any = _module("osqp").OSQP()
    program.setup(
        sparse.identity(len(slope), format="csc"),
        slope,
        sparse.csc_matrix(matrix),
        bound,
        np.full(len(bound), np.inf),
        verbose=False,
        eps_abs=_OSQP_TOLERANCE,
        eps_rel=_OSQP_TOLERANCE,
        max_iter=100_000,
        polishing=True,
    )
    done = program.solve(raise_error=False)
    solved = done.info.status == "solved"
    y = np.asarray(done.x, dtype=np.float64) if solved else np.zeros_like(slope)
    return Solution(y, active, solved, int(done.info.iter))


@cache
def _identity(size: int) -> FloatArray:
    return np.eye(size)


@cache
def _module(name: str) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"solver {name!r} needs the package {name}: pip install {name}"
        ) from error


_SOLVERS: dict[str, Solver] = {"daqp": _daqp, "quadprog": _quadprog, "osqp": _osqp}
