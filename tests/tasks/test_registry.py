"""Properties of every task: documentation, both engines, starts, rewards, force bounds."""

from __future__ import annotations

import importlib
import re
from typing import Any

import numpy as np
import pytest

import swarm_envs
from docs.tables.task_pages import _unit, observation_table
from swarm_envs import TASKS
from swarm_envs.agents import fly_episode, load
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.envs.observation import observation_layout
from swarm_envs.envs.options import blueprint_of, options_type
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.physics import bullet_available
from swarm_envs.tasks.base import SPEED_LIMIT
from swarm_envs.tasks.motion import WRITERS
from swarm_envs.tasks.pursuit import PURSUIT_LAYOUTS
from swarm_envs.tasks.rewards import REWARD_NAMES

every_task = pytest.mark.parametrize("task", TASKS)
EACH: list[tuple[str, dict[str, Any]]] = [
    ("swap_v1", {"layout": "random"}),
    ("swap_v1", {"layout": "circle"}),
    ("swap_v1", {"layout": "stacked", "num_drones": 3}),
    ("ring_v1", {}),
    ("formation_v1", {"num_drones": 4, "shape_s": 0.5, "travel_s": 0.4}),
    ("formation_v1", {"num_drones": 4, "labels": "random", "shape_s": 0.5, "travel_s": 0.4}),
    ("crowd_v0", {"num_drones": 4}),
    ("crowd_v0", {"num_drones": 3, "layout": "buildings"}),
    *(("pursuit_v0", {"num_drones": 4, "layout": layout}) for layout in PURSUIT_LAYOUTS),
    ("gates_v0", {"num_drones": 2}),
    ("columns_v0", {}),
    ("columns_v0", {"layout": "sprint"}),
    ("delivery_v0", {"horizon_s": 2.0}),  # its first stage
]
every_layout = pytest.mark.parametrize(("task", "options"), EACH)


def make(task: str, **options: Any) -> SwarmParallelEnv:
    return swarm_envs.make(task, **{"physics": "batch", **options})


