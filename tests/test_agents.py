"""Agents by name and what they require; the detour agent's smooth ways that do not meet."""

from __future__ import annotations

import copy
import pickle
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs import make, swap_v1
from swarm_envs.agents import Agent, fly_episode, load
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.registry import SHIPPED
from swarm_envs.agents.scripted import DetourAgent, HoverAgent, along, bumps, choose_bumps
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.physics import BatchPhysics
from swarm_envs.tasks.obstacles import Column, obstacle_rows
from swarm_envs.tasks.placing import arena_of


def test_an_agent_is_not_flown_with_another_controller() -> None:
    plain, compensated = TrackingAgent(), TrackingAgent.compensated()
    assert isinstance(plain, Agent)
    for made, flown in ((plain, compensated), (compensated, plain)):
        env = swap_v1.parallel_env(team="LS", layout="stacked", physics="batch", **made.requires)
        with pytest.raises(ValueError, match=r"requires controller.*\*\*agent\.requires"):
            fly_episode(env, flown, seed=0)
    env = swap_v1.parallel_env(team="LS", layout="stacked", physics="batch", action="rotors")
    with pytest.raises(ValueError, match=r"requires action='setpoint', but .* 'rotors'"):
        fly_episode(env, plain, seed=0)


def no_force(position: Any, velocity: Any, types: Any) -> Any:
    """A force of one's own."""
    return 0.0 * position


def test_a_refusal_names_the_field_in_which_controllers_differ() -> None:
    agent = TrackingAgent()
    controller = replace(agent.requires["controller"], feedforward=no_force)
    options = {**agent.requires, "controller": controller}
    env = swap_v1.parallel_env(team="LS", layout="stacked", physics="batch", **options)
    with pytest.raises(ValueError, match=r"controller\.feedforward=None, but .*no_force"):
        fly_episode(env, agent, seed=0)
    env.close()


def test_two_agents_of_one_kind_may_share_an_environment() -> None:
    env = swap_v1.parallel_env(
        team="LS", layout="stacked", physics="batch", **TrackingAgent.compensated().requires
    )
    assert fly_episode(env, TrackingAgent.compensated(), seed=0)["success"]


@pytest.mark.parametrize("clone", [copy.deepcopy, pickle.dumps])
def test_an_engine_refuses_copies_that_would_come_apart(clone) -> None:
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        clone(BatchPhysics("S"))


@pytest.mark.parametrize("name", [n for n in SHIPPED if "compensated" in n or "planner" in n])
def test_agents_that_compensate_have_the_belief_that_was_fitted_in_learned_forces(name) -> None:
    belief = load(name).requires["controller"].feedforward
    assert belief.fingerprint == load_belief("learned").fingerprint
    assert load_belief("learned").fingerprint != load_belief("wake").fingerprint


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("detour+adaptive", r"unknown agent 'detour\+adaptive'; 'detour' supports \+compensated$"),
        (
            "tracking+adaptive+compensated",
            r"'tracking' supports \+compensated, \+adaptive, \+compensated\+adaptive$",
        ),
        ("straight-line+adaptive", r"'straight-line' supports \+filter$"),
        ("fast-line+compensated", "'fast-line' supports no suffix$"),
        ("swap-dagger+filter+adaptive", r"'swap-dagger' supports \+filter$"),
        ("rth3d_compensated", r"did you mean 'rth3d\+compensated'"),
    ],
)
def test_an_unsupported_suffix_is_refused_with_the_supported_ones(name, message) -> None:
    with pytest.raises(ValueError, match=message):
        load(name)


@pytest.mark.parametrize(
    ("policy", "agent"),
    [
        ("delivery-dagger", "pid+adaptive"),
        ("ring-dagger", "tracking+compensated+adaptive"),
        ("stack-dagger", "heavy-on-top"),
    ],
)
def test_shipped_policies_fly_with_the_controllers_that_their_files_name(policy, agent) -> None:
    assert load(policy).requires["controller"] == load(agent).requires["controller"]


