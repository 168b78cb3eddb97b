"""Reward terms and their weighted sum.

Terms are in seconds, or 1 for an event, so that weights alone set their scale.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_name, check_number, check_type
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.motion import SPEED_LIMIT

__all__ = ["REWARD_NAMES", "REWARD_WEIGHTS", "weigh", "write_terms"]

REWARD_NAMES = ("progress", "at_goal", "tracking", "effort", "proximity", "crash", "success")
"""The reward terms of every task; see `write_terms`."""
REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 1.0,
        "at_goal": 0.1,
        "tracking": 0.0,
        "effort": -0.1,
        "proximity": -4.0,
        "crash": -1.0,
        "success": 3.0,
    }
)
"""Default weight of each of these terms. Success is worth as much as 30 s at the
goal, so that delaying it does not pay."""


@kernel
def write_terms(drones: Records, environments: Records, settings: Records, out: FloatArray) -> None:
    """Write the reward terms (T, E, N), in the order of `REWARD_NAMES`.

    The return of an episode depends neither on the decision rate nor on the time limit:

    - `progress`: decrease of the distance to the goal, over the speed limit, in seconds: a
      difference of potentials (Ng, Harada and Russell, 1999), so that closed paths sum to 0 while
      the goal rests; a goal that moves counts only for the drone's own motion toward it.
    - `at_goal`: exp(-(distance to the goal / 0.15 m)^2), times the step in seconds.
    - `tracking`: exp(-(distance to the reference / 0.10 m)^2), times the step in seconds.
    - `effort`: mean square of the action, times the step in seconds.
    - `proximity`: 1 at contact with a drone or an obstacle, falling linearly to 0 at 2.5 times
      the distance of contact; times the step in seconds.
    - `crash`: 1 on the step on which the drone crashes.
    - `success`: 1 on the step on which the team succeeds, or one over the number of stages for
      each stage, for the drones whose episodes have not ended.

    Args:
        drones: (E, N) records, after the evaluation of a decision.
        environments: (E,) records.
        settings: (1,) record, with the time between decisions.
        out: (T, E, N), written.
    """
    decision_s = settings[0].decision_s
    farthest = SPEED_LIMIT * decision_s
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            d = drones[e, i]
            near = min(d.clearance, d.obstacle_clearance)
            proximity = min(max((near - 2.5) / (1.0 - 2.5), 0.0), 1.0)
            out[0, e, i] = decision_s * ((d.last_distance - d.distance) / farthest)
            out[1, e, i] = decision_s * math.exp(-((d.distance / 0.15) ** 2))  # 0.37 at 0.15 m
            out[2, e, i] = decision_s * math.exp(-((d.tracking_error / 0.10) ** 2))
            out[3, e, i] = decision_s * d.effort
            out[4, e, i] = decision_s * proximity
            out[5, e, i] = d.crashed
            out[6, e, i] = environments[e].achieved * d.active


def reward_meanings(writer: Callable[..., None]) -> dict[str, str]:
    """Return the meaning of each term, from the docstrings of `write_terms` and a task's kernel."""
    text = "\n\n".join(inspect.getdoc(source) or "" for source in (write_terms, writer))
    found = re.findall(r"^- `(\w+)`: (.+(?:\n  .+)*)", text, re.MULTILINE)
    return {name: " ".join(meaning.split()) for name, meaning in found}


def check_reward_weights(weights: Mapping[str, float], names: Sequence[str]) -> None:
    """Raise ValueError for weights of unknown terms and for weights that are not finite."""
    check_type("reward_weights", weights, Mapping)
    for term, weight in weights.items():
        check_name("reward term", term, names)
        check_number(f"the weight of {term!r}", weight)


@kernel
def weigh(
    terms: FloatArray,
    weights: FloatArray,
    flown: BoolArray,
    drones: Records,
    environments: Records,
    rewards: FloatArray,
    terminated: BoolArray,
    truncated: BoolArray,
    active: BoolArray,
    ended: BoolArray,
) -> None:
    """Write the weighted sums of reward terms, and the masks of a step's result.

    Terms are summed in their order, so that rewards do not depend on the size of the batch.

    Args:
        terms: (T, E, N); set to 0 for drones that ended in an earlier decision.
        weights: (T,).
        flown: (E,) environments that have made this decision; the rewards of others are 0.
        drones: (E, N) records.
        environments: (E,) records.
        rewards: (E, N), written.
        terminated: (E,) ended by a crash or by success, written.
        truncated: (E,) ended by the time limit, written.
        active: (E, N) drones that took part in this decision, written.
        ended: (E, N) drones whose episode was terminated in it, written.
    """
    for e in range(rewards.shape[0]):
        terminated[e], truncated[e] = environments[e].terminated, environments[e].truncated
        for i in range(rewards.shape[1]):
            d, total = drones[e, i], 0.0
            flew = d.active + d.crashed > 0.0
            for t in range(terms.shape[0]):
                if not flew:
                    terms[t, e, i] = 0.0
                total += weights[t] * terms[t, e, i]
            rewards[e, i] = total if flown[e] else 0.0
            active[e, i] = flown[e] and flew
            ended[e, i] = active[e, i] and (terminated[e] or d.active == 0.0)
