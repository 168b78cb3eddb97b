"""Short trainings of two drones do learn: continuous integration flies that of PPO on one seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs.agents.policy import Policy, PolicyNote
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.recipes import evaluate_policy
from swarm_envs.training.rl.rl_config import RlConfig

MARGIN = 0.5
"""By how much success must rise over the untrained policy's."""


PPO: dict[str, Any] = {
    **{"steps": 200_000, "rollout": 16, "batch_size": 1024, "passes": 8, "learning_rate": 3e-3},
    **{"num_neighbors": 1, "second_stage": 0.0, "checkpoint_rollouts": 1000},
}
SAC = {"algo": "sac", "layout": "circle", "steps": 800_000}


@pytest.mark.parametrize("options", [PPO, pytest.param(SAC, marks=pytest.mark.slow)])
def test_two_drones_learn_to_swap(options):
    """By PPO in 200,000 decisions; by SAC on a circle, as docs/rl.md says, in a few minutes."""
    config = RlConfig(out=Path("never"), drones=2, **options)
    learner = make_learner(config, "swap_v0")
    layout = str(learner.config.layout)
    seeds = [int(word) for word in np.random.SeedSequence(1).generate_state(64)]
    note = PolicyNote("swap_v0", 2, "acceleration", 10, config.num_neighbors)

    def success() -> float:
        policy, flown = Policy(note, learner.actor(), {}), {"num_drones": 2, "force_rate": 48}
        return evaluate_policy(policy, "swap_v0", (layout,), seeds, flown)[f"{layout}_success"]

    before = success()
    for segment in config.segments():
        entry = learner.fly(segment)
    assert entry["step"] == config.rollouts * config.rollout_steps >= config.steps
    assert before < 0.1
    assert success() > before + MARGIN
