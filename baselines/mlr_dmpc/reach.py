"""Where a drone can be within the horizon, and which rows therefore cannot bind.

Every plan that satisfies (13b)-(13e) lies in the boxes [low, high] of `reach` at the samples:

- The acceleration a of an axis is linear between knots, dt apart, so the jerk j gives
  a[k+1] <= a[k] + dt j_high forward, a[k] <= a[k+1] - dt j_low backward from a = 0 at the end, and
  its own bound holds at the state samples.
- v[k+1] = v[k] + dt (a[k] + a[k+1]) / 2 grows with both accelerations, so their bounds bound it
  forward, and backward from v = 0 at the end; its own bound holds at the state samples.
- At a time tau <= dt past a knot, with j = (a[k+1] - a[k]) / dt, p = p[k] + tau v[k] +
  (tau^2 / 2 - tau^3 / (6 dt)) a[k] + tau^3 / (6 dt) a[k+1]: every factor is non-negative, so again
  bounds bound it, forward and backward from the box.

A half-space normal . p >= offset that holds at the worst corner of the box thus holds for every
plan: it cannot bind, and leaving it out changes nothing. The plane of eq. (15) lies between the
plan p0 that is flown and the known trajectory q of the other, its normal within an angle alpha of
Theta^-1 (p0 - q). So it holds for every q with |Theta^-1 (q - p0)| cos alpha >= d + r (d + 2 r if
the other may be planned anew), where r is the largest |Theta^-1 (p - p0)| of p in the box: whoever
cannot come within reach costs no row. Each candidate of a drone has its own rows; each is tested.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray

_SLOP = 1e-6


def reach(
    state: FloatArray, lower: FloatArray, upper: FloatArray, config: MlrDmpcConfig
) -> tuple[FloatArray, FloatArray]:
    """Boxes (S, 3), lower and upper corners, that hold a drone at the collision samples, m.

    Args:
        state: (3, 3) position, velocity and acceleration at the start.
        lower: (3 h_b + h_s, 3) bounds: position, velocity, acceleration at state samples, jerk.
        upper: likewise.
        config: times.
    """
    steps = (config.input_sampling_s, config.state_sampling_s, config.collision_sampling_s)
    counts = (config.num_inputs, config.num_states, config.num_samples)
    high = _highest(state, lower, upper, steps, counts)
    low = -_highest(-state, -upper, -lower, steps, counts)
    return low - _SLOP, high + _SLOP


@kernel
def out_of_reach(
    low: FloatArray, high: FloatArray, normals: FloatArray, offsets: FloatArray
) -> BoolArray:
    """(R, S) whether normal . p >= offset for all p of the box (S, 3) at that sample."""
    out: BoolArray = np.empty(offsets.shape, dtype=np.bool_)
    for r in range(offsets.shape[0]):
        for s in range(offsets.shape[1]):
            least = 0.0
            for i in range(3):
                normal = normals[r, s, i]
                least += normal * (low[s, i] if normal > 0.0 else high[s, i])
            out[r, s] = least >= offsets[r, s]
    return out


@kernel
def _highest(
    state: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    steps: tuple[float, float, float],
    counts: tuple[int, int, int],
) -> FloatArray:
    """(S, 3) upper corners of `reach`; for the lower ones, everything is mirrored."""
    dt, inputs, states = steps[0], counts[0], counts[1]
    p = np.full((inputs + 1, 3), np.inf)
    v, a = p.copy(), p.copy()
    v_low, a_low = -p, -p
    p[0], v[0], a[0], v_low[0], a_low[0] = state[0], state[1], state[2], state[1], state[2]
    for b in range(states):
        knot = round((b + 1) * steps[1] / dt)
        if abs(knot * dt - (b + 1) * steps[1]) < 1e-9:
            p[knot] = upper[b]
            v[knot], v_low[knot] = upper[states + b], lower[states + b]
            a[knot], a_low[knot] = upper[2 * states + b], lower[2 * states + b]
    v[inputs], v_low[inputs], a[inputs], a_low[inputs] = 0.0, 0.0, 0.0, 0.0
    jerk, jerk_low = upper[3 * states :], lower[3 * states :]
    for i in range(3):
        for k in range(inputs):
            a[k + 1, i] = min(a[k + 1, i], a[k, i] + dt * jerk[k, i])
            a_low[k + 1, i] = max(a_low[k + 1, i], a_low[k, i] + dt * jerk_low[k, i])
        for k in range(inputs - 1, -1, -1):
            a[k, i] = min(a[k, i], a[k + 1, i] - dt * jerk_low[k, i])
            a_low[k, i] = max(a_low[k, i], a_low[k + 1, i] - dt * jerk[k, i])
        for k in range(inputs):
            gain, loss = dt * (a[k, i] + a[k + 1, i]) / 2, dt * (a_low[k, i] + a_low[k + 1, i]) / 2
            v[k + 1, i] = min(v[k + 1, i], v[k, i] + gain)
            v_low[k + 1, i] = max(v_low[k + 1, i], v_low[k, i] + loss)
        for k in range(inputs - 1, -1, -1):
            gain, loss = dt * (a[k, i] + a[k + 1, i]) / 2, dt * (a_low[k, i] + a_low[k + 1, i]) / 2
            v[k, i] = min(v[k, i], v[k + 1, i] - loss)
            v_low[k, i] = max(v_low[k, i], v_low[k + 1, i] - gain)
        for k in range(inputs):
            way = dt * (v[k, i] + dt * (a[k, i] / 3 + a[k + 1, i] / 6))
            p[k + 1, i] = min(p[k + 1, i], p[k, i] + way)
        for k in range(inputs - 1, -1, -1):
            way = dt * (v_low[k, i] + dt * (a_low[k, i] / 3 + a_low[k + 1, i] / 6))
            p[k, i] = min(p[k, i], p[k + 1, i] - way)
    return _between(p, v, a, dt, steps[2], counts[2])


@kernel
def _between(
    p: FloatArray, v: FloatArray, a: FloatArray, dt: float, sampling: float, samples: int
) -> FloatArray:
    """(S, 3) highest positions at the collision samples, by highest knots."""
    out = np.empty((samples, 3))
    for s in range(samples):
        time = (s + 1) * sampling
        k = min(int(time / dt + 1e-9), p.shape[0] - 2)
        tau = time - k * dt
        end = tau**3 / (6 * dt)
        for i in range(3):
            out[s, i] = p[k, i] + tau * v[k, i] + (tau**2 / 2 - end) * a[k, i] + end * a[k + 1, i]
    return out
