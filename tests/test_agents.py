"""Agents fly only in environments that are what they require."""

from __future__ import annotations

import copy
import pickle
import re

import pytest

from swarm_envs import make, swap_v0
from swarm_envs.agents import Agent, fly_episode, load
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.registry import SHIPPED
from swarm_envs.agents.simple import HoverAgent
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.physics import BatchPhysics


def test_an_agent_is_not_flown_with_another_controller() -> None:
    plain, compensated = TrackingAgent(), TrackingAgent.compensated()
    assert isinstance(plain, Agent)
    for made, flown in ((plain, compensated), (compensated, plain)):
        env = swap_v0.parallel_env(team="LS", layout="stacked", physics="batch", **made.requires)
        with pytest.raises(ValueError, match=r"requires controller.*\*\*agent\.requires"):
            fly_episode(env, flown, seed=0)
    env = swap_v0.parallel_env(team="LS", layout="stacked", physics="batch", action="rotors")
    with pytest.raises(ValueError, match=r"requires action='setpoint', but .* 'rotors'"):
        fly_episode(env, plain, seed=0)


def test_two_agents_of_one_kind_may_share_an_environment() -> None:
    env = swap_v0.parallel_env(
        team="LS", layout="stacked", physics="batch", **TrackingAgent.compensated().requires
    )
    assert fly_episode(env, TrackingAgent.compensated(), seed=0)["success"]


@pytest.mark.parametrize("clone", [copy.deepcopy, pickle.dumps])
def test_an_engine_refuses_copies_that_would_come_apart(clone) -> None:
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        clone(BatchPhysics("S"))


@pytest.mark.parametrize("name", SHIPPED)
def test_agents_load_by_name_and_fly(name) -> None:
    agent = load(name)
    assert isinstance(agent, Agent)
    task, fewest = "swap_v0", 2
    if isinstance(agent, PolicyAgent):
        task, fewest = agent.policy.note.task, agent.policy.note.fewest
    layout = {"layout": "stacked"} if task == "swap_v0" else {}
    given = {"physics": "batch", "horizon_s": 0.2, **layout, **agent.requires}
    env = make(task, team="LS" * (fewest // 2), **given)
    assert fly_episode(env, agent, seed=0)["length_s"] == pytest.approx(0.2, abs=0.03)
    env.close()


def test_a_hovering_agent_stays_and_a_random_one_follows_its_seed() -> None:
    env = swap_v0.parallel_env(num_drones=2, physics="batch", interactions="none", horizon_s=0.5)
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
    env = swap_v0.parallel_env(num_drones=1, physics="batch", action="setpoint")
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
number = 3
"""


def test_an_agent_of_a_file_of_ones_own(tmp_path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    assert load(f"{file}:Fine").size == 3  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("Fin", ValueError, "unknown class 'Fin'.*did you mean 'Fine'"),
        ("Needy", ValueError, "cannot be made without arguments.*size"),
        ("Mute", ValueError, r"lacks the method `act\(observations, view\)`"),
        ("Secretive", ValueError, "lacks `privileged`, which must be True or False"),
        ("Demanding", ValueError, "lacks `requires`, which must be a mapping"),
        ("number", ValueError, "is 3, but must be a class"),
    ],
)
def test_what_is_no_agent_is_told_what_it_lacks(tmp_path, name, error, said) -> None:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    with pytest.raises(error, match=said):
        load(f"{file}:{name}")


def test_files_that_give_no_agent(tmp_path) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("import nothing_of_this_name", encoding="utf-8")
    with pytest.raises(ImportError, match=r"broken\.py cannot be imported.*nothing_of_this_name"):
        load(f"{broken}:Agent")
    with pytest.raises(FileNotFoundError, match="no file"):
        load(f"{tmp_path / 'none.py'}:Agent")
    with pytest.raises(ValueError, match="must be a Python file"):
        load(f"{tmp_path / 'a.txt'}:Agent")
    with pytest.raises(ValueError, match=re.escape("for one of your own write 'mine.py:Class'")):
        load("mine.py")


def test_what_cannot_be_flown_is_told_before_the_flight() -> None:
    env = swap_v0.parallel_env(num_drones=2, physics="batch", interactions="none")
    odd = HoverAgent()
    odd.requires = {"actions": "acceleration"}
    with pytest.raises(ValueError, match=r"unknown option 'actions'.*'action'"):
        fly_episode(env, odd, seed=0)
    with pytest.raises(TypeError, match=r"HoverAgent.*of a class, make one"):
        fly_episode(env, HoverAgent, seed=0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="must be an object with `requires`"):
        fly_episode(env, object(), seed=0)  # type: ignore[arg-type]
    env.close()


def test_one_filter_is_enough() -> None:
    with pytest.raises(ValueError, match="one \\+filter at its end is enough"):
        load("straight-line+filter+filter")
