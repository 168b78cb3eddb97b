"""Every choice of what a policy network is told of an observation row, by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from swarm_envs.agents import features as goal_features
from swarm_envs.agents import reference_features
from swarm_envs.envs.observation import Float32Array
from swarm_envs.vehicles import VEHICLES

GOAL = goal_features.FEATURES
"""For tasks with places to be reached; see `swarm_envs.agents.features`."""
TYPED_GOAL = goal_features.TYPED
"""The same for teams of several types of vehicles."""
REFERENCE = reference_features.NAME
"""For tasks with a reference to be kept to; see `swarm_envs.agents.reference_features`."""
TYPES = tuple(VEHICLES)
"""Types of vehicles in the order of their one-hot code."""


class FeatureForm(NamedTuple):
    """Where a choice of features has what: `own` numbers, then `neighbor` of each neighbour."""

    own: int
    """Numbers about the drone itself."""
    neighbor: int
    """Numbers about each neighbour, all zero where there is none."""
    mask: int
    """Place of the mask among a neighbour's numbers."""
    own_type: int | None = None
    """Where the one-hot type begins among the drone's own numbers; None: it is not told."""
    neighbor_type: int | None = None
    """Where it begins among a neighbour's."""

    def split(self, values: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Features (..., width) as a drone's (..., own), its neighbours' (..., K, neighbor)."""
        around = values[..., self.own :].reshape(*values.shape[:-1], -1, self.neighbor)
        return values[..., : self.own], around


class FeatureSet(NamedTuple):
    """One choice of features."""

    form: FeatureForm
    make: Callable[[Float32Array, int], Float32Array]
    """Features (..., width(K)) of flat rows without obstacles, and K."""

    def width(self, num_neighbors: int) -> int:
        """How many numbers are made of a row with K neighbours."""
        return self.form.own + self.form.neighbor * num_neighbors


_OWN, _OTHER, _TYPES = goal_features.OWN_WIDTH, goal_features.NEIGHBOR_WIDTH, len(TYPES)
_REFERENCE_OWN, _REFERENCE_OTHER = reference_features.OWN_WIDTH, reference_features.NEIGHBOR_WIDTH

FEATURE_SETS: Mapping[str, FeatureSet] = MappingProxyType(
    {
        GOAL: FeatureSet(FeatureForm(_OWN, _OTHER, _OTHER - 1), goal_features.features),
        TYPED_GOAL: FeatureSet(
            FeatureForm(_OWN + _TYPES, _OTHER + _TYPES, _OTHER - 1, _OWN, _OTHER),
            partial(goal_features.features, typed=True),
        ),
        REFERENCE: FeatureSet(
            FeatureForm(
                _REFERENCE_OWN,
                _REFERENCE_OTHER,
                _REFERENCE_OTHER - 1,
                _REFERENCE_OWN - _TYPES,
                _REFERENCE_OTHER - 1 - _TYPES,
            ),
            reference_features.reference_features,
        ),
    }
)
"""By name: files of policies say by it what their network is told."""


def with_types(name: str) -> str:
    """The choice that tells the same as this one, and the types of vehicles."""
    return TYPED_GOAL if name == GOAL else name
