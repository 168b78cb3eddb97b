"""Crowd, pursuit, swap: where starts, sites and goals are and what the score is, by geometry."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import fly_episode, load
from swarm_envs.agents.evaluation import score_episodes
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.state import FloatArray
from swarm_envs.tables import World
from swarm_envs.tasks.base import ByScore, Placement, world_of
from swarm_envs.tasks.crowd import CROWD_LAYOUTS, CrowdTask, crowd_obstacles, next_site
from swarm_envs.tasks.obstacles import Box, Column
from swarm_envs.tasks.placing import arena_of, check_points, derangement, draw_apart
from swarm_envs.tasks.pursuit import PURSUIT_LAYOUTS, PursuitTask
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import parse_team


def crowd(**options: Any) -> SwarmParallelEnv:
    return swarm_envs.make("crowd_v0", **{"physics": "batch", **options})


def apart(points: FloatArray) -> float:
    """Smallest distance between two of the points (N, 3)."""
    away = np.linalg.norm(points[:, None] - points, axis=-1)
    return float(away[np.triu_indices(len(points), 1)].min())


def beside(obstacle: Box | Column, points: FloatArray) -> FloatArray:
    """Level distance (N,) to an obstacle that reaches from floor to ceiling."""
    if isinstance(obstacle, Column):
        away: FloatArray = np.linalg.norm(points[:, :2] - obstacle.center, axis=1)
        return away - obstacle.radius
    low, high = np.array(obstacle.low[:2]), np.array(obstacle.high[:2])
    outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))


@pytest.mark.parametrize("layout", CROWD_LAYOUTS)
@pytest.mark.parametrize("n", [1, 16, 40])
def test_sites_are_apart_and_free(layout, n):
    task = CrowdTask(parse_team("S" * n), layout=layout)
    low, high = task.arena
    starts = []
    for seed in range(8):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        sites = goals.reshape(-1, 3)
        assert len(sites) == 3 * n and apart(sites) >= 0.5
        assert {tuple(p) for p in start} <= {tuple(p) for p in sites}
        assert (sites[:, 2] >= 0.5).all()
        assert (np.minimum(sites - low, high - sites) >= 0.3 - 1e-9).all()
        for obstacle in task.obstacles:
            assert beside(obstacle, sites).min() >= 0.15 + task.radius[0]
        starts.append(start)
    spread = np.concatenate(starts).std(axis=0) / (high - low)
    if n > 1:
        assert (spread > [0.2, 0.2, 0.12]).all()  # of an even draw: 0.25, 0.25, 0.17


def test_density_is_that_of_sixteen():
    for layout in ("forest", "buildings"):
        few, many = (len(crowd_obstacles(layout, n)) for n in (16, 128))
        assert 4 <= many / few <= 7  # four times the ground
    given = Column((0.0, 0.0), 0.1)
    task = CrowdTask(parse_team("SSSS"), layout="open", obstacles=(given,))
    assert task.obstacles == task.with_team(parse_team("LLLL")).obstacles == (given,)
    forest = CrowdTask(parse_team("SSSS"))
    assert forest.with_team(parse_team("LLLL")).obstacles == forest.obstacles


@pytest.mark.parametrize("reach_m", [(1.0, 3.0), (1.0, 1.6)])
def test_goals_reached_are_counted_as_by_hand(reach_m):
    """Flown by a script, and followed from outside by positions and goals alone."""
    agent = load("straight-line+filter")
    env = crowd(num_drones=6, layout="open", reach_m=reach_m, horizon_s=10.0, **agent.requires)
    observations, _ = env.reset(seed=3)
    agent.reset(env, 3)
    core, count, by_reward = env.core, 0, 0.0
    sites = {tuple(p) for p in core.world.goals[0].reshape(-1, 3)}
    while env.agents:
        before = env.view.goals.copy()
        observations, _, _, _, infos = env.step(agent.act(observations, env.view))
        position, after = env.view.state.position, env.view.goals
        reached = np.linalg.norm(position - before, axis=1) < 0.15
        count += int(reached.sum())
        by_reward += sum(info["reward_terms"]["reached"] for info in infos.values())
        np.testing.assert_array_equal((after != before).any(axis=1), reached)
        assert {tuple(p) for p in after} <= sites and apart(after) >= 0.5
        free = core.world.goals[0, 1:].reshape(-1, 3)
        for i in reached.nonzero()[0]:
            assert env.view.reference(env.view.time).position[i].tolist() == after[i].tolist()
            away = np.linalg.norm(np.vstack([free, after[i]]) - position[i], axis=1)
            fits = (away >= reach_m[0]) & (away <= reach_m[1])
            assert fits[-1] or not fits.any() or tuple(before[i]) in {tuple(p) for p in free[fits]}
    metrics = infos["drone_0"]["episode_metrics"]
    assert metrics["goals_reached"] == count == by_reward > 10
    assert metrics["length_s"] == pytest.approx(10.0)
    assert metrics["throughput_per_min"] == pytest.approx(count / 6 / (10.0 / 60.0))
    report = score_episodes([{"seed": 3, "metrics": metrics, "act_us": [1]}])
    assert report["throughput_per_min"] == metrics["throughput_per_min"]


def test_the_next_site_is_free_and_any_of_those_within_reach():
    rng = np.random.default_rng(0)
    goals = rng.uniform(-2.0, 2.0, (3, 5, 3))
    flat, position = goals.reshape(-1, 3), np.zeros(3)
    away = np.linalg.norm(flat, axis=1)
    fits = {k for k in range(5, 15) if 1.0 <= away[k] <= 2.4}
    drawn = {int(next_site(position, goals, 1.0, 2.4, u)) for u in rng.uniform(size=300)}
    assert drawn == fits and 2 <= len(fits) < 10
    drawn = {int(next_site(position, goals, 9.0, 9.5, u)) for u in rng.uniform(size=300)}
    assert drawn == set(range(5, 15))


@pytest.mark.parametrize(("least", "won"), [(6.0, True), (60.0, False)])
def test_success_is_a_throughput_at_the_clock(least, won):
    task = CrowdTask(parse_team("S"), layout="open", success=ByScore(0.15, least))
    agent = load("straight-line")
    env = SwarmParallelEnv(task, crowd(horizon_s=10.0, **agent.requires).core.config)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    while env.agents:
        observations, _, ends, truncations, infos = env.step(agent.act(observations, None))
    metrics = infos["drone_0"]["episode_metrics"]
    assert metrics["success"] is won and metrics["stages_reached"] == won
    assert truncations["drone_0"] and not ends["drone_0"]
    assert infos["drone_0"]["reward_terms"]["success"] == won


@pytest.mark.parametrize("on_contact", ["end_pair", "bounce"])
@pytest.mark.parametrize("task", ["crowd_v0", "pursuit_v0"])
def test_no_score_is_a_success_once_a_drone_is_hurt(task, engine, on_contact):
    """One of four is flown into the floor: no more is asked of the score than zero."""
    agent, given = load("hover"), {"physics": engine, "on_contact": on_contact}
    given |= {"num_drones": 4, "horizon_s": 3.0, **agent.requires}
    layout = "open" if task == "crowd_v0" else "moving"
    made = swarm_envs.make(task, layout=layout, **given)
    easy: Any = dataclasses.replace(cast(Any, made.core.task), success=ByScore(0.15, 0.0))
    for falls in (True, False):
        env = SwarmParallelEnv(easy, made.core.config)
        observations, _ = env.reset(seed=0)
        agent.reset(env, 0)
        while env.agents:
            actions = agent.act(observations, None)
            if falls and "drone_2" in actions:
                actions["drone_2"] = np.array([0.0, 0.0, -1.0], np.float32)
            observations, *_, infos = env.step(actions)
        metrics = infos["drone_0"]["episode_metrics"]
        assert (metrics["collided_floor"] == 1) is falls
        assert metrics["success"] is not falls and metrics["stages_reached"] == (not falls)
        assert infos["drone_0"]["reward_terms"]["success"] == (not falls)


every_layout = pytest.mark.parametrize("layout", PURSUIT_LAYOUTS)
AGENTS = {"moving": "tracking", "swap-goals": "straight-line+filter", "chase": "tracking"}


def pursuit(layout: str, agent: Any, **options: Any) -> SwarmParallelEnv:
    given = {"physics": "batch", "layout": layout, "num_drones": 4, "horizon_s": 7.0}
    return swarm_envs.make("pursuit_v0", **{**given, **agent.requires, **options})


def flown(layout: str, seed: int, **options: Any) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Positions (T, N, 3), goals (T, N, 3) after each decision, and the metrics at the end."""
    agent = load(AGENTS[layout])
    env = pursuit(layout, agent, **options)
    positions, goals = [], []

    def watch(env: SwarmParallelEnv) -> None:
        positions.append(env.view.state.position.copy())
        goals.append(env.view.goals.copy())

    metrics = fly_episode(env, agent, seed, watch)
    return np.array(positions), np.array(goals), metrics


