"""Every choice of what a policy network is told of an observation row, by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from swarm_envs.agents import features as goal_features
from swarm_envs.agents import reference_features
from swarm_envs.envs.observation import Float32Array

GOAL = goal_features.FEATURES
"""For tasks with places to be reached; see `swarm_envs.agents.features`."""
REFERENCE = reference_features.NAME
"""For tasks with a reference to be kept to; see `swarm_envs.agents.reference_features`."""


class FeatureSet(NamedTuple):
    """One choice of features."""

    width: Callable[[int], int]
    """How many numbers are made of a row with K neighbours."""
    make: Callable[[Float32Array, int], Float32Array]
    """Features (..., width(K)) of flat rows without obstacles, and K."""


FEATURE_SETS: Mapping[str, FeatureSet] = MappingProxyType(
    {
        GOAL: FeatureSet(goal_features.feature_width, goal_features.features),
        REFERENCE: FeatureSet(
            reference_features.reference_width, reference_features.reference_features
        ),
    }
)
"""By name: files of policies say by it what their network is told."""
