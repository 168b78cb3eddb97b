"""Plans: valid by two checkers, within bounds."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from PIL import Image

from swarm_envs.baselines.rth3d import (
    METHODS,
    GridPlan,
    PlanNotFound,
    PlanTimeout,
    building_columns,
    make_instance,
    max_density,
    pibt_search,
    plan,
    terrain,
    validate,
)
from swarm_envs.baselines.rth3d.compaction import compact
from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance, numbers, points
from swarm_envs.baselines.rth3d.grid_plan import plot_grid_plan
from swarm_envs.baselines.rth3d.path_lengths import neighbor_table
from swarm_envs.baselines.rth3d.unlabeled_mrpp import balance
from tests.baselines.rth3d.cases import between, load_checker, random_instance

SLOW = pytest.mark.slow


def judge(found: GridPlan, checker) -> None:
    """Both checkers, ours and the foreign one."""
    assert found.valid and found.check()
    report = checker(found, found.paths)
    assert report["ok"], report
    assert report["lb"] <= found.lower_bound <= found.makespan
    assert report["makespan"] == found.makespan


SEEDS = [range(4), *(pytest.param(range(k, k + 100), marks=SLOW) for k in range(1000, 2000, 100))]


@pytest.mark.parametrize("seeds", SEEDS)
def test_random_instances_by_every_method(seeds, shared_data):
    checker = load_checker(shared_data)
    for seed in seeds:
        instance = random_instance(seed)
        makespans = {}
        for method in METHODS:
            try:
                found = plan(**instance.fields(), method=method, seed=seed)
            except PlanNotFound:
                assert method == "pibt"
                continue
            judge(found, checker)
            makespans[method] = found.makespan
            if found.bound is not None:
                assert found.makespan <= found.bound
        assert {"rth3d", "rth3d-lba", "auto"} <= set(makespans)
        parts = [makespans[name] for name in ("pibt", "rth3d-lba") if name in makespans]
        assert makespans["auto"] <= min(parts)


def test_the_same_seed_gives_the_same_plan():
    instance = make_instance("uniform", (12, 9, 7), 200, seed=3)
    for method in METHODS:
        first, second = (plan(**instance.fields(), method=method, seed=5) for _ in range(2))
        assert first.paths.tobytes() == second.paths.tobytes()
        assert first.paths.dtype == np.int16


def test_before_compaction_the_makespan_obeys_the_paper_s_bound():
    """m1 + 2 m2 + 2 m3 + o(m1) of Proposition IV.2, with the constant that is claimed."""
    for shape in [(12, 6, 3), (24, 12, 6), (48, 24, 12)]:
        m1, m2, m3 = shape
        for method in ("rth3d", "rth3d-lba"):
            found = plan(**make_instance("uniform", shape, seed=1).fields(), method=method)
            steps = {phase.name: phase.makespan for phase in found.phases}
            balancing = steps["balance starts"] + steps["balance goals"]
            assert found.bound is not None and found.before_compaction is not None
            assert found.bound == m1 + 2 * m2 + 2 * m3 + 9 + balancing
            assert found.makespan <= found.before_compaction <= found.bound


@pytest.mark.parametrize(
    ("family", "most", "shapes"),
    [
        ("quasi-random", 1.4, [(12, 6, 3), (24, 12, 6), (48, 24, 12)]),
        ("mirror", 1.15, [(12, 6, 3), (24, 12, 6), (48, 24, 12)]),
        ("rings", 1.15, [(12, 12, 6), (24, 24, 12), (48, 48, 24)]),
    ],
)
def test_the_ratio_falls_with_size(family, most, shapes):
    """Sec. V-C: that of rings and mirrors goes to 1, as equal sets are balanced alike."""
    ratios = []
    for shape in shapes:
        instance = make_instance(family, shape, seed=1 if family == "mirror" else 2)
        small = plan(**instance.fields(), method="rth3d-lba")
        ratios.append(small.ratio)
        if family == "quasi-random":
            other = plan(**instance.fields(), method="rth3d")
            assert small.before_compaction is not None and other.before_compaction is not None
            assert small.before_compaction < other.before_compaction
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] <= most


def test_pibt_alone_may_find_no_plan(monkeypatch):
    """Its attempts must end before all can have arrived; `auto` then has RTH3D's."""
    monkeypatch.setattr(pibt_search, "_PATIENCE", 0.6)
    monkeypatch.setattr(pibt_search, "_MARGIN", 0)
    instance = make_instance("mirror", (12, 6, 3), seed=0)
    with pytest.raises(PlanNotFound, match=r"no plan of at most 10 steps \(lower bound 18\)"):
        plan(**instance.fields(), method="pibt")
    best, sure = (plan(**instance.fields(), method=name) for name in ("auto", "rth3d-lba"))
    assert best.valid
    assert best.makespan <= sure.makespan


