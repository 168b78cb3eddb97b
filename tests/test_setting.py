"""The commands say alike in which world is flown, among what, and who flies."""

from __future__ import annotations

import json
import re

import pytest

from swarm_envs import make
from swarm_envs.cli import main
from swarm_envs.commands.fly import FlyOptions
from swarm_envs.envs.randomization import Randomization
from swarm_envs.tasks.obstacles import Box, Column, buildings, parse_obstacles
from swarm_envs.training.rl.learner import training_blueprint
from swarm_envs.training.rl.recipes import with_recipe
from swarm_envs.training.rl.rl_config import RlConfig

WORDS = [
    *("--world", "hall", "--randomization", "mass=0.95:1.05", "--on-contact", "end_pair"),
    *("--obstacles", "column=1.8:1.8:0.1"),
]
"""On every command."""
CREW = ["--neighbors", "2", "--team", "SSL"]


def test_text_says_what_objects_say():
    text = "mass=0.9:1.1, gust_acceleration=1"
    ranges = Randomization(mass=(0.9, 1.1), gust_acceleration=1.0)
    assert Randomization.of(text) == ranges
    assert make("swap_v1", randomization=text, physics="batch").core.ranges == ranges
    standing = parse_obstacles("buildings=2:1,column=1:-1:0.15,box=0:0:0:1:1:2")
    assert standing == (
        *buildings(2, 1),
        Column((1.0, -1.0), 0.15),
        Box((0.0, 0.0, 0.0), (1.0, 1.0, 2.0)),
    )


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("randomization", "mas=0.9:1.1", "did you mean 'mass'"),
        ("randomization", "mass", "must be names with numbers"),
        ("randomization", "mass=1.1:0.9", "mass"),
        ("obstacles", "tree=1:2:3", "unknown obstacle 'tree'"),
        ("obstacles", "column=1:2", "must have 3"),
        ("obstacles", "buildings=1.5:2", "two integers"),
    ],
)
def test_text_that_says_nothing_is_refused(option, text, said):
    with pytest.raises(ValueError, match=said):
        make("swap_v1", physics="batch", **{option: text})


def test_fly_and_evaluate_take_them(tmp_path):
    file = tmp_path / "report.json"
    given = [*WORDS, *CREW, "--agent", "straight-line", "--horizon-s", "0.5"]
    assert main(["fly", "--physics", "batch", *given]) == 0
    assert main(["evaluate", "--episodes", "2", "--json", str(file), *given]) == 0
    report = json.loads(file.read_text())
    asked = {"world": "hall", "on_contact": "end_pair", "num_neighbors": 2, "team": "SSL"}
    assert asked.items() <= report.items()
    assert report["agents"][0]["success_rate"] == 0.0


def test_train_flies_them(tmp_path):
    config = RlConfig(
        out=tmp_path,
        world="hall",
        randomization="mass=0.95:1.05",
        on_contact="end_pair",
        obstacles="column=1.8:1.8:0.1",
    )
    found = training_blueprint(with_recipe(config, "swap_v1"), "swap_v1", {"num_drones": 3})
    assert found.config.hall is not None and found.config.on_contact == "end_pair"
    assert found.config.ranges == Randomization(mass=(0.95, 1.05))
    assert found.task.obstacles == (Column((1.8, 1.8), 0.1),)
    assert found.task.reward_weights["at_goal"] == pytest.approx(2.0 / 3.5)


def test_the_benchmark_flies_them_under_another_id(tmp_path):
    given = ["--task", "swap-random-2-v1", "--agent", "straight-line", "--episodes", "2"]
    more = [*WORDS, *CREW, "--no-replays", "--table", "csv"]
    assert main(["benchmark", "--out", str(tmp_path), *given, *more]) == 0
    (task,) = json.loads((tmp_path / "scores.json").read_text())["tasks"]
    assert task["id"].startswith("swap-random-2-v1-") and "hall" in task["label"]
    assert task["options"]["team"] == "SSL" and "num_drones" not in task["options"]


@pytest.mark.parametrize("command", ["fly", "evaluate", "record", "train"])
def test_a_team_and_another_number_of_drones_contradict_each_other(command, tmp_path, capsys):
    words = [command, "--team", "SSL", "--drones", "5", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "--drones is 5, but --team SSL has 3; give one of them" in error
    assert not [*tmp_path.iterdir()]
    assert FlyOptions(team="SSL", drones=3).setting()["team"] == "SSL"


@pytest.mark.parametrize("command", ["fit", "train", "fly", "evaluate", "benchmark"])
def test_the_help_begins_with_what_matters_most(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    said = capsys.readouterr().out
    first = {"fit": ["data", "out"], "fly": ["task"], "evaluate": ["task"]}.get(command, ["out"])
    assert re.findall(r"--([a-z-]+)", said.split("--help")[-1])[: len(first)] == first
