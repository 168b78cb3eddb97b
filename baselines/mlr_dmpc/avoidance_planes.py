"""Half-spaces that contain a plan: buffered Voronoi planes between drones, planes of obstacles.

Obstacles (boxes and columns) are convex. The plane through the nearest point of one, normal to the
direction to it, has all of it behind; a plan that stays `margin` in front of the plane stays that
far from the obstacle. The present plan, at least `margin` away at every sample, satisfies its own
planes: as for other drones, it stays feasible when it is shifted (Theorem T1, with planes instead
of trajectories).

Obstacles are not checked between samples: at speed v a drone moves v T_c / 2 from the nearer one,
so the margin should contain that in addition to the drone's radius, or T_c be finer.

Half-spaces out of reach within the horizon are omitted. Every plan that satisfies (13b)-(13e) lies
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
plan: it cannot bind and can be omitted. The plane of eq. (15) lies between the present plan p0 and
the known trajectory q of the other drone, its normal within an angle alpha of Theta^-1 (p0 - q). So
it holds for every q with |Theta^-1 (q - p0)| cos alpha >= d + r (d + 2 r if the other may be
replanned), where r is the largest |Theta^-1 (p - p0)| of p in the box: a drone that cannot come
within reach costs no row. Each candidate of a drone has its own rows, which are tested separately.
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
"""The margin of rows beyond the distance, m, for the tolerances of two drones."""
ROW_MARGIN = 1e-5  # A further margin of rows as they are solved, m, for the solver's tolerance


class Neighbors(NamedTuple):
    """Every candidate trajectory of every other drone, at the collision samples of a plan."""

    positions: FloatArray  # (C, S, 3) at t + T_c, t + 2 T_c, ... for a plan that starts at t, m
    drone: IntArray  # (C,) the drone of each trajectory
    concurrent: BoolArray  # (C,) True if that drone may be replanned in the same round

    def some(self, kept: BoolArray | IntArray) -> Neighbors:
        """Return the trajectories of a mask (C,) or of indices."""
        return Neighbors(self.positions[kept], self.drone[kept], self.concurrent[kept])


class HalfSpaces(NamedTuple):
    """Half-spaces normal . p >= offset that hold at one collision sample each."""

    normals: FloatArray  # (P, S, 3), unit free
    offsets: FloatArray  # (P, S), m


def voronoi_planes(own: FloatArray, neighbors: Neighbors, config: MlrDmpcConfig) -> HalfSpaces:
    """Return half-spaces (C, S), (15), between a drone's plan (S, 3), m, and others' trajectories.

    The plan gets half of the gap to a drone that may be replanned, and all of the gap to another.
    Normals are divided by Theta: they are for points in meters.

    Planes are turned about the vertical by up to `turn_rad`, so that each drone has more room on
    its right: with the weights of Appendix B alone, two drones that approach head-on get stuck. Any
    unit normal proves Lemma L3. For Corollary 1 of the paper both drones need the same plane: the
    turn and its sense depend only on the gap, which is the same for both. For Theorem T1 the
    present plan must satisfy its rows: the gap along the turned normal stays above the distance,
    since the turn is at most `turn_share` of the angle at which it would not.
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
    """Turn a unit normal (3,) about the vertical, keeping `least_gap` of the gap along it."""
    level = normal[0] ** 2 + normal[1] ** 2
    least = (least_gap - normal[2] ** 2) / max(level, 1e-12)
    angle = min(turn, share * math.acos(max(min(least, 1.0), -1.0)))
    x, y = normal[0], normal[1]
    normal[0] = math.cos(angle) * x - math.sin(angle) * y
    normal[1] = math.sin(angle) * x + math.cos(angle) * y


