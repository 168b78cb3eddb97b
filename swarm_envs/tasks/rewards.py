"""Bounded shapes that rewards are made of, and their weighted sum.

Every term lies in [0, 1], or in [-1, 1] where it has a sign, so weights alone set the scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.errors import check_name
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import SPEED_LIMIT, Situation

REWARD_NAMES = ("progress", "at_goal", "tracking", "effort", "proximity", "crash", "success")
"""The reward terms of every task; see `write_terms`."""


@borrowing_kernel
def bell(x: float, width: float) -> float:
    """exp(-(x / width)^2): 1 at zero, 0.37 at `width`."""
    return math.exp(-((x / width) ** 2))


@borrowing_kernel
def ramp(x: float, zero_at: float, one_at: float) -> float:
    """Linear from 0 at `zero_at` to 1 at `one_at`, constant beyond both."""
    return min(max((x - zero_at) / (one_at - zero_at), 0.0), 1.0)


@borrowing_kernel
def progress(before: float, now: float, farthest: float) -> float:
    """Decrease of a distance, as a share of the most a drone can cover: within [-1, 1].

    Args:
        before: distance to the goal at the last decision, m.
        now: distance to the goal now, m.
        farthest: distance covered at the speed limit between decisions, m.
    """
    return min(max((before - now) / farthest, -1.0), 1.0)


@borrowing_kernel
def proximity(clearance: float) -> float:
    """1 where drones touch, 0 from 2.5 times the sum of their radii on; so with obstacles.

    Args:
        clearance: distance to the nearest drone over the sum of radii, or to the nearest obstacle
            over the radius.
    """
    return ramp(clearance, 2.5, 1.0)


@borrowing_kernel
def write_terms(situation: Situation, decision_s: float, horizon_s: float, out: FloatArray) -> None:
    """Write the bounded reward terms (T, E, N), in the order of `REWARD_NAMES`.

    What goes on is counted by time, so that returns do not depend on the decision rate:
    `progress` (of the speed limit towards the goal), `effort` (mean square action) and `proximity`
    (to the nearest drone or obstacle) are the decision's duration in seconds times a number in
    [-1, 1] or [0, 1]; `at_goal` and `tracking` are its share of the clock times a bell around goal
    and reference, so that their sum over an episode is at most 1. Two are events: `crash` on the
    step that ends badly for the drone; `success` on the step at which the team has done its task,
    or one over the number of stages for each of them, so that it sums to 1.

    Args:
        situation: arrays (E, N).
        decision_s: time between decisions, s.
        horizon_s: the clock, s.
        out: (T, E, N), written.
    """
    farthest, share = SPEED_LIMIT * decision_s, decision_s / horizon_s
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            before, now = situation.last_distance[e, i], situation.distance[e, i]
            near = min(situation.clearance[e, i], situation.obstacle_clearance[e, i])
            out[0, e, i] = decision_s * progress(before, now, farthest)
            out[1, e, i] = share * bell(now, 0.15)
            out[2, e, i] = share * bell(situation.tracking_error[e, i], 0.10)
            out[3, e, i] = decision_s * situation.effort[e, i]
            out[4, e, i] = decision_s * proximity(near)
            out[5, e, i] = situation.crashed[e, i]
            out[6, e, i] = situation.achieved[e]


def check_reward_weights(weights: Mapping[str, float]) -> None:
    """Refuse weights of terms that do not exist, or that are not finite.

    Raises:
        ValueError: naming the term, and the nearest that exists.
    """
    for term, weight in weights.items():
        check_name("reward term", term, REWARD_NAMES)
        if not math.isfinite(weight):
            raise ValueError(f"the weight of {term!r} is {weight}, but must be finite")


@borrowing_kernel
def weigh(terms: FloatArray, weights: FloatArray, running: BoolArray, rewards: FloatArray) -> None:
    """Sum weighted terms, in their order: compiled, so that no batch changes the last bit.

    Args:
        terms: (T, E, N).
        weights: (T,).
        running: (E,) environments that fly; the others get nothing.
        rewards: (E, N), written.
    """
    for e in range(rewards.shape[0]):
        for i in range(rewards.shape[1]):
            total = 0.0
            for t in range(terms.shape[0]):
                total += weights[t] * terms[t, e, i]
            rewards[e, i] = total if running[e] else 0.0
