"""Pictures of plans."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from swarm_envs.baselines.neural_swarm import SwarmPlan, plan_swarm
from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.pipeline import straight_lines
from swarm_envs.baselines.neural_swarm.planner.plan_plot import plot_plan
from swarm_envs.baselines.neural_swarm.planner.problem import Plane
from swarm_envs.baselines.neural_swarm.planner.scp import RefinementOptions
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

PAIR = np.array([[0.0, -0.6, 1.0], [0.0, 0.6, 1.0]])


def rough(plane: Plane, model: str = "learned", team: str = "SL") -> SwarmPlan:
    """A plan of one sweep: pictures do not ask for more."""
    problem = PlanningProblem(PAIR, PAIR[::-1], parse_team(team), load(model), plane=plane)
    guess = straight_lines(problem, bend=[[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]])
    few = RefinementOptions(max_sweeps=1)
    return plan_swarm(PAIR, PAIR[::-1], team, model, plane=plane, initial=guess, options=few)


@pytest.mark.parametrize("plane", ["yz", "xyz"])
def test_a_plan_is_drawn_beside_an_unaware_one(tmp_path, plane: Plane) -> None:
    path = tmp_path / "plan.png"
    plan = rough(plane)
    plot_plan(path, plan)
    alone = np.asarray(Image.open(path).convert("RGB"))
    plot_plan(path, plan, rough(plane, "none"), load("learned"))
    beside = np.asarray(Image.open(path).convert("RGB"))
    assert beside.shape[1] > 1.3 * alone.shape[1]
    red = (abs(beside.astype(int) - np.array([0xC0, 0x39, 0x2B])).sum(axis=2) < 30).sum()
    assert red > 50  # arrows of forces


def test_an_unaware_plan_needs_a_model_and_the_same_team(tmp_path) -> None:
    plan = rough("yz")
    with pytest.raises(ValueError, match="no model"):
        plot_plan(tmp_path / "plan.png", plan, rough("yz", "none"))
    with pytest.raises(ValueError, match="'SS', but the plan of 'SL'"):
        plot_plan(tmp_path / "plan.png", plan, rough("yz", "none", "SS"), load("learned"))
    assert not list(tmp_path.iterdir())
