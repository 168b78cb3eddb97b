"""A short training on two drones does learn: continuous integration flies it on one seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs.agents.policy_file import Policy, PolicyNote
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.judging import Judges
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import completed

MARGIN = 0.5
"""By how much success must rise over the untrained policy's."""


def test_200_000_steps_teach_two_drones_to_swap():
    config = TrainConfig(
        out=Path("never"),
        drones=2,
        steps=200_000,
        environments=128,
        rollout=16,
        batch_size=1024,
        passes=8,
        learning_rate=3e-3,
        num_neighbors=1,
        second_stage=0.0,
        checkpoint_rollouts=1000,
    )
    learner = PpoLearner(completed(config, "swap_v0"), "swap_v0")
    seeds = [int(word) for word in np.random.SeedSequence(1).generate_state(64)]
    judges = Judges("swap_v0", ("random",), seeds, {"num_drones": 2, "force_rate": 48})
    note = PolicyNote("swap_v0", 2, "acceleration", 10, 1)

    def success() -> float:
        return judges.judge(Policy(note, learner.actor(), {}))["random_success"]

    before = success()
    (segment,) = config.segments()
    learner.fly(segment)
    assert learner.model.num_timesteps == len(segment) * config.rollout_steps >= 200_000
    assert before < 0.1
    assert success() > before + MARGIN
    judges.close()
    learner.close()
