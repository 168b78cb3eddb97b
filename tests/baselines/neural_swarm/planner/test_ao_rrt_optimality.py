"""Stage 1 comes near optima that are known, and gets cheaper with more iterations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from swarm_envs.baselines.neural_swarm.planner import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig, search
from swarm_envs.baselines.neural_swarm.planner.propagation import INVALID, make_scene, work_for
from swarm_envs.baselines.neural_swarm.planner.search_tree import Chances, grow, search_tree
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

WAY, TIME = 2.0, 3.0  # m, s
START, GOAL, MIDDLE = [0.0, -1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]
EXACT = PlanningBounds(goal_distance=0.01, goal_speed=0.02)  # next to no gain by ending early


def alone(air: str, bounds: PlanningBounds) -> PlanningProblem:
    return PlanningProblem(
        np.array([START]),
        np.array([GOAL]),
        parse_team("S"),
        load(air),
        bounds,
        plane="yz",
        max_duration=TIME,
    )


def lone_optimum(air):
    """Least integral of |u| from rest to rest over d = 2 m in T = 3 s with |u| <= a = 5 m/s^2.

    In air without drag the optimum accelerates at a, coasts at v, brakes at a: d = v (T - v / a),
    v = (a T - sqrt(a^2 T^2 - 4 a d)) / 2 = 0.699 m/s, and the cost is 2 v = 1.399 m/s. With drag,
    rate c / m = g, no flight costs less than two impulses: v + v exp(-g T) with
    v = g d / (1 - exp(-g T)).
    """
    if air == "none":
        return 15.0 - np.sqrt(225.0 - 20.0 * WAY)
    model = load(air)
    rate = model.field.drag[model.types.index("S"), 1] / 0.034
    left = np.exp(-rate * TIME)
    return rate * WAY / (1.0 - left) * (1.0 + left)


def relaxed_optimum(distance, speed):
    """The same without drag, if a flight may end so far before its goal at such a speed w.

    It brakes from v to w only: d = v T - v^2 / 2 a - (v - w)^2 / 2 a, and the cost is 2 v - w.
    """
    way = WAY - distance
    v = brentq(lambda v: v * TIME - 0.1 * v**2 - 0.1 * (v - speed) ** 2 - way, speed, 3.0)
    return 2.0 * v - speed


@pytest.mark.parametrize("air", ["none", "learned"])
def test_a_lone_robot_flies_nearly_the_optimum(air):
    cost = search(alone(air, EXACT), SearchConfig(iterations=4000)).cost
    assert 0.97 * lone_optimum(air) <= cost <= 1.1 * lone_optimum(air)


def test_without_flights_straight_to_the_goal_the_tree_alone_gets_there():
    """Sampled edges and the goal's epsilon alone, as in Algorithm 1."""
    bounds = PlanningBounds()
    config = SearchConfig(iterations=100_000, chances=Chances(goal=0.0))
    costs = [search(alone("none", bounds), config, seed).cost for seed in range(3)]
    optimum = relaxed_optimum(bounds.goal_distance, bounds.goal_speed)
    assert optimum - 1e-9 <= np.median(costs) <= 1.25 * optimum


def replan(problem, states, iterations, seed):
    """AO-RRT of robot 0 alone, tree after tree below the cost before; the others stay as they are.

    Returns its cost, m/s.
    """
    rng, best, planned = np.random.default_rng(seed), np.inf, [1]
    tree, path = search_tree(40_000, 2), np.zeros((len(states), 6))
    while iterations > 0:
        scene = make_scene(problem, 0, states, planned, 2, True)
        bound, most = 0.995 * best, min(2000, iterations)
        cost, used, _ = grow(scene, tree, work_for(scene), bound, most, Chances(), rng, path)
        iterations -= used
        if cost != INVALID:
            best, planned, states[:, 0] = cost, [0, 1], path
    return best


def test_round_a_robot_that_hovers_it_flies_nearly_the_optimum():
    """Midway hovers a robot, from which r = 0.132 m must be kept.

    The cheapest flight of three impulses goes by two tangents of the circle of radius r and turns
    by 2 asin(r) where they meet, at the speed v = (d / sqrt(1 - r^2)) / T: 2 v (1 + r), 1.523 m/s.
    (A turn along the circle costs v 2 asin(r) instead of 2 v r there, which makes no difference.)
    """
    problem = PlanningProblem(
        np.array([START, MIDDLE]),
        np.array([GOAL, MIDDLE]),
        parse_team("SS"),
        load("none"),
        EXACT,
        plane="yz",
        max_duration=TIME,
    )
    r = problem.bounds.clearances(problem.team)[0, 1]
    optimum = 2.0 * WAY / np.sqrt(1.0 - r * r) / TIME * (1.0 + r)
    costs = []
    for seed in range(5):
        states = np.zeros((problem.steps + 1, 2, 6))
        states[:, 1, :3] = MIDDLE
        costs.append(replan(problem, states, 40_000, seed))
    assert 0.95 * optimum <= np.median(costs) <= 1.15 * optimum


@pytest.mark.slow
def test_ten_times_the_iterations_are_cheaper():
    starts = np.array([START, MIDDLE, GOAL])
    problem = PlanningProblem(starts, starts[[2, 0, 1]], parse_team("SLS"), plane="yz")
    few, many = [], []
    for seed in range(20):
        loops = search(problem, SearchConfig(iterations=30_000), seed).loops
        few.append(min(loop.cost for loop in loops if loop.iterations <= 3000))
        many.append(loops[-1].cost)
    assert np.isfinite(few).sum() >= 19
    assert np.median(many) <= 0.85 * np.median(few)