def obstacle_planes(
    own: Trajectory, start_round: int, rows: FloatArray, margin_m: float, config: MlrDmpcConfig
) -> HalfSpaces:
    """Return half-spaces (M, S) that keep a plan from the start of a round on off obstacles.

    `rows` (M, 7) are those of `swarm_envs.tasks.obstacles.obstacle_rows`. The drone's center stays
    `margin_m` away, not scaled by Theta. The present trajectory must be outside of every obstacle
    at every sample.
    """
    since = config.round_s * (start_round - own.identity.start_round)
    positions = own.positions(since + condensed(config).collision_times)
    offsets = _nearest(rows, positions)
    distance = np.linalg.norm(offsets, axis=-1)
    if not (distance > 0.0).all():
        obstacle, sample = np.argwhere(~(distance > 0.0))[0]
        raise ValueError(
            f"the trajectory is inside obstacle {obstacle} at {positions[sample].round(3)} m; "
            "start outside, and use the planes of all obstacles in every plan"
        )
    normals = -offsets / distance[..., None]
    along = np.einsum("rsi,rsi->rs", normals, positions + offsets)
    return HalfSpaces(normals, along + margin_m)


@kernel
def _nearest(rows: FloatArray, positions: FloatArray) -> FloatArray:
    """Return vectors (M, S, 3), m, from positions (S, 3) to the nearest points of obstacles."""
    out = np.empty((rows.shape[0], positions.shape[0], 3))
    for m in range(rows.shape[0]):
        for s in range(positions.shape[0]):
            x, y, z = positions[s]
            out[m, s, 0], out[m, s, 1], out[m, s, 2] = nearest_point(rows, m, x, y, z)
    return out


def soft_weights(
    end: FloatArray, target: FloatArray, others: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """Return weights (C,) of the soft margins to others' ends (C, 3) (Appendix B), 1/m^2.

    A large weight keeps the margin wide. It grows with the sine of the angle from the direction to
    the target (3,), at the own end (3,), to that to the other's end, counter-clockwise as seen from
    above. It is thus larger for others on the left; the paper's "to the right" is an error.
    """
    ahead, aside = (target - end)[:2], (others - end)[:, :2]
    cross = ahead[0] * aside[:, 1] - ahead[1] * aside[:, 0]
    lengths = np.hypot(ahead[0], ahead[1]) * np.hypot(aside[:, 0], aside[:, 1])
    weight = config.soft_weight * np.exp(config.soft_turn * cross / np.maximum(lengths, 1e-9))
    near = np.linalg.norm(target - end) < config.soft_near_m
    return weight * (config.soft_near_factor if near else 1.0)


_SLOP = 1e-6


def reachable_boxes(
    state: FloatArray, lower: FloatArray, upper: FloatArray, config: MlrDmpcConfig
) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper corners (S, 3) of the reachable boxes at collision samples, m.

    `state` (3, 3) is the first state; `lower` and `upper` (3 h_b + h_s, 3) bound position, velocity
    and acceleration at the state samples, and the jerks.
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
    """Return (R, S) True if normal . p >= offset for all p of the box (S, 3) at that sample."""
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
    """Return upper corners (S, 3) of `reachable_boxes`; lower ones follow by mirroring."""
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
            step = dt * (v[k, i] + dt * (a[k, i] / 3 + a[k + 1, i] / 6))
            p[k + 1, i] = min(p[k + 1, i], p[k, i] + step)
        for k in range(inputs - 1, -1, -1):
            step = dt * (v_low[k, i] + dt * (a_low[k, i] / 3 + a_low[k + 1, i] / 6))
            p[k, i] = min(p[k, i], p[k + 1, i] - step)
    return _between(p, v, a, dt, steps[2], counts[2])


@kernel
def _between(
    p: FloatArray, v: FloatArray, a: FloatArray, dt: float, sampling: float, samples: int
) -> FloatArray:
    """Return the highest positions (S, 3) at the collision samples from those at the knots."""
    out = np.empty((samples, 3))
    for s in range(samples):
        time = (s + 1) * sampling
        k = min(int(time / dt + 1e-9), p.shape[0] - 2)
        tau = time - k * dt
        end = tau**3 / (6 * dt)
        for i in range(3):
            out[s, i] = p[k, i] + tau * v[k, i] + (tau**2 / 2 - end) * a[k, i] + end * a[k + 1, i]
    return out
