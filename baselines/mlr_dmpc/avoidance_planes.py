"""Half-spaces that a plan keeps to: buffered Voronoi planes between drones, planes of obstacles.

Obstacles (boxes and columns) are convex. The plane through the nearest point of one, across the way
to it, has all of it behind; a plan that stays `margin` before the plane stays that far off the
obstacle. The present plan, `margin` off or more at every sample, satisfies its own planes: as for
other drones, it stays feasible when it is shifted (Theorem T1, planes in place of trajectories).

Of obstacles nothing is checked between samples: at speed v a drone moves v T_c / 2 from the nearer
one, so the margin should contain that in addition to the drone's radius, or T_c be finer.

Half-spaces out of reach within the horizon are left out. Every plan that satisfies (13b)-(13e) lies
in the boxes of `reachable_boxes` at the samples:

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
the other may be replanned), where r is the largest |Theta^-1 (p - p0)| of p in the box: a
drone that cannot come within reach costs no row. Each candidate of a drone has its own rows; each
is tested.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.condensed_qp import condensed
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.compiled import kernel
from swarm_envs.physics.contact import nearest_point
from swarm_envs.state import BoolArray, FloatArray, IntArray

SPARE_M = 2e-6
"""Rows keep this much more than the distance, m: what tolerances may take from a pair."""
ROW_MARGIN = 1e-5  # Rows are built for this much more again, m: room for the solver's tolerance


class Neighbors(NamedTuple):
    """Every candidate trajectory of every other drone, at the collision samples of a plan."""

    positions: FloatArray  # (C, S, 3) at t + T_c, t + 2 T_c, ... for a plan that starts at t, m.
    drone: IntArray  # (C,) whose trajectory it is
    concurrent: BoolArray  # (C,) whether that drone may be replanned in the same round

    def some(self, kept: BoolArray | IntArray) -> Neighbors:
        """Those of a mask (C,) or of indices."""
        return Neighbors(self.positions[kept], self.drone[kept], self.concurrent[kept])


class HalfSpaces(NamedTuple):
    """Half-spaces normal . p >= offset that hold at one collision sample each."""

    normals: FloatArray  # (P, S, 3), unit free
    offsets: FloatArray  # (P, S), m


def voronoi_planes(own: FloatArray, neighbors: Neighbors, config: MlrDmpcConfig) -> HalfSpaces:
    """Half-spaces (C, S) (15) between a drone's plan (S, 3), m, and the trajectories of others.

    A drone that may be replanned gives half of the gap, one that is not gives all of it. Normals
    are divided by Theta: they are for points in metres.

    Planes are turned about the vertical by up to `turn_rad`, so that each drone has more room on
    its right: the weights of Appendix B alone leave two drones that meet head on where they are.
    Any unit normal proves Lemma L3. For Corollary 1 of the paper both drones need one plane: the
    turn depends on the gap alone, which is the same for both, and so is its sense. For Theorem T1
    the present plan must satisfy its rows: along the turned normal the gap stays above the distance
    kept, since the turn is at most `turn_share` of where it would not.
    """
    return HalfSpaces(
        *_voronoi_planes(
            own,
            neighbors.positions,
            neighbors.concurrent,
            config.inverse_scaling,
            config.sampled_distance_m + SPARE_M,
            config.turn_rad,
            config.turn_share,
        )
    )


@kernel
def _voronoi_planes(
    own: FloatArray,
    others: FloatArray,
    concurrent: BoolArray,
    shrink: FloatArray,
    distance: float,
    turn: float,
    turn_share: float,
) -> tuple[FloatArray, FloatArray]:
    count, samples = others.shape[:2]
    normals, offsets = np.empty((count, samples, 3)), np.empty((count, samples))
    for c in range(count):
        for s in range(samples):
            square = 0.0
            for i in range(3):
                normals[c, s, i] = shrink[i] * (own[s, i] - others[c, s, i])
                square += normals[c, s, i] ** 2
            gap = max(np.sqrt(square), 1e-12)
            for i in range(3):
                normals[c, s, i] /= gap
            if turn > 0.0:
                _turn(normals[c, s], min(distance / gap, 1.0), turn, turn_share)
            offset = distance
            if concurrent[c]:
                offset *= 0.5
                for i in range(3):
                    offset += 0.5 * normals[c, s, i] * shrink[i] * (own[s, i] - others[c, s, i])
            for i in range(3):
                normals[c, s, i] *= shrink[i]
                offset += normals[c, s, i] * others[c, s, i]
            offsets[c, s] = offset
    return normals, offsets


@kernel
def _turn(normal: FloatArray, least_gap: float, turn: float, share: float) -> None:
    """Turn a unit normal (3,) about the vertical; `least_gap` of the gap must be left along it."""
    level = normal[0] ** 2 + normal[1] ** 2
    least = (least_gap - normal[2] ** 2) / max(level, 1e-12)
    angle = min(turn, share * math.acos(max(min(least, 1.0), -1.0)))
    x, y = normal[0], normal[1]
    normal[0] = math.cos(angle) * x - math.sin(angle) * y
    normal[1] = math.sin(angle) * x + math.cos(angle) * y


def obstacle_planes(
    own: Trajectory, start_round: int, rows: FloatArray, margin_m: float, config: MlrDmpcConfig
) -> HalfSpaces:
    """Half-spaces (M, S) that keep a plan from the start of a round on off obstacles.

    `rows` (M, 7) are those of `swarm_envs.tasks.obstacles.obstacle_rows`. The drone's centre stays
    `margin_m` off, not scaled by Theta; what it flies must be outside of every obstacle at every
    sample.
    """
    since = config.round_s * (start_round - own.identity.start_round)
    positions = own.positions(since + condensed(config).collision_times)
    offsets = _nearest(rows, positions)
    distance = np.linalg.norm(offsets, axis=-1)
    if not (distance > 0.0).all():
        obstacle, sample = np.argwhere(~(distance > 0.0))[0]
        raise ValueError(
            f"the trajectory is inside obstacle {obstacle} at {positions[sample].round(3)} m; "
            "start outside, and keep planes of all obstacles in every plan"
        )
    normals = -offsets / distance[..., None]
    along = np.einsum("rsi,rsi->rs", normals, positions + offsets)
    return HalfSpaces(normals, along + margin_m)


@kernel
def _nearest(rows: FloatArray, positions: FloatArray) -> FloatArray:
    """(M, S, 3) from positions (S, 3) to the nearest points of obstacles (M, 7), m."""
    out = np.empty((rows.shape[0], positions.shape[0], 3))
    for m in range(rows.shape[0]):
        for s in range(positions.shape[0]):
            x, y, z = positions[s]
            out[m, s, 0], out[m, s, 1], out[m, s, 2] = nearest_point(rows, m, x, y, z)
    return out


def soft_weights(
    end: FloatArray, target: FloatArray, others: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """Weights (C,) of the soft margins to others whose plans end at (C, 3) (Appendix B), 1/m^2.

    A large weight holds the margin open. It grows with the sine of the signed angle from the way of
    the own end (3,) to the target (3,) to that to the other's end, counter-clockwise as seen from
    above, hence for others on the left; the paper's "to the right" is a slip.
    """
    way, aside = (target - end)[:2], (others - end)[:, :2]
    cross = way[0] * aside[:, 1] - way[1] * aside[:, 0]
    lengths = np.hypot(way[0], way[1]) * np.hypot(aside[:, 0], aside[:, 1])
    weight = config.soft_weight * np.exp(config.soft_turn * cross / np.maximum(lengths, 1e-9))
    near = np.linalg.norm(target - end) < config.soft_near_m
    return weight * (config.soft_near_factor if near else 1.0)


_SLOP = 1e-6


def reachable_boxes(
    state: FloatArray, lower: FloatArray, upper: FloatArray, config: MlrDmpcConfig
) -> tuple[FloatArray, FloatArray]:
    """Boxes (S, 3), lower and upper corners, that hold a drone at the collision samples, m.

    From a state (3, 3) within bounds (3 h_b + h_s, 3): position, velocity, acceleration at state
    samples, jerk.
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
    """(S, 3) upper corners of `reachable_boxes`; for the lower ones, everything is mirrored."""
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