@pytest.mark.parametrize("name", SHIPPED)
def test_agents_load_by_name_and_fly(name) -> None:
    agent = load(name)
    assert isinstance(agent, Agent)
    task, fewest = "swap_v1", 2
    types: tuple[str, ...] = ("L", "S")
    if isinstance(agent, PolicyAgent):
        note = agent.policy.note
        task, fewest, types = note.task, note.fewest, note.types or types
    layout = {"layout": "stacked"} if task == "swap_v1" else {}
    given = {"physics": "batch", "horizon_s": 0.2, **layout, **agent.requires}
    vehicles = [types[i % len(types)] for i in range(fewest)]
    if task.startswith("delivery"):  # whose couriers, the first, are small
        vehicles.sort(reverse=True)
    team = "".join(vehicles)
    env = make(task, team=team, **given)
    assert fly_episode(env, agent, seed=0)["length_s"] == pytest.approx(0.2, abs=0.03)
    env.close()


def test_a_hovering_agent_stays_and_a_random_one_follows_its_seed() -> None:
    env = swap_v1.parallel_env(num_drones=2, physics="batch", interactions="none", horizon_s=0.5)
    where = []
    for name, seed in (("hover", 1), ("random", 1), ("random", 1), ("random", 2)):
        observations, _ = env.reset(seed=1)
        start = env.view.state.position.copy()
        agent = load(name)
        agent.reset(env, seed)
        for _ in range(20):
            env.step(agent.act(observations, None))
        where.append((env.view.state.position - start).copy())
    assert abs(where[0]).max() < 1e-6
    assert (where[1] == where[2]).all()
    assert (where[1] != where[3]).any()
    env.close()


def test_a_random_agent_needs_bounds() -> None:
    env = swap_v1.parallel_env(num_drones=1, physics="batch", action="setpoint")
    with pytest.raises(ValueError, match="needs bounded actions"):
        fly_episode(env, load("random"), seed=0)
    env.close()


