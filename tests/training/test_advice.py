"""The suggestions at the end of `swarm-envs train` follow from what was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch", reason="training needs torch")
pytest.importorskip("stable_baselines3", reason="training needs Stable-Baselines3")

from swarm_envs.training.rl.advice import advice
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig
from swarm_envs.training.rl.validation import with_defaults

LOW = {"step": 1.0, "circle_success": 0.1, "circle_collision": 0.8}


def suggested(*results: dict[str, float], **options: Any) -> str:
    config = RlConfig(out=Path("runs/a"), layout="circle", **options)
    return "\n".join(advice(with_defaults(config, "swap_v1"), "swap_v1", results))


def test_a_policy_that_succeeds_needs_nothing():
    assert suggested({**LOW, "circle_success": 0.97}, drones=16, algo="dagger") == ""


def test_more_steps_where_success_rose():
    before = {**LOW, "circle_success": 0.05}
    assert "from 5.0% to 10.0%: train longer, --steps 6000000" in suggested(before, LOW)
    assert "longer" not in suggested(LOW, {**LOW, "circle_success": 0.11})
    assert "1,000 steps are few: train longer, --steps 3000000" in suggested(LOW, steps=1000)


def test_another_teacher_where_this_one_fails():
    """On circles straight lines meet in one place: `roundabout` flies them, `straight-line` not."""
    dagger = DaggerConfig(teacher=("straight-line",))
    said = suggested(LOW, drones=16, algo="dagger", dagger=dagger, decision_rate=20)
    assert "straight-line itself succeeds in 0% of 64 episodes" in said
    assert "--dagger.teacher roundabout" in said
    good = suggested(LOW, drones=16, algo="dagger", decision_rate=20)
    assert "teacher" not in good
    assert "with 20 decisions per second: --decision-rate 20" in suggested(
        LOW, drones=16, algo="dagger", decision_rate=10
    )


def test_what_is_not_seen_and_collisions():
    said = suggested(LOW, drones=16, num_neighbors=3)
    assert "the policy observes 3 of 15 neighbors: observe more, --neighbors 7" in said
    assert "--algo dagger --dagger.teacher roundabout" in said
    assert "drones collide in 80% of the episodes" in said and "runs/a+filter" in said
    assert "neighbors" not in suggested(LOW, drones=4, num_neighbors=3)
    assert "collide" not in suggested({**LOW, "circle_collision": 0.1})
