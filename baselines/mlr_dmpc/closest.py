"""How close two references come at any time, not only at samples: by the roots of a polynomial."""

from __future__ import annotations

import numpy as np

from swarm_envs.state import FloatArray

_PARTS = 8


def closest_distances(
    states: FloatArray, jerks: FloatArray, duration_s: float, shrink: FloatArray
) -> FloatArray:
    """Least scaled distance (N, N) of each pair over all intervals, inf on the diagonal, m.

    Within an interval of constant jerk the squared distance is a polynomial of degree six; it is
    least at an end or at a root of its derivative.

    Args:
        states: (R, N, 3, 3) position, velocity and acceleration at the start of each interval; NaN
            for who is not in the air.
        jerks: (R, N, 3) m/s^3.
        duration_s: of an interval.
        shrink: (3,) diagonal of the inverse of Theta.
    """
    count = states.shape[1]
    out = np.full((count, count), np.inf)
    scaled = np.concatenate([states, jerks[:, :, None]], axis=2) * shrink
    factors = np.array([1.0, 1.0, 0.5, 1.0 / 6.0])[:, None]
    powers = np.linspace(0.0, duration_s, _PARTS + 1)[:, None] ** np.arange(4)
    for i in range(count - 1):
        terms = (scaled[:, i + 1 :] - scaled[:, i, None]) * factors
        points = np.einsum("tk,rjkx->rjtx", powers, terms)
        sampled = np.sqrt((points * points).sum(axis=-1)).min(axis=-1)
        sampled = np.where(np.isnan(sampled), np.inf, sampled)
        lengths = np.linalg.norm(terms, axis=-1)
        speed = lengths[..., 1:] @ (np.arange(1, 4) * duration_s ** np.arange(3))
        bound = sampled - speed * duration_s / (2 * _PARTS)
        best = sampled.min(axis=0)
        for r, k in np.argwhere(bound < best):
            if bound[r, k] < best[k]:
                best[k] = min(best[k], _least(terms[r, k], duration_s))
        out[i, i + 1 :] = out[i + 1 :, i] = best
    return out


def _least(terms: FloatArray, duration_s: float) -> float:
    """Least length of a cubic curve with coefficients (4, 3) over an interval from 0."""
    square = np.sum([np.convolve(terms[:, x], terms[:, x]) for x in range(3)], axis=0)
    slope = square[1:] * np.arange(1, 7)
    size = np.abs(slope).max(initial=0.0)
    slope[np.abs(slope) < 1e-14 * size] = 0.0
    roots = np.roots(slope[::-1])
    real = roots.real[np.abs(roots.imag) < 1e-6]
    times = np.concatenate([[0.0, duration_s], np.clip(real, 0.0, duration_s)])
    points = (times[:, None] ** np.arange(4)) @ terms
    return float(np.sqrt((points * points).sum(axis=1).min()))
