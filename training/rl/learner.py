"""What a run needs of an algorithm: the seam behind which `--algo` chooses.

Every algorithm flies in segments that can be repeated: each begins with new episodes, and with
generators that follow from the run's seed and the segment's place. So a checkpoint between two
segments holds tensors alone, no environment and no generator; and a run that goes on from one ends
as if nothing had happened.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Protocol, cast

from torch import Tensor

from swarm_envs.agents.networks import Network
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.practice import Practice
from swarm_envs.training.rl.recipes import completed

Entry = dict[str, float]
"""What is noted of a point of the training curve, by name."""
Watch = Callable[[], None]
"""Called after every rollout: where a progress bar moves."""

_LEARNERS = {"ppo": "PpoLearner", "mappo": "MappoLearner", "sac": "SacLearner"}
"""The class of each algorithm, in the module of its name."""


class Learner(Protocol):
    """A policy in training."""

    @property
    def env(self) -> Practice:
        """What it flies, with the tally of how episodes end."""

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment.

        Args:
            segment: of `TrainConfig.segments`; the one after those that were trained.
            watch: called after every rollout.

        Returns:
            Averages over the segment: `step`, where it stands; `success` and `collision`, shares
            of its episodes; and what the algorithm says of itself.
        """

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action, as `Policy` takes them."""

    def tensors(self) -> dict[str, Tensor]:
        """All that the next segments depend on, by names of the algorithm's own."""

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Stand where another learner of the same options gave these tensors.

        Raises:
            KeyError, RuntimeError, ValueError: they are of networks of another kind.
        """

    def close(self) -> None:
        """Free the environments."""


def make_learner(config: TrainConfig, task: str) -> Learner:
    """A fresh learner of the algorithm that the options name.

    Args:
        config: of the run.
        task: its versioned name.
    """
    module = import_module(f"swarm_envs.training.rl.{config.algo}")
    return cast(Learner, getattr(module, _LEARNERS[config.algo])(completed(config, task), task))
