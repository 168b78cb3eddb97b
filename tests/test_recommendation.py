"""Who is recommended: by what the benchmark measured, and it flies as it is said to."""

from __future__ import annotations

import json

import pytest

import swarm_envs
from docs.recommend import recommendations, replaced
from swarm_envs.agents import fly_episode, load, recommended
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.cli import main
from swarm_envs.training.scoreboard.board import Board
from swarm_envs.training.scoreboard.tasks import TASKS
from tests.helpers.scoreboards import scores


@pytest.mark.parametrize(("task", "drones"), [
    ("swap_v1", 4), ("ring_v1", 5), ("formation_v1", 8), ("columns_v0", 8), ("delivery_v0", 7),
    ("gates_v0", 3), ("crowd_v0", 16), ("pursuit_v0", 8),
])  # fmt: skip
def test_the_best_agent_succeeds(task, drones):
    agent = load(recommended(task.partition("_v")[0], num_drones=drones))
    env = swarm_envs.make(task, num_drones=drones, **{**agent.requires, "physics": "batch"})
    assert fly_episode(env, agent, 0)["success"]
    env.close()


def test_it_is_as_it_was_asked_for():
    learned = load(recommended("swap", num_drones=4, learned=True))
    assert isinstance(getattr(learned, "agent", learned), PolicyAgent)
    assert not load(recommended("swap", num_drones=8, privileged=False)).privileged
    assert load(recommended("swap", num_drones=8, privileged=True)).privileged
    assert recommended("swap", num_drones=16, layout="circle", learned=False) == "roundabout"
    assert recommended("swap", team="SSLL", learned=True) == "swap-dagger"
    assert recommended("swap", team="S*S*LL") == "roundabout"  # policies fly S and L alone
    assert recommended("swap", num_drones=500, privileged=False) == "straight-line+filter"
    with pytest.raises(
        ValueError, match=r"learned=True flies 'swap' with 500.*straight-line\+filt"
    ):
        recommended("swap", num_drones=500, learned=True)
    with pytest.raises(ValueError, match=r"no task 'swop'; it has swap, ring, formation"):
        recommended("swop", num_drones=2)


def test_fly_with_defaults_succeeds(capsys, tmp_path):
    numbers = tmp_path / "a.json"
    assert main(["fly", "--physics", "batch", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["metrics"]["success"]
    assert found["agent"] == recommended("swap", num_drones=4, layout="random")


def test_a_refusal_names_the_agent_that_can(capsys):
    arguments = ["--layout", "circle", "--drones", "16", "--physics", "batch"]
    assert main(["fly", *arguments, "--agent", "swap-ppo"]) == 2
    best = recommended("swap", num_drones=16, layout="circle")
    assert f"try --agent {best}" in capsys.readouterr().err


def test_recommendations_follow_from_the_board():
    content = scores()
    for task in content["tasks"]:
        task["id"] = task["id"].replace("-v1", "-v2")
    for cell in content["cells"]:
        cell["task"] = cell["task"].replace("-v1", "-v2")
        if cell["status"] == "flown":
            cell["values"]["score"] = cell["values"]["success_rate"]
    rows = recommendations(Board(content))
    plain = [t["id"] for t in content["tasks"] if t["id"] in TASKS]
    assert [row["drones"] for row in rows] == [TASKS[name].drones for name in plain]
    for row in rows:
        rates = [about["success"] for about in row["agents"].values()]
        assert rates == sorted(rates, reverse=True)
        assert not rates or min(rates) >= 0.5
    assert replaced(rows, Board(content)) == rows
    old = [{**rows[0], "agents": {"mine": {"success": 1.1, "score": 1.0}, "hover": {}}}]
    assert list(replaced(old, Board(content))[0]["agents"]) == ["mine", *rows[0]["agents"]]