def random_actions(env: SwarmParallelEnv, rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {agent: rng.uniform(-1, 1, 3).astype(np.float32) for agent in env.agents}


@every_task
def test_the_module(task):
    module = importlib.import_module(f"swarm_envs.{task}")
    env = make(task)
    assert env.metadata["name"] == env.core.task.name == task
    assert set(env.core.task.reward_weights) == set(env.core.task.reward_names)
    assert env.core.task.write_reference is WRITERS[env.core.task.motion.kind]
    for name, weight in env.core.task.reward_weights.items():
        pattern = rf"^- `{name}` \({weight:g}\): \w"
        assert re.search(pattern, module.parallel_env.__doc__, re.MULTILINE)


def test_the_documented_observation_table_is_the_layout():
    page = observation_table()
    rows = re.findall(r"^\| `(\w+\.\w+)` \| (\d+) \| (.*?) \| (\d+) \|$", page, re.MULTILINE)
    documented = [(name, int(n), unit.strip(), float(scale)) for name, n, unit, scale in rows]
    layout = [
        (f.name.replace("_0.", "_k."), f.where.stop - f.where.start, _unit(f.unit), f.scale)
        for f in observation_layout(1, 1)
    ]
    assert documented == layout


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
@pytest.mark.parametrize("action", ["acceleration", "ctbr", "rotors"])
@every_layout
def test_both_engines_fly_the_same(task, options, action):
    """Two episodes, in some tasks with other payloads; with rotors drones begin to fall."""
    envs = [make(task, action=action, physics=name, **options) for name in ("batch", "bullet")]
    for seed, steps in ((3, 30), (5, 12)):  # 30: across a change of shape
        for env in envs:
            rng, width = np.random.default_rng(2), env.core.mode.width
            size, middle = (0.2, 0.0) if width == 3 else (0.01, -0.1)
            env.reset(seed=seed)
            for _ in range(steps if width == 3 else 12):
                assert env.agents
                env.step({a: middle + size * rng.uniform(-1, 1, width) for a in env.agents})
        ours, theirs = (env.view for env in envs)
        assert ours.team == theirs.team
        np.testing.assert_allclose(ours.state.position, theirs.state.position, atol=1e-9)
        np.testing.assert_allclose(ours.goals, theirs.goals, atol=1e-9)
    for env in envs:
        env.close()


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("gates_v0", {"world": "ideal", "horizon_s": 8.0}),
        ("crowd_v0", {"layout": "open", "horizon_s": 7.0}),
        ("pursuit_v0", {"layout": "moving", "horizon_s": 3.0}),
        ("pursuit_v0", {"layout": "swap-goals", "horizon_s": 5.0, "change_s": 3.0}),
        ("pursuit_v0", {"layout": "chase", "horizon_s": 3.0}),
    ],
)
def test_engines_agree_across_goals(task, options):
    agents = {"moving": "tracking", "chase": "tracking", "swap-goals": "fast-line"}
    agent = load(agents.get(options.get("layout", ""), "straight-line"))
    flights = []
    for engine in ("batch", "bullet"):
        env = make(task, **{**options, "num_drones": 2, "physics": engine, **agent.requires})
        metrics = fly_episode(env, agent, 1)
        flights.append((env.view.state.position.copy(), env.view.goals.copy(), metrics))
        env.close()
    for ours, theirs in zip(flights[0][:2], flights[1][:2], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    least = {"places_passed": 4, "goals_reached": 3, "share_on_goal": 1e-3}
    for name in env.core.task.score_names:
        found, same = (metrics[name] for *_, metrics in flights)
        assert found == pytest.approx(same, abs=1e-3) and found >= least.get(name, 0.0)


@every_layout
def test_starts_are_random(task, options):
    env, starts = make(task, **options), set()
    for seed in range(12):
        env.reset(seed=seed)
        starts.add(env.view.state.position.round(9).tobytes())
    assert len(starts) >= 11


@every_layout
def test_rewards_are_weighted_sums_of_bounded_terms(task, options):
    """A decision's by its duration, those of an episode by 1 or by the seconds flown."""
    env = make(task, reward_weights={"progress": 0.3, "effort": -0.2}, **options)
    weights, rng = env.core.task.reward_weights, np.random.default_rng(0)
    assert (weights["progress"], weights["effort"]) == (0.3, -0.2)
    for seed in range(2):
        env.reset(seed=seed)
        names = env.core.task.reward_names
        sums: dict[str, float] = dict.fromkeys(names, 0.0)
        assert names[: len(REWARD_NAMES)] == REWARD_NAMES
        while env.agents:
            actions = {a: 0.2 * action for a, action in random_actions(env, rng).items()}
            _, rewards, _, _, infos = env.step(actions)
            for agent, info in infos.items():
                terms = info["reward_terms"]
                assert tuple(terms) == names
                total = sum(weights[name] * terms[name] for name in names)
                assert rewards[agent] == pytest.approx(total)
                assert terms["effort"] == pytest.approx(np.mean(actions[agent] ** 2.0) / 48)
                for name, value in terms.items():
                    if name == "progress" and env.core.task.num_stages > 1:
                        continue  # the next goals are at other distances
                    low = -1 / 48 if name == "progress" else 0.0  # actions ask for 2 m/s at most
                    high = 1.0 if name in ("crash", "success", "reached") else 1 / 48
                    assert low - 1e-12 <= value <= high + 1e-12
            for name in sums:  # until its own episode ends
                sums[name] += infos["drone_0"]["reward_terms"][name] if "drone_0" in infos else 0.0
        for name in ("at_goal", "tracking", "success", "crash"):
            most = env.view.time if name in ("at_goal", "tracking") else 1.0
            assert 0.0 <= sums[name] <= most + 1e-9


@pytest.mark.parametrize("family", ["swap", "ring", "formation"])
def test_the_same_flight_returns_the_same_on_every_clock(family):
    returns, progress = [], np.inf
    for horizon_s in (2.0, 4.0, 8.0):
        given = {"layout": "stacked", "team": "SSS"} if family == "swap" else {"num_drones": 3}
        weights = {"tracking": 1.0}
        env = make(f"{family}_v1", horizon_s=horizon_s, reward_weights=weights, **given)
        env.reset(seed=4)
        before = env.core.world.drones["distance"][0, 0]
        rng, total, progress = np.random.default_rng(1), 0.0, 0.0
        for _ in range(96):
            actions = {a: 0.05 * action for a, action in random_actions(env, rng).items()}
            _, rewards, _, _, infos = env.step(actions)
            terms = infos["drone_0"]["reward_terms"]
            won = terms["success"] * env.core.task.reward_weights["success"]
            total, progress = total + rewards["drone_0"] - won, progress + terms["progress"]
        returns.append(total)
        covered = before - env.core.world.drones["distance"][0, 0]
    assert np.ptp(returns) < 1e-12
    if family == "swap":  # goals that stay: potentials add up
        assert progress == pytest.approx(covered / SPEED_LIMIT, abs=1e-12)


@pytest.mark.parametrize("bound", [0.5, 5.0, 1e6])
def test_force_bounds_are_counted_each_physics_step(bound):
    agent = TrackingAgent(decision_rate=240)
    options = {"layout": "stacked", "team": "LS", "force_bounds_g": {"S": bound}}
    env = make("swap_v1", **options, **agent.requires)
    forces: list[np.ndarray] = []
    metrics = fly_episode(env, agent, 0, lambda env: forces.append(env.view.oracle_force.copy()))
    small = np.abs(np.array(forces[1:])[:, 1, 2]) / (9.80665e-3)
    assert metrics["force_bound_violations"] == (small > bound).sum()
    share = (small > bound).mean() / 2  # the large one has no bound here
    assert metrics["fraction_over_force_bound"] == pytest.approx(share)
    assert (metrics["force_bound_violations"] > 0) == (bound < 100)


TEAMS = ("L", "LS", "S*L", "LLLL", "LSLSLS", "S*S*S*L", "S" * 7, "L" * 9, "LS" * 16)


@every_task
def test_a_team_that_a_task_accepts_is_always_placed(task):
    accepted = 0
    for layout in options_type(task).task_type.layouts or (None,):
        for team in TEAMS:
            layouts = {} if layout is None else {"layout": layout}
            try:
                flown = blueprint_of(task, team=team, physics="batch", **layouts).task
            except ValueError:
                continue
            accepted += 1
            for seed in range(60):
                placed = flown.place(np.random.default_rng(seed))
                assert np.isfinite(placed.goals).all()
    assert accepted >= 2
