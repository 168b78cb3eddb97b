"""The planning agent: it flies its plans, and refuses what it cannot plan for."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs import formation_v1, ring_v1, swap_v1
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.agent import PlanAgent, bounds_for
from swarm_envs.tasks.obstacles import Column


def test_a_swap_is_planned_and_flown() -> None:
    agent = PlanAgent()
    env = swap_v1.parallel_env(
        num_drones=2, layout="circle", horizon_s=6.5, physics="batch", **agent.requires
    )
    metrics = fly_episode(env, agent, seed=1)
    (plan,) = agent.plans
    assert plan.converged
    assert metrics["success"]
    assert metrics["minimum_separation_m"] > 1.3 * 0.12
    assert plan.model_fingerprint == load_belief().fingerprint
    np.testing.assert_allclose(plan.goals, env.view.goals)


@pytest.mark.slow
@pytest.mark.parametrize("labels", ["random", "nearest"])
def test_a_formation_is_planned_shape_by_shape(labels: str) -> None:
    agent = PlanAgent()
    env = formation_v1.parallel_env(
        num_drones=4, shapes=("plane", "cube", "pyramid"), labels=labels, physics="batch",
        **agent.requires,
    )  # fmt: skip
    metrics = fly_episode(env, agent, seed=0)
    assert metrics["success"]
    assert [plan.converged for plan in agent.plans] == [True, True]
    # A set-point at rest is extrapolated with what rounding has left of the motion.
    np.testing.assert_allclose(agent.plans[1].starts, agent.plans[0].goals, rtol=0, atol=1e-12)


def test_the_plan_does_not_know_what_blows() -> None:
    states = []
    for truth in ("learned", "wake"):
        agent = PlanAgent()
        env = swap_v1.parallel_env(
            team="SL", layout="stacked", physics="batch", interactions=truth, **agent.requires
        )
        env.reset(seed=3)
        agent.reset(env, 3)
        states.append(agent.plans[0].trajectories.states.tobytes())
    assert states[0] == states[1]


def test_what_it_cannot_plan_for_is_refused() -> None:
    agent = PlanAgent()
    given = {"physics": "batch", **agent.requires}
    column = Column(center=(1.0, 1.0), radius=0.1, height=1.0)
    refused = (
        (swap_v1.parallel_env(num_drones=7, **given), "got 7 drones, but plans for at most 6"),
        (ring_v1.parallel_env(num_drones=5, **given), "those of ring_v1 move"),
        (swap_v1.parallel_env(num_drones=2, obstacles=(column,), **given), "avoid obstacles"),
    )
    for env, said in refused:
        env.reset(seed=0)
        with pytest.raises(ValueError, match=said):
            agent.reset(env, 0)
    with pytest.raises(ValueError, match=r"pass env\.view"):
        agent.act({}, None)


def test_bounds_fit_starts_and_goals() -> None:
    """A drone hovering under a large one gets the force bound that hovering there needs."""
    env = swap_v1.parallel_env(team="SL", physics="batch")
    task, model = env.core.task, load_belief()
    apart = np.array([[-0.5, 0.0, 1.0], [0.5, 0.0, 1.0]])
    under = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.5]])
    wide, narrow = bounds_for(task, model, apart, apart), bounds_for(task, model, under, under)
    assert wide.force_g == {"S": 5.0, "L": 10.0}
    assert wide.clearance_factor == 1.6
    assert narrow.force_g["S"] > 5.0
    close = np.array([[0.0, 0.0, 1.0], [0.0, 0.18, 1.0]])
    assert bounds_for(task, model, close, close).clearance_factor == pytest.approx(0.18 / 0.155)
    outside = apart + np.array([1.495, 0.0, 0.0])
    assert bounds_for(task, model, apart, outside).upper[0] == pytest.approx(1.995)