@every_layout
def test_the_score_is_the_share_of_time_near_the_goals(layout):
    positions, goals, metrics = flown(layout, seed=2)
    near = np.linalg.norm(positions - goals, axis=-1)[1:] < 0.2
    assert metrics["length_s"] == pytest.approx(7.0)
    assert metrics["share_on_goal"] == pytest.approx(near.mean())
    assert 0.1 < near.mean() <= 1.0
    least = 0.5 if layout == "swap-goals" else 0.9
    assert metrics["success"] == (near.mean() >= least and metrics["collided_drones"] == 0)


@pytest.mark.parametrize(
    ("task", "name", "options"),
    [
        ("swap_v1", "straight-line", {"team": "LSS*", "layout": "circle"}),  # they collide
        ("crowd_v0", "straight-line", {"num_drones": 1, "layout": "open"}),
        ("pursuit_v0", "straight-line+filter", {"layout": "swap-goals", "change_s": 1.0}),
    ],
)
def test_progress_is_of_the_goal_that_was_flown_to(task, name, options):
    """Also in the decision in which a goal is reached or swapped, after which the next is far."""
    agent, reached = load(name), 0.0
    env = swarm_envs.make(task, physics="batch", horizon_s=10.0, **options, **agent.requires)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    while env.agents:
        goals, before = env.view.goals.copy(), env.view.state.position.copy()
        observations, *_, infos = env.step(agent.act(observations, env.view))
        after = np.linalg.norm(env.view.state.position - goals, axis=1)
        covered = (np.linalg.norm(before - goals, axis=1) - after) / 2.0
        for i, info in enumerate(infos.values()):
            assert info["reward_terms"]["progress"] == pytest.approx(covered[i], abs=1e-12)
            reached += info["reward_terms"].get("reached", 0.0)
    assert reached >= 3.0 or task != "crowd_v0"
    assert env.core.metrics()["collided_drones"] or task != "swap_v1"


