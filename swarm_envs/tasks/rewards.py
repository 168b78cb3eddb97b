"""Bounded shapes that rewards are made of, and their weighted sum.

Every term lies in [0, 1], or in [-1, 1] where it has a sign, so weights alone set the scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from swarm_envs.compiled import equation, kernel
from swarm_envs.errors import check_name
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import SPEED_LIMIT

__all__ = ["REWARD_NAMES", "check_reward_weights", "weigh", "write_terms"]

REWARD_NAMES = ("progress", "at_goal", "tracking", "effort", "proximity", "crash", "success")
"""The reward terms of every task; see `write_terms`."""


@equation
def bell(x: float, width: float) -> float:
    """exp(-(x / width)^2): 1 at zero, 0.37 at `width`."""
    return math.exp(-((x / width) ** 2))


@kernel
def write_terms(drones: Records, environments: Records, settings: Records, out: FloatArray) -> None:
    """Write the bounded reward terms (T, E, N), in the order of `REWARD_NAMES`.

    Terms per step are multiplied by the step duration (s, or its share of the episode), so that
    returns do not depend on the decision rate:

    - `progress`: speed towards the goal, over the speed limit, in [-1, 1]; times seconds.
    - `at_goal`: exp(-(distance to the goal / 0.15 m)^2); sums to at most 1 over an episode.
    - `tracking`: exp(-(distance to the reference / 0.10 m)^2); sums to at most 1.
    - `effort`: mean square action; times seconds.
    - `proximity`: 1 where a drone touches a drone or an obstacle, falling to 0 at 2.5 times that
      distance; times seconds.
    - `crash`: 1 on the step on which the drone crashes.
    - `success`: 1 on the step on which the team succeeds, or one over the number of stages for
      each stage.

    Args:
        drones: (E, N) records, after a decision has been judged.
        environments: (E,) records.
        settings: (1,) record, with the time between decisions and the clock.
        out: (T, E, N), written.
    """
    decision_s, horizon_s = settings[0].decision_s, settings[0].horizon_s
    farthest, share = SPEED_LIMIT * decision_s, decision_s / horizon_s
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            d = drones[e, i]
            near = min(d.clearance, d.obstacle_clearance)
            covered = (d.last_distance - d.distance) / farthest
            proximity = min(max((near - 2.5) / (1.0 - 2.5), 0.0), 1.0)
            out[0, e, i] = decision_s * min(max(covered, -1.0), 1.0)
            out[1, e, i] = share * bell(d.distance, 0.15)
            out[2, e, i] = share * bell(d.tracking_error, 0.10)
            out[3, e, i] = decision_s * d.effort
            out[4, e, i] = decision_s * proximity
            out[5, e, i] = d.crashed
            out[6, e, i] = environments[e].achieved


def check_reward_weights(weights: Mapping[str, float], names: Sequence[str]) -> None:
    """Refuse weights of terms that are not among a task's names, or that are not finite.

    Raises:
        ValueError: naming the term, and the nearest that exists.
    """
    for term, weight in weights.items():
        check_name("reward term", term, names)
        if not math.isfinite(weight):
            raise ValueError(f"the weight of {term!r} is {weight}, but must be finite")


@kernel
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
