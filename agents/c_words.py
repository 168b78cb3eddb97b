"""The words with which the C99 text of an exported policy is filled."""

from __future__ import annotations

from swarm_envs.agents import c_source, features, reference_features
from swarm_envs.agents.feature_sets import REFERENCE
from swarm_envs.agents.policy_file import Policy
from swarm_envs.c_text import number
from swarm_envs.envs.actions import ACCELERATION_LAG
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

_POOLED = {
    "mean": ("0.0f", "code[k] += member[k];", "count > 0 ? code[k] / (float)count : 0.0f"),
    "sum": ("0.0f", "code[k] += member[k];", "code[k]"),
    "max": ("-1.0f", "if (member[k] > code[k]) code[k] = member[k];", "count > 0 ? code[k] : 0.0f"),
}
"""Of each way of pooling: the first value, what a member does, and what comes out."""


def feature_words(policy: Policy) -> dict[str, str]:
    """What differs between sets of features, and between ways of telling neighbours."""
    note, sizes = policy.note, policy.note.sizes
    kept = note.features == REFERENCE
    own, other = "", ""
    if sizes.own_type is not None and sizes.neighbor_type is not None:
        own = c_source.ONE_HOT.format(start=sizes.own_type, whose="self")
        other = c_source.ONE_HOT.format(start=sizes.neighbor_type, whose="other")
    first, pool, result = _POOLED[note.pooling]
    sound = [f"@name@_sound(own->reference_{what})" for what in _MOTIONS]
    return {
        "own": c_source.REFERENCE_OWN if kept else c_source.GOAL_OWN,
        "own_types": own,
        "neighbour_types": other,
        "unused_goal": "; not used by this policy" if kept else "",
        "unused_type": "" if sizes.typed else "; not used by this policy",
        "own_sound": " &&\n                ".join(sound) if kept else _TIME_SOUND,
        "other_sound": "@name@_known(other[j].type)" + ("" if kept else _GOAL_SOUND),
        "known": _known(policy),
        "pooling": note.pooling,
        "first": first,
        "pool": pool,
        "result": result,
        "code": str(_code(policy)),
    }


_MOTIONS = ("position", "velocity", "acceleration")
_TIME_SOUND = "@name@_sound(self->goal) && own->time_left - own->time_left == 0.0f"
_GOAL_SOUND = " && @name@_sound(other[j].goal)"


def _known(policy: Policy) -> str:
    """Whether a type of vehicle is one that the policy was trained with, in C."""
    wanted = [k for k, token in enumerate(VEHICLES) if token in policy.note.types]
    if not wanted:
        return "(void)type; return 1;"
    return f"return {' || '.join(f'type == {k}' for k in wanted)};"


def _code(policy: Policy) -> int:
    """Numbers that a neighbour becomes."""
    found = [n.phi for n in policy.networks.values() if n.phi]
    return len(next(iter(found[0].values()))[-1][1]) if found else 1


def constants(policy: Policy) -> dict[str, str]:
    """Lengths, limits and times that the text names."""
    step = 1.0 / policy.note.decision_rate
    values = {
        "speed": SPEED_LIMIT,
        "limit": ACCELERATION_LIMIT,
        "step": step,
        "tau": max(ACCELERATION_LAG, 0.5 * step),
        "goal_reach": features.GOAL_REACH,
        "near": features.NEAR,
        "ahead": features.AHEAD,
        "goal_seen": features.OTHERS_GOAL,
        "reach": reference_features.REACH,
        "fast": reference_features.FAST,
        "beside": reference_features.BESIDE,
        "above": reference_features.ABOVE,
    }
    return {name: number(value) for name, value in values.items()}