def test_who_ends_is_on_no_goal_any_more():
    """Everybody falls: what counts is the time before."""
    env = swarm_envs.make("pursuit_v0", physics="batch", num_drones=2, action="rotors")
    env.reset(seed=0)
    near = 0.0
    while env.agents:
        fly = set(env.agents)
        env.step({agent: np.full(4, -1.0) for agent in env.agents})
        away = np.linalg.norm(env.view.state.position - env.view.goals, axis=-1)
        near += sum(away[int(name[-1])] < 0.2 for name in fly & set(env.agents))
    metrics = env.core.metrics()
    assert metrics["collided_floor"] == 2 and not metrics["success"]
    assert metrics["share_on_goal"] == pytest.approx(near / 2 / (20.0 * 48))


@pytest.mark.parametrize("layout", ["moving", "chase"])
@pytest.mark.parametrize("n", [1, 8, 32])
def test_goals_on_ellipses_are_apart_inside_and_as_fast_as_drawn(layout, n):
    task = PursuitTask(parse_team("S" * n), layout=layout, speed_m_s=(1.0, 1.0))
    low, high = task.arena
    for seed in range(6):
        placed = task.place(np.random.default_rng(seed))
        start, goals, orbit, chased = placed.start, placed.goals, placed.orbit, placed.chased
        assert orbit is not None
        np.testing.assert_allclose(start, goals[0])
        assert n == 1 or apart(start) >= 0.4 - 1e-9
        assert (np.minimum(start - low, high - start) > 0.29).all()
        leads = np.ones(n, np.bool_) if chased is None else chased < 0
        assert leads.sum() == (n if layout == "moving" else 1)
        angles = np.linspace(0.0, 2.0 * np.pi, 2000)
        i = int(leads.argmax())
        way = np.outer(np.cos(angles), orbit.first[i]) + np.outer(np.sin(angles), orbit.second[i])
        speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / (angles[1] / abs(orbit.rate[i]))
        assert speed.max() == pytest.approx(1.0, rel=0.04)  # or a little more, where it climbs
        carried = start - start[i] + orbit.center[i] + way[:, None]
        assert (np.minimum(carried - low, high - carried) > 0.29).all()


