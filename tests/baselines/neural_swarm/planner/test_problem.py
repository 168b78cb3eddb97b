"""What cannot be planned is refused before planning, with the reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.problem import shortest_time
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import WAKE, empty_field

STARTS = [[0.0, -1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]]
GOALS = [[0.0, 1.0, 1.0], [0.0, 0.0, 1.5], [0.0, -1.0, 1.0]]
FREE = load("none")


def problem(**changes: Any) -> PlanningProblem:
    options: dict[str, Any] = {
        "starts": STARTS,
        "goals": GOALS,
        "team": "SSL",
        "model": FREE,
        "plane": "yz",
    }
    return PlanningProblem(**(options | changes))


def moved(places, drone, place):
    return [place if i == drone else p for i, p in enumerate(places)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"starts": moved(STARTS, 0, [0, -2.5, 1])}, r"start of drone 0 .* outside the box"),
        ({"goals": moved(GOALS, 1, [0, 1, 1.1])}, r"goals of drones 0 and 1 .* 0\.132 m apart"),
        ({"goals": moved(GOALS, 1, [0.1, 0, 1.5])}, r"plane='yz' keeps x"),
        ({"max_duration": 1.0}, r"drone 0 cannot reach .* at least 1\.31 s"),
        ({"dt": 0.7, "max_duration": 1.39}, r"1 steps of 0\.7 s"),
        ({"team": "SX"}, "unknown vehicle token 'X'"),
        ({"team": "SS"}, r"starts has shape \(3, 3\)"),
        ({"starts": moved(STARTS, 0, [0, np.nan, 1])}, "nan at index"),
        ({"bounds": PlanningBounds(force_g={"S": 5.0})}, "unknown vehicle token 'L'"),
    ],
)
def test_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        problem(**changes)


def test_a_model_without_a_type_of_the_team_is_refused():
    model = InteractionModel("small only", ("S",), empty_field(1)._replace(kind=WAKE))
    with pytest.raises(ValueError, match=r"unknown interaction type 'L'.*'small only'"):
        problem(model=model)


def test_bounds_below_what_hovering_alone_needs_are_refused():
    """Near the ground the learned model lifts a lone drone."""
    low = PlanningBounds(lower=(-2, -2, 0.05), force_g={"L": 0.05})
    with pytest.raises(ValueError, match=r"drone 0 \(L\) hovering alone at its start .* raise"):
        problem(
            starts=[[0, 0, 0.1]], goals=[[0, 0, 1]], team="L", model=load("learned"), bounds=low
        )


def test_starts_and_goals_in_another_wake_are_refused():
    below: dict[str, Any] = {
        "starts": [[0, 0, 1.5], [0, 0, 1.0]],
        "goals": [[0, -1, 1], [0, 1, 1]],
        "team": "SS",
    }
    with pytest.raises(ValueError, match=r"drone 1 \(S\) hovering with the others at its start"):
        problem(**below, model=load("learned"))
    problem(**below, model=FREE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force_g": {"S": 0.0}}, r"force_g\['S'\] is 0.0"),
        ({"clearance_factor": 0.9}, "clearance_factor is 0.9, but must be at least 1"),
        ({"lower": (0, 0, 3)}, "upper must be larger"),
    ],
)
def test_bounds_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        PlanningBounds(**changes)


def test_the_shortest_time_is_that_of_bang_bang():
    """Accelerate at a over half the way d: t = 2 sqrt(d / a), until the speed is at its limit."""
    assert shortest_time(0.5, 2.0, 5.0) == pytest.approx(2 * np.sqrt(0.1))
    assert shortest_time(2.0, 2.0, 5.0) == pytest.approx(2.0 / 2.0 + 2.0 / 5.0)
    assert shortest_time(0.8, 2.0, 5.0) == pytest.approx(0.8)  # where both agree