def test_a_flat_grid_and_one_on_its_side():
    rng = np.random.default_rng(0)
    vertices = np.argwhere(np.ones((12, 9), dtype=bool))
    starts, goals = rng.permutation(vertices)[:36], rng.permutation(vertices)[:36]
    flat = plan(starts, goals, (12, 9), method="rth3d-lba")
    assert flat.paths.shape[2] == 3 and not flat.paths[..., 2].any()
    begin, end = (np.column_stack([p[:, :1] * 0, p]) for p in (starts, goals))
    turned = plan(begin, end, (1, 12, 9), method="rth3d-lba")
    assert turned.makespan == flat.makespan


def test_nobody_has_to_move():
    starts = np.argwhere(np.ones((3, 3, 3), dtype=bool))[:9]
    for method in METHODS:
        found = plan(starts, starts, (3, 3, 3), method=method)
        assert (found.makespan, found.ratio, found.bound) == (0, 1.0, 0)


def test_few_robots_reach_the_bound():
    found = plan(**make_instance("uniform", (24, 12, 6), 20, seed=1).fields())
    assert found.ratio <= 1.02


@pytest.mark.parametrize(
    ("shape", "obstacles", "density"),
    [
        ((9, 6, 3), None, 1 / 3),
        ((12, 9, 6), building_columns((12, 9, 6)), 2 / 9),
        ((4, 4, 4), None, 3 * 4 / 64),
        ((8, 9, 5), None, 3 * 2 * 3 * 5 / 360),
        ((5, 5, 2), building_columns((5, 5, 2)), 2 * 2 / 50),
        ((2, 9, 2), None, 0.0),
    ],
)
def test_what_the_highways_carry(shape, obstacles, density):
    assert max_density(shape, obstacles) == pytest.approx(density)
    most = round(density * np.prod(shape))
    if most == 0:
        return
    free = np.argwhere(np.ones(shape, dtype=bool) if obstacles is None else ~obstacles)
    rng = np.random.default_rng(1)
    starts, goals = rng.permutation(free)[:most], rng.permutation(free)[:most]
    assert plan(starts, goals, shape, obstacles, method="rth3d-lba").valid
    more = free[: most + 1], free[-most - 1 :]
    with pytest.raises(ValueError, match=rf"carry {most} at most"):
        plan(*more, shape, obstacles, method="rth3d-lba")
    assert plan(*more, shape, obstacles, method="auto").valid


STARTS, GOALS = [[0, 0, 0], [1, 0, 0]], [[2, 0, 0], [2, 1, 0]]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"starts": [[0, 0, 0], [0, 0, 0]]}, r"starts\[0\] and starts\[1\] are both \(0, 0, 0\)"),
        ({"goals": [[2, 2, 2], [2, 2, 2]]}, r"goals\[0\] and goals\[1\]"),
        ({"goals": [[2, 0, 0], [2, 6, 0]]}, r"goals\[1\] is \(2, 6, 0\), which is outside"),
        ({"starts": [[0, 0, 0], [-1, 0, 0]]}, r"starts\[1\] is \(-1, 0, 0\)"),
        ({"goals": [[2, 0, 0]]}, "2 starts, but 1 goals"),
        ({"starts": [[0.0, 0, 0], [1, 0, 0]]}, "must be integers"),
        ({"starts": np.zeros((0, 3), int)}, "at least one robot"),
        ({"shape": (6, 6), "goals": [[2, 0, 1], [2, 1, 1]]}, "outside the grid|must be"),
        ({"shape": (6, 0, 6)}, "shape is"),
        ({"shape": (2, 3, 1), "goals": [[1, 1, 0], [1, 2, 0]]}, "too thin"),
        ({"method": "rthd"}, "did you mean 'rth3d'"),
        ({"seed": -1}, "seed is -1"),
        ({"time_limit": 0.0}, "time_limit is 0.0"),
        ({"time_limit": True}, "time_limit is True"),
        ({"obstacles": np.zeros((6, 6, 5), dtype=bool)}, "obstacles have shape"),
        ({"obstacles": np.zeros((6, 6, 6))}, "must be booleans"),
    ],
)
def test_bad_input_is_refused_with_the_reason(given, said):
    full = {"starts": STARTS, "goals": GOALS, "shape": (6, 6, 6), "method": "rth3d-lba"} | given
    with pytest.raises(ValueError, match=said):
        plan(**full)


def test_obstacles_outside_the_pattern_are_named():
    walls = np.zeros((6, 6, 6), dtype=bool)
    walls[3, 4] = True
    with pytest.raises(ValueError, match="at x = 3, y = 4, but obstacles may only stand at"):
        plan(STARTS, GOALS, (6, 6, 6), walls, method="rth3d-lba")
    walls[:] = False
    walls[1, 4, :5] = True
    with pytest.raises(ValueError, match="leaves z = 5 free"):
        plan(STARTS, GOALS, (6, 6, 6), walls, method="rth3d-lba")
    walls[1, 4] = True
    with pytest.raises(ValueError, match=r"starts\[1\] is \(1, 4, 0\), but there is an obstacle"):
        plan([[0, 0, 0], [1, 4, 0]], GOALS, (6, 6, 6), walls)