def test_chasers_goals_are_beside_others_wherever_these_are():
    agent = load("hover")
    env = pursuit("chase", agent, num_drones=6)
    env.reset(seed=4)
    start, goals = env.view.state.position.copy(), env.view.goals.copy()
    np.testing.assert_allclose(start, goals, atol=1e-9)
    chased = env.core.world.drones["chased"][0].astype(int)
    assert (chased >= 0).sum() == 5
    for i in range(6):  # nobody chases himself, not even over others
        seen = {i}
        while chased[i] >= 0:
            i = chased[i]
            assert i not in seen
            seen.add(i)
    follows = chased >= 0
    offset = (goals - start[chased])[follows]
    drift = {a: np.array([0.3, 0.1 * k, 0.0], np.float32) for k, a in enumerate(env.agents)}
    for _ in range(40):
        env.step(drift)
        state = env.view.state
        reference = env.view.reference(env.view.time)
        expected = state.position[chased][follows] + offset
        np.testing.assert_allclose(env.view.goals[follows], expected, atol=1e-12)
        np.testing.assert_array_equal(reference.velocity[follows], state.velocity[chased][follows])
    assert np.linalg.norm(env.view.state.position - start, axis=1).min() > 0.1


def test_goals_beside_others_are_drawn_free_of_obstacles():
    """Goals of chasers move with the drones that they chase: their place at the start counts."""
    task = PursuitTask(parse_team("SSSS"), layout="chase", obstacles=(Column((0.0, 0.0), 0.2),))
    for seed in range(2):
        start, *_ = task.place(np.random.default_rng(seed))
        assert (np.linalg.norm(start[:, :2], axis=1) > 0.2 + 0.15 + task.radius).all()


def test_swapped_goals_are_always_anothers():
    task = PursuitTask(parse_team("SSSSS"), layout="swap-goals", change_s=4.0)
    for seed in range(10):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        assert goals.shape == (5, 5, 3) and apart(start) >= 0.4
        for before, after in zip([start, *goals], goals, strict=False):
            assert {tuple(p) for p in before} == {tuple(p) for p in after}
            assert (before != after).any(axis=1).all()
    given = goals[0] + [0.0, 0.0, 0.1]
    start, kept, *_ = task.place(np.random.default_rng(0), goal=given)
    np.testing.assert_array_equal(kept[0], given)
    _, seen, _ = flown("swap-goals", 0, change_s=2.0, horizon_s=7.0)
    changes = (np.diff(seen, axis=0) != 0.0).any(axis=-1)
    assert changes.all(axis=1).nonzero()[0].tolist() == [95, 191, 287]
    with pytest.raises(ValueError, match="in 'chase' goals move; leave it out"):
        PursuitTask(parse_team("S"), layout="chase").place(np.random.default_rng(0), goal=start[:1])


SEEDS = range(20)


def drawn_swap(task: SwapTask, seed: int) -> Placement:
    return task.place(np.random.default_rng(seed))


def at(task: SwapTask, world: World, time: float) -> Reference:
    full = task.reference(world, np.array([time]))
    return Reference(*(array[0] for array in full))


@pytest.mark.parametrize("team", ["S", "LS", "SSL", "LSS*S", "SSSSS"])
def test_stacked_stands_on_a_cylinder_in_the_order_of_the_team(team):
    task = SwapTask(team=parse_team(team), layout="stacked")
    radii, gaps, times = [], [], []
    for seed in SEEDS:
        start, (goal,), duration, *_ = drawn_swap(task, seed)
        radius = np.hypot(start[:, 0], start[:, 1])
        np.testing.assert_allclose(radius, radius[0], rtol=1e-12)
        assert start[-1, 2] == pytest.approx(0.8)
        if len(start) > 1:
            step = -np.diff(start[:, 2])  # from the top down
            np.testing.assert_allclose(step, step[0], rtol=1e-9)
            gaps.append(step[0])
        np.testing.assert_allclose(goal, start * [-1, -1, 1], atol=1e-12)  # the opposite side
        angle = np.sort(np.arctan2(start[:, 1], start[:, 0]) % (2 * np.pi))
        apart = np.diff([*angle, angle[0] + 2 * np.pi])
        np.testing.assert_allclose(apart, 2 * np.pi / len(start), atol=1e-9)
        radii.append(radius[0])
        times.append(duration)
        for points in (start, goal):
            check_points("start", points, np.full(len(start), 0.095), arena_of(len(start)))
    for values, low, high in ((radii, 0.5, 0.75), (gaps, 0.2, 0.3), (times, 3.0, 4.0)):
        if values:
            assert low <= min(values) < low + 0.2 * (high - low)
            assert high - 0.2 * (high - low) < max(values) <= high


