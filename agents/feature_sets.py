"""What networks may be told of an observation row, by name."""

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
TYPED = goal_features.TYPED
"""The same, and who is of which type."""
REFERENCE = reference_features.NAME
"""For tasks with a reference to be kept to; see `swarm_envs.agents.reference_features`."""
TYPES = tuple(VEHICLES)
"""Types of vehicles in the order of their one-hot code."""


class FeatureSizes(NamedTuple):
    """Where features of a row have what: the drone's own numbers, then those of K neighbours."""

    num_neighbors: int
    """K"""
    own: int
    """Numbers about the drone itself."""
    neighbor: int
    """Numbers about each neighbour."""
    mask: int
    """Which of a neighbour's says that it is there."""
    own_type: int | None = None
    """From which of its own its type stands, one-hot, if it is told."""
    neighbor_type: int | None = None
    """The same of a neighbour's."""

    @property
    def typed(self) -> bool:
        """Whether types of vehicles are told."""
        return self.own_type is not None

    @property
    def width(self) -> int:
        """Numbers altogether."""
        return self.own + self.neighbor * self.num_neighbors

    def own_column(self, token: str) -> int:
        """Which of its own numbers is 1 where a drone is of a type, else 0."""
        assert self.own_type is not None
        return self.own_type + TYPES.index(token)

    def neighbor_column(self, token: str) -> int:
        """Which of a neighbour's numbers is 1 where it is there and of a type, else 0."""
        assert self.neighbor_type is not None
        return self.neighbor_type + TYPES.index(token)

    def split(self, values: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Features (..., width) as a drone's (..., own) and its neighbours' (..., K, neighbor)."""
        shape = (*values.shape[:-1], self.num_neighbors, self.neighbor)
        return values[..., : self.own], values[..., self.own :].reshape(shape)


class FeatureSet(NamedTuple):
    """One choice of features."""

    sizes: Callable[[int], FeatureSizes]
    """Of features of a row with K neighbours."""
    make: Callable[[Float32Array, int], Float32Array]
    """Features (..., width) of flat rows without obstacles, and K."""


def _goal_sizes(num_neighbors: int, typed: bool) -> FeatureSizes:
    own, neighbor = goal_features.OWN_WIDTH, goal_features.NEIGHBOR_WIDTH
    if not typed:
        return FeatureSizes(num_neighbors, own, neighbor, neighbor - 1)
    more = len(TYPES)
    return FeatureSizes(num_neighbors, own + more, neighbor + more, neighbor - 1, own, neighbor)


def _reference_sizes(num_neighbors: int) -> FeatureSizes:
    own, neighbor = reference_features.OWN_WIDTH, reference_features.NEIGHBOR_WIDTH
    own_type, neighbor_type = own - len(TYPES), neighbor - 1 - len(TYPES)
    return FeatureSizes(num_neighbors, own, neighbor, neighbor - 1, own_type, neighbor_type)


FEATURE_SETS: Mapping[str, FeatureSet] = MappingProxyType(
    {
        GOAL: FeatureSet(partial(_goal_sizes, typed=False), goal_features.features),
        TYPED: FeatureSet(
            partial(_goal_sizes, typed=True), partial(goal_features.features, typed=True)
        ),
        REFERENCE: FeatureSet(_reference_sizes, reference_features.reference_features),
    }
)
"""By name: files of policies say by it what their network is told."""