def test_a_time_limit_gives_a_valid_plan_or_an_exception():
    instance = make_instance("mirror", (24, 12, 6), seed=0)
    plan(**instance.fields(), method="rth3d-lba")  # compiles
    for limit in (1e-9, 1e-3, 3e-3, 1e-2, 3e-2, 10.0):
        for method in ("rth3d-lba", "auto"):
            try:
                found = plan(**instance.fields(), method=method, time_limit=limit)
            except PlanTimeout as error:
                assert "time limit" in str(error)
            else:
                assert validate(found.paths, **instance.fields()) and limit > 1e-9


def test_pibt_goes_around_any_obstacle():
    """A wall with a door: no straight way leads through, and ways are searched."""
    walls = np.zeros((9, 7, 4), dtype=bool)
    walls[4] = True
    walls[4, 3, 0] = False
    starts = np.argwhere(~walls[:4])[:6]
    goals = np.argwhere(~walls)[-6:]
    found = plan(starts, goals, walls.shape, walls, method="pibt")
    assert validate(found.paths, starts, goals, walls.shape, walls).ok
    with pytest.raises(ValueError, match="may only stand at"):
        plan(starts, goals, walls.shape, walls, method="rth3d-lba")
    walls[4, 3, 0] = True
    with pytest.raises(ValueError, match="robot 0 cannot get from"):
        plan(starts, goals, walls.shape, walls, method="pibt")


SHAPE = (12, 9, 5)


@pytest.mark.parametrize("walls", [np.zeros(SHAPE, dtype=bool), building_columns(SHAPE)])
def test_reflected_goals_skip_the_first_shuffles(walls):
    free = np.argwhere(~walls).astype(np.int32)
    starts = np.random.default_rng(0).permutation(free)[: int(0.2 * walls.size)]
    found = [make_instance("rings", (12, 12, 6))]  # of which any reflection keeps the set
    for flips in list(product((False, True), repeat=3))[1:]:
        goals = np.where(flips, np.array(SHAPE) - 1 - starts, starts).astype(np.int32)
        found.append(GridInstance(SHAPE, starts, goals, walls))
    for instance in found:
        phases = plan(**instance.fields(), method="rth3d-lba").phases
        steps = {phase.name: phase.makespan for phase in phases}
        assert steps["heights"] == steps["rows"] == 0
        assert steps["balance starts"] == steps["balance goals"]


def test_a_plan_is_drawn(tmp_path):
    found = plan(**make_instance("uniform", (12, 9, 6), 130, seed=1).fields())
    plot_grid_plan(tmp_path / "plan.png", found)
    with Image.open(tmp_path / "plan.png") as picture:
        assert picture.size == (1210, 572)


def test_compaction_gives_back_the_steps_that_it_saves():
    paths = np.array([[0, 5], [0, 5], [1, 5], [1, 5], [2, 4], [2, 4]], dtype=np.int32)
    found = compact(paths, 6)
    assert found.tolist() == [[0, 5], [1, 4], [2, 4]] and found.flags.owndata


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
def test_balancing_takes_the_fewest_steps(seed):
    """Any robot may take any goal: UnlabeledMRPP of the paper."""
    instance = cluttered(seed, (4, 3, 1) if seed % 2 else (3, 2, 2), 3, 0.25)
    table = neighbor_table(instance.shape, instance.obstacles)
    sinks = np.zeros(len(table), dtype=bool)
    sinks[numbers(instance.goals, instance.shape)] = True
    paths = balance(table, numbers(instance.starts, instance.shape), sinks)
    assert sinks[paths[-1]].all() and len(paths) - 1 == fewest_steps(instance)
    ends = points(paths[-1], instance.shape)
    assert validate(points(paths, instance.shape), **replace(instance, goals=ends).fields())


@pytest.mark.parametrize("method", ["pibt", "lacam"])
def test_only_free_vertices_take_memory(monkeypatch, method):
    """As in large buildings, of which most is wall."""
    walls = np.ones((60, 46, 1), dtype=bool)
    walls[20:40, 40:] = False
    starts = np.array([[20 + k, 40, 0] for k in range(12)])
    goals = np.array([[39 - k, 45, 0] for k in range(12)])
    given = check_instance(starts, goals, walls.shape, walls).fields()
    monkeypatch.setattr(terrain, "_MOST_LENGTHS", 12 * 120)
    assert validate(plan(**given, method=method).paths, **given)
    monkeypatch.setattr(terrain, "_MOST_LENGTHS", 12 * 120 - 1)
    with pytest.raises(ValueError, match="of 12 robots on 120 vertices, but at most 1439 lengths"):
        plan(**given, method=method)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("unifrom", (6, 6, 6), 5), "did you mean 'uniform'"),
        (("uniform", (5, 5, 5), 126), "count is 126, but"),
        (("mirror", (8, 8, 8), 4), "shape is (8, 8, 8), but every"),
    ],
)
def test_what_no_instance_has_is_refused(given, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        make_instance(*given)