MINE = """
class Fine:
    requires, privileged = {}, False
    def __init__(self, size=3): self.size = size
    def reset(self, env, seed): ...
    def act(self, observations, view): ...
class Needy(Fine):
    def __init__(self, size): ...
class Mute(Fine):
    act = None
class Secretive(Fine):
    privileged = "no"
class Demanding(Fine):
    requires = ["action"]
def level(rows): ...
number = 3
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Fin", "unknown class or function 'Fin'.*did you mean 'Fine'"),
        ("levl", "unknown class or function 'levl'.*did you mean 'level'.*'Demanding', 'Fine'"),
        ("Needy", "cannot be made without arguments.*size"),
        ("Mute", r"lacks the method `act\(observations, view\)`"),
        ("Secretive", "lacks `privileged`, which must be True or False"),
        ("Demanding", "lacks `requires`, which must be a mapping"),
        ("number", "is 3, but must be a class"),
    ],
)
def test_what_is_no_agent_is_told_what_it_lacks(tmp_path, name, said) -> None:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    assert load(f"{file}:Fine").size == 3  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=said):
        load(f"{file}:{name}")


def test_files_that_give_no_agent(tmp_path) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("import nothing_of_this_name", encoding="utf-8")
    with pytest.raises(ImportError, match=r"cannot be imported: line 1 of .*broken\.py raises Mod"):
        load(f"{broken}:Agent")
    with pytest.raises(FileNotFoundError, match="no file"):
        load(f"{tmp_path / 'none.py'}:Agent")
    with pytest.raises(ValueError, match="must be a Python file"):
        load(f"{tmp_path / 'a.txt'}:Agent")
    said = "write 'mine.py:Class' or 'mine.py:function'"
    with pytest.raises(ValueError, match=re.escape(said)):
        load("mine.py")


def test_what_cannot_be_flown_is_told_before_the_flight() -> None:
    env = swap_v1.parallel_env(num_drones=2, physics="batch", interactions="none")
    odd = HoverAgent()
    odd.requires = {"actions": "acceleration"}
    with pytest.raises(ValueError, match=r"unknown option 'actions'.*'action'"):
        fly_episode(env, odd, seed=0)
    with pytest.raises(TypeError, match=r"HoverAgent.*give an instance, not a class"):
        fly_episode(env, HoverAgent, seed=0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="must be an object with `requires`"):
        fly_episode(env, object(), seed=0)  # type: ignore[arg-type]
    env.close()


START = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.6]])


GOAL = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 0.0, 1.8]])


RADIUS = np.full(3, 0.06)


def chosen(
    start: np.ndarray, goal: np.ndarray, obstacles: tuple[Any, ...] = (), seed: int = 0
) -> np.ndarray:
    n, rng = len(start), np.random.default_rng(seed)
    rows = obstacle_rows(obstacles)
    return choose_bumps(start, goal, RADIUS[:n], arena_of(n), rows, rng)


def test_derivatives_are_those_of_the_position():
    bump, step = bumps(START, GOAL)[:, 17], 1e-5
    for time in (0.3, 1.1, 1.9):
        here = along(START, GOAL, bump, 2.0, np.full(3, time))
        before = along(START, GOAL, bump, 2.0, np.full(3, time - step))
        after = along(START, GOAL, bump, 2.0, np.full(3, time + step))
        for k in range(3):
            slope = (after[k] - before[k]) / (2 * step)
            np.testing.assert_allclose(here[k + 1], slope, rtol=1e-6, atol=1e-6)


def test_ways_rest_at_both_ends():
    bump = bumps(START, GOAL)[:, -1]
    for time, place in ((0.0, START), (2.0, GOAL), (-1.0, START), (5.0, GOAL)):
        way = along(START, GOAL, bump, 2.0, np.full(3, time))
        np.testing.assert_allclose(way.position, place, atol=1e-12)
        for part in way[1:]:
            np.testing.assert_allclose(part, 0.0, atol=1e-9)
    middle = along(START, GOAL, bump, 2.0, np.ones(3)).position
    np.testing.assert_allclose(middle, (START + GOAL) / 2 + bump, atol=1e-12)


def test_alone_it_flies_straight():
    assert not chosen(START[:1], GOAL[:1]).any()
    apart = START[:2] + np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert not chosen(apart, apart * [-1.0, 1.0, 1.0]).any()


SOLVED: list[tuple[str, dict[str, Any]]] = [
    ("swap_v1", {"layout": "random", "team": "SLS*SLS"}),
    ("swap_v1", {"layout": "random", "num_drones": 32}),
    ("swap_v1", {"layout": "circle", "num_drones": 16}),
    ("swap_v1", {"layout": "random", "obstacles": (Column(center=(0.0, 0.0), radius=0.3),)}),
    ("swap_v1", {"layout": "stacked", "num_drones": 3}),
    ("ring_v1", {"num_drones": 5}),
    ("formation_v1", {"num_drones": 16, "labels": "mirror", "shapes": ("rings", "rings")}),
    ("formation_v1", {"num_drones": 18, "labels": "blocks", "shapes": ("blocks", "blocks")}),
]


@pytest.mark.parametrize(("task", "options"), SOLVED)
def test_it_solves_each_task(task, options):
    """Through the air of `learned`, its controller compensating what a fit to flights believes."""
    agent = load("detour+compensated")
    env = swarm_envs.make(task, physics="batch", **options, **agent.requires)
    metrics = fly_episode(env, agent, seed=0)
    assert metrics["success"]
    assert metrics["near_misses"] == 0


def test_it_plans_anew_in_each_episode():
    """And alike for the same seed."""
    agent = DetourAgent()
    env = swarm_envs.make("swap_v1", physics="batch", num_drones=3, **agent.requires)
    lengths = [fly_episode(env, agent, seed)["energy_j"] for seed in (0, 1, 0)]
    assert lengths[0] == lengths[2] != lengths[1]


def test_what_it_refuses():
    with pytest.raises(ValueError, match=r"privileged: pass env\.view"):
        DetourAgent().act({}, None)
    agent = DetourAgent()
    env = swarm_envs.make("crowd_v0", physics="batch", num_drones=2, **agent.requires)
    with pytest.raises(ValueError, match="in crowd_v0 each drone receives a new goal"):
        fly_episode(env, agent, seed=0)


@pytest.mark.parametrize("on_contact", ["end_team", "end_pair"])
def test_the_return_is_the_sum_of_the_rewards_that_a_user_adds_up(on_contact):
    agent = load("straight-line")
    env = swap_v1.parallel_env(
        num_drones=8, physics="batch", on_contact=on_contact, **agent.requires
    )
    observations, _ = env.reset(seed=3)
    agent.reset(env, 3)
    collected: list[float] = []
    while env.agents:
        actions = agent.act(observations, env.view)
        observations, rewards, _, _, _ = env.step({name: actions[name] for name in env.agents})
        padded = env.split(env.core.rows)
        observations = {name: padded[name] for name in env.possible_agents}
        collected += rewards.values()
    metrics = fly_episode(env, agent, seed=3)
    assert metrics["mean_return"] == pytest.approx(sum(collected) / 8, rel=1e-12)
    assert abs(metrics["mean_return"]) > 0.01
    env.close()
