"""What changes over a run, as functions of the options and of the rollouts that were flown."""

from __future__ import annotations

import numpy as np

from swarm_envs.training.rl.config import TrainConfig


def segment_seed(config: TrainConfig, segment: range) -> int:
    """Seed of a segment's episodes and draws: the run's, and the segment's place."""
    words = np.random.SeedSequence([config.seed, segment.start]).generate_state(1)
    return int(words[0]) >> 1


def learning_rate(config: TrainConfig, rollouts: int) -> float:
    """Adam's rate: it falls linearly over each stage."""
    first = config.first_stage
    if rollouts < first:
        return _falling(config.learning_rate, rollouts / first, config.last_rate)
    done = (rollouts - first) / max(config.rollouts - first, 1)
    return _falling(config.second_rate, done, config.last_rate)


def falling_rate(config: TrainConfig, rollouts: int) -> float:
    """Adam's rate of SAC: it falls linearly over the run."""
    options = config.sac
    return _falling(options.learning_rate, rollouts / config.rollouts, options.last_rate)


def proximity_weight(config: TrainConfig, rollouts: int) -> float:
    """Weight of the term `proximity`, a cost: it changes in the middle of the first stage."""
    first, last = config.proximity
    share = np.clip(2.0 * rollouts / config.first_stage - 0.5, 0.0, 1.0)
    return -config.reward_scale * float(first + share * (last - first))


def _falling(rate: float, done: float, last: float) -> float:
    return rate * max(1.0 - done, last)
