"""Short trainings of two drones do learn: continuous integration flies that of PPO on one seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs.agents.policy_file import Policy, PolicyNote
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.recipes import evaluate_policy
from swarm_envs.training.rl.rl_config import RlConfig

MARGIN = 0.5
"""By how much success must rise over the untrained policy's."""


def success_before_and_after(config: RlConfig) -> tuple[float, float]:
    """Of two drones on the layout, by the untrained policy and by that which was trained."""
    learner = make_learner(config, "swap_v0")
    layout = str(learner.config.layout)
    seeds = [int(word) for word in np.random.SeedSequence(1).generate_state(64)]
    note = PolicyNote("swap_v0", 2, "acceleration", 10, config.num_neighbors)

    def success() -> float:
        policy, options = Policy(note, learner.actor(), {}), {"num_drones": 2, "force_rate": 48}
        return evaluate_policy(policy, "swap_v0", (layout,), seeds, options)[f"{layout}_success"]

    before = success()
    for segment in config.segments():
        entry = learner.fly(segment)
    assert entry["step"] == config.rollouts * config.rollout_steps >= config.steps
    after = success()
    learner.close()
    return before, after


def test_200_000_steps_teach_two_drones_to_swap():
    config = RlConfig(
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
    before, after = success_before_and_after(config)
    assert before < 0.1
    assert after > before + MARGIN


@pytest.mark.slow
def test_sac_teaches_two_drones_to_swap_on_a_circle():
    """What docs/rl.md says of seed 0; a few minutes."""
    config = RlConfig(out=Path("never"), algo="sac", layout="circle", drones=2, steps=800_000)
    before, after = success_before_and_after(config)
    assert before < 0.1
    assert after > before + MARGIN
