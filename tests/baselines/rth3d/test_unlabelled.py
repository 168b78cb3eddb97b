"""Plans whose robots may take any goal: valid by two checkers, and the shortest there are."""

from __future__ import annotations

import json
from itertools import permutations, product

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import (
    GridPlan,
    NoPlanExists,
    PlanTimeout,
    balancing,
    plan,
    validate,
)
from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance
from swarm_envs.baselines.rth3d.unlabelled import bottleneck, unlabelled_bound
from swarm_envs.baselines.rth3d.ways import neighbor_table
from swarm_envs.cli import main
from tests.baselines.rth3d.cases import between, load_checker, maze, random_instance


def plan_set(instance: GridInstance, **options) -> GridPlan:
    given = (instance.starts, instance.goals, instance.shape, instance.obstacles)
    found = plan(*given, labels=False, **options)
    assert found.check() and validate(found.paths, *given, labels=False)
    assert sorted(found.goals.tolist()) == sorted(instance.goals.tolist())
    return found


def cluttered(seed: int, shape: tuple[int, int, int], count: int, part: float) -> GridInstance:
    generator = np.random.default_rng(seed)
    return between(generator.random(shape) < part, count, generator)


def fewest_steps(instance: GridInstance) -> int:
    """By breadth-first search over sets of vertices."""
    free = {tuple(v) for v in np.argwhere(~instance.obstacles).tolist()}
    onward = {v: [u for u in free if np.abs(np.subtract(u, v)).sum() <= 1] for v in free}
    first, last = (frozenset(map(tuple, p.tolist())) for p in (instance.starts, instance.goals))
    reached, steps = {first}, 0
    while last not in reached:
        moved = (product(*(onward[v] for v in state)) for state in reached)
        sets = {frozenset(to) for choices in moved for to in choices}
        reached = {state for state in sets if len(state) == len(first)}
        steps += 1
    return steps


@pytest.mark.parametrize("seed", range(12))
def test_no_plan_of_a_small_grid_is_shorter(seed):
    instance = cluttered(seed, (4, 3, 1) if seed % 2 else (3, 2, 2), 3, 0.25)
    found = plan_set(instance)
    assert found.makespan == found.lower_bound == fewest_steps(instance)
    table = neighbor_table(instance.shape, instance.obstacles)
    assert unlabelled_bound(instance, table) <= found.makespan


def test_the_bottleneck_is_that_of_the_best_permutation():
    generator = np.random.default_rng(3)
    for _ in range(20):
        ways = generator.integers(0, 9, (5, 5)).astype(np.int32)
        best = min(max(ways[range(5), p]) for p in map(list, permutations(range(5))))
        assert bottleneck(ways) == best


def test_random_instances_pass_the_foreign_checker(shared_data):
    checker = load_checker(shared_data)
    cases = [random_instance(seed) for seed in range(40, 55)]
    cases += [cluttered(seed, (16, 8, 4), 60, 0.3) for seed in range(5)]
    cases.append(between(maze(17, np.random.default_rng(0)), 30, np.random.default_rng(1)))
    for instance in cases:
        found = plan_set(instance)
        vertices = np.ravel_multi_index(tuple(found.paths.T.astype(int)), found.shape).T
        report = checker(vertices, found.shape, found.starts, found.goals, found.obstacles)
        assert report["ok"], report
        assert found.winner == "flow" and report["makespan"] == found.makespan == found.lower_bound


def test_the_bound_knows_a_hole_in_a_wall():
    walls = np.zeros((9, 5, 1), dtype=bool)
    walls[4] = True
    walls[4, 2] = False
    free = np.argwhere(~walls)
    instance = check_instance(free[:20], free[-20:], walls.shape, walls)
    bound = unlabelled_bound(instance, neighbor_table(instance.shape, walls))
    found = plan_set(instance)
    assert 20 < bound <= found.makespan <= bound + 2


def test_beyond_the_largest_flow_goals_are_assigned(monkeypatch):
    instance = cluttered(5, (12, 6, 3), 40, 0.2)
    shortest = plan_set(instance)
    monkeypatch.setattr(balancing, "_MOST_NODES", 100)
    found = plan_set(instance)
    assert found.winner.startswith("assigned, then ")
    assert found.lower_bound <= shortest.makespan <= found.makespan
    assert plan_set(instance, method="pibt").winner == "assigned, then pibt"
    same = check_instance(instance.starts, instance.starts[::-1], instance.shape)
    assert plan_set(same, method="pibt").makespan == 0


def test_what_cannot_be_is_refused():
    walls = np.zeros((5, 1, 1), dtype=bool)
    walls[2] = True
    with pytest.raises(NoPlanExists, match="shut 2 robots"):
        plan([[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [4, 0, 0]], walls.shape, walls, labels=False)
    with pytest.raises(PlanTimeout):
        plan([[0, 0]], [[4, 0]], (5, 1), labels=False, time_limit=1e-9)


def test_the_validator_wants_every_goal_taken():
    given = ([[0, 0], [1, 0]], [[3, 0], [2, 0]], (4, 1))
    paths = np.array([[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0, 0]], [[2, 0, 0], [3, 0, 0]]])
    assert validate(paths, *given, labels=False) and not validate(paths, *given)
    report = validate(paths[:2], *given, labels=False)
    assert not report and report.robot == 0 and "end at its goal" in report.reason


def test_the_command_plans_without_labels(tmp_path, capsys):
    asked = ["--grid", "12x9x6", "--robots", "100", "--no-labels", "--out", str(tmp_path)]
    assert main(["plan", *asked]) == 0
    facts = json.loads((tmp_path / "plan.json").read_text())
    found = GridPlan.load(tmp_path / "plan.npz")
    assert facts["labels"] is False and facts["lower_bound"] == found.lower_bound == found.makespan
    assert "ratio 1.000, by flow" in capsys.readouterr().out