def test_stacked_reference_aligns_all_half_way():
    """Of a line whose derivatives tests/tasks/test_motion.py compares with the formula."""
    task = SwapTask(team=parse_team("LSS"), layout="stacked")
    for seed in SEEDS:
        placement = drawn_swap(task, seed)
        world = world_of(placement)
        middle = at(task, world, placement.duration / 2)
        np.testing.assert_allclose(middle.position[:, :2], 0.0, atol=1e-12)
        np.testing.assert_array_equal(at(task, world, 0.0).position, placement.start)
        np.testing.assert_array_equal(at(task, world, 99.0).position, placement.goals[0])


@pytest.mark.parametrize("n", [1, 2, 4, 16, 40])
def test_random_starts_are_apart_and_goals_deranged(n):
    task = SwapTask(team=parse_team("S" * n))
    grown = max(1.0, (n / 16) ** (1 / 3))
    np.testing.assert_allclose(task.arena, np.array([[-2, -2, 0], [2, 2, 2.5]]) * grown)
    for seed in SEEDS if n < 40 else range(3):
        start, (goal,), duration, *_ = drawn_swap(task, seed)
        assert duration == 0.0
        assert start.shape == goal.shape == (n, 3)
        assert (np.abs(start[:, :2]) <= 2.0 * grown - 0.3).all()
        assert (start[:, 2] >= 0.5).all()
        assert (start[:, 2] <= 2.0 * grown).all()
        distance = np.linalg.norm(start[:, None] - start[None], axis=2) + 9.0 * np.eye(n)
        assert distance.min() >= 0.5
        own = np.linalg.norm(goal - start, axis=1)
        assert own.min() >= 0.5  # nobody is at its goal already
        if n > 1:
            places = np.argmin(np.linalg.norm(goal[:, None] - start[None], axis=2), axis=1)
            assert sorted(places) == list(range(n))
            np.testing.assert_array_equal(start[places], goal)


def test_random_fills_its_box():
    task = SwapTask(team=parse_team("SSSS"))
    points: FloatArray = np.concatenate([drawn_swap(task, seed).start for seed in range(200)])
    np.testing.assert_allclose(points.min(axis=0), [-1.7, -1.7, 0.5], atol=0.05)
    np.testing.assert_allclose(points.max(axis=0), [1.7, 1.7, 2.0], atol=0.05)


def test_overfull_boxes_raise_instead_of_searching_for_ever():
    task = SwapTask(team=parse_team("S" * 16), spacing_m=2.0)
    with pytest.raises(RuntimeError, match=r"found room for \d+ of 16 drones 2.0 m apart .* use"):
        drawn_swap(task, 0)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_derangements_leave_nothing_in_its_place(n):
    rng = np.random.default_rng(0)
    orders = [tuple(derangement(rng, n)) for _ in range(300)]
    for order in orders:
        assert sorted(order) == list(range(n))
        assert all(order[i] != i for i in range(n))
    counts = [orders.count(order) for order in set(orders)]
    assert len(counts) == {2: 1, 3: 2, 4: 9}[n]  # each of them comes up, and about as often
    assert min(counts) > 0.5 * 300 / len(counts)


@pytest.mark.parametrize("side", [1.0, 3.0])
def test_points_drawn_in_blocks_are_those_drawn_one_by_one(side):
    """To the last bit, and the generator stands where it would."""
    ours, theirs = np.random.default_rng(3), np.random.default_rng(3)
    points = draw_apart(ours, [0, 0, 0], [side] * 3, 10, 0.4)
    expected: list[np.ndarray] = []
    while len(expected) < 10:
        candidate = np.zeros(3) + side * theirs.random(3)
        if all(((candidate - other) ** 2).sum() >= 0.4**2 for other in expected):
            expected.append(candidate)
    np.testing.assert_array_equal(points, expected)
    assert ours.bit_generator.state == theirs.bit_generator.state
