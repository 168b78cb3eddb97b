"""Plans as linear functions of few variables, and the solver of their quadratic programs.

Each axis is a triple integrator with 15 jerks. Two of them are fixed by the rest at the end (13e),
and the last is zero, as in the public simulation. The other twelve are scaled so that the quadratic
part of the cost is half their squared length. DAQP thus solves min |y|^2 / 2 + slope . y subject to
matrix @ y >= bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.state import BoolArray, FloatArray

__all__ = ["solve_qp"]


@dataclass(frozen=True, eq=False)
class _Affine:
    """An affine function of one axis: `start` @ (its first state) + `free` @ (its variables z)."""

    start: FloatArray  # (K, 3) by position, velocity and acceleration at the start
    free: FloatArray  # (K, n) by the variables

    def at(self, state: FloatArray, z: FloatArray) -> FloatArray:
        """Return values (K, 3) at a state (3, 3), rows by derivative, and variables (n, 3)."""
        return self.start @ state + self.free @ z


@dataclass(frozen=True, eq=False)
class Condensed:
    """The part of the optimization (13) that depends on the parameters alone.

    The cost of an axis is |z|^2 / 2 + (gradient @ offset) z, where offset is the first state minus
    the target's position.
    """

    positions: _Affine  # At the collision samples, m
    bounded: _Affine
    """The bounded quantities: position, velocity and acceleration at the state samples, jerks."""
    jerks: _Affine  # Of each interval, m/s^3
    jerks_inverse: FloatArray  # (n, h_s) variables by jerks that end at rest
    gradient: FloatArray  # (n, 3) slope of the cost at z = 0
    lower: FloatArray  # (B, 3) lower bounds of the bounded quantities
    upper: FloatArray  # (B, 3) upper bounds of the bounded quantities
    rest_by_state: FloatArray  # (2, 3) velocity and acceleration at the end, by the first state
    rest_by_jerk: FloatArray  # (2, h_s) likewise, by the jerks
    collision_times: FloatArray  # (S,) of the collision samples since the start, s
    state_times: FloatArray  # (h_b,) of the state samples since the start, s


def _derivatives(times: FloatArray, num_inputs: int, step: float) -> tuple[FloatArray, FloatArray]:
    """Return derivatives of one axis' state by its first state (3, T, 3) and jerks (3, T, h_s).

    The state is position, velocity and acceleration at times (T,) since the start, s; each of the
    h_s jerks lasts a step, s.
    """
    since = np.maximum(times[:, None] - step * np.arange(num_inputs + 1), 0.0)
    by_jerk = np.stack([-np.diff(since**p, axis=1) / f for p, f in ((3, 6.0), (2, 2.0), (1, 1.0))])
    one, zero = np.ones_like(times), np.zeros_like(times)
    rows = [(one, times, times**2 / 2), (zero, one, times), (zero, zero, one)]
    return np.stack([np.stack(row, axis=1) for row in rows]), by_jerk


@lru_cache(maxsize=8)
def condensed(config: MlrDmpcConfig) -> Condensed:
    """Return the condensed program of a configuration."""
    knots = _instants(config.input_sampling_s, config.num_inputs)
    inputs = _resting_inputs(config)
    states = _affine(knots, inputs, config)
    weight = (config.path_weight, config.velocity_weight, config.acceleration_weight)
    terms = [(2.0 * w, part) for w, part in zip(weight, states, strict=True)]
    end = _Affine(states[0].start[-1:], states[0].free[-1:])
    terms += [(2.0 * config.position_weight, end), (2.0 * config.jerk_weight, inputs)]
    hessian = sum(w * part.free.T @ part.free for w, part in terms)
    slope = sum(w * part.free.T @ part.start for w, part in terms)
    scale = np.linalg.inv(np.linalg.cholesky(np.asarray(hessian)))
    jerks = _Affine(inputs.start, inputs.free @ scale.T)
    return _assembled(config, jerks, scale @ np.asarray(slope))


def _assembled(config: MlrDmpcConfig, jerks: _Affine, gradient: FloatArray) -> Condensed:
    collision = _instants(config.collision_sampling_s, config.num_samples)
    sampled = _instants(config.state_sampling_s, config.num_states)
    parts = [*_affine(sampled, jerks, config), jerks]
    limits = (config.speed_limit, config.acceleration_limit, config.jerk_limit)
    lower = [config.box[0], *((-limit,) * 3 for limit in limits)]
    upper = [config.box[1], *((limit,) * 3 for limit in limits)]
    counts = [len(part.start) for part in parts]
    by_state, by_jerk = _end(config)
    return Condensed(
        positions=_affine(collision, jerks, config)[0],
        bounded=_Affine(
            np.concatenate([part.start for part in parts]),
            np.concatenate([part.free for part in parts]),
        ),
        jerks=jerks,
        jerks_inverse=np.asarray(np.linalg.pinv(jerks.free), dtype=np.float64),
        gradient=gradient,
        lower=np.repeat(np.array(lower), counts, axis=0),
        upper=np.repeat(np.array(upper), counts, axis=0),
        rest_by_state=by_state[1:, 0],
        rest_by_jerk=by_jerk[1:, 0],
        collision_times=collision,
        state_times=sampled,
    )


def _affine(times: FloatArray, jerks: _Affine, config: MlrDmpcConfig) -> list[_Affine]:
    """Return position, velocity and acceleration at times (T,), as affine functions."""
    by_state, by_jerk = _derivatives(times, config.num_inputs, config.input_sampling_s)
    return [
        _Affine(s + j @ jerks.start, j @ jerks.free) for s, j in zip(by_state, by_jerk, strict=True)
    ]


def _resting_inputs(config: MlrDmpcConfig) -> _Affine:
    """Return jerks that end at rest: the least-norm ones plus a basis of the null space."""
    by_state, by_jerk = _end(config)
    last = np.eye(config.num_inputs)[-1:]
    rest = np.concatenate([by_jerk[1], by_jerk[2], last])
    needed = np.concatenate([by_state[1], by_state[2], np.zeros((1, 3))])
    # The last right singular vectors span the null space.
    base = np.linalg.svd(rest)[2][len(rest) :].T
    return _Affine(-np.linalg.pinv(rest) @ needed, base)


def _end(config: MlrDmpcConfig) -> tuple[FloatArray, FloatArray]:
    end = np.array([config.num_inputs * config.input_sampling_s])
    return _derivatives(end, config.num_inputs, config.input_sampling_s)


def _instants(step: float, count: int) -> FloatArray:
    """Return (count,) step, 2 step, ..."""
    return np.arange(1, count + 1, dtype=np.float64) * step


_TOLERANCE = 1e-8


class QpSolution(NamedTuple):
    """The result of DAQP."""

    y: FloatArray  # (n,) the minimum, if there is one
    active: BoolArray  # (m,) True for rows that hold with equality, to warm-start the next program
    solved: bool  # True if a minimum was found, to the solver's tolerance


def solve_qp(
    slope: FloatArray, matrix: FloatArray, bound: FloatArray, active: BoolArray
) -> QpSolution:
    """Return the minimum of |y|^2 / 2 + slope . y subject to matrix @ y >= bound, by DAQP.

    Args:
        slope: (n,) the linear term.
        matrix: (m, n) the rows.
        bound: (m,) their lower bounds.
        active: (m,) True for rows to try first as equalities.
    """
    import daqp

    sense = active.astype(np.int32)
    y, _, flag, info = daqp.solve(
        _identity(len(slope)), slope, -matrix, -bound, sense=sense, primal_tol=_TOLERANCE
    )
    return QpSolution(y, np.asarray(info["lam"]) != 0.0, flag == 1)


@cache
def _identity(size: int) -> FloatArray:
    return np.eye(size)
