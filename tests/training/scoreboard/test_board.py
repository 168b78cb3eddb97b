"""What `scores.json` may hold: anything else is refused by its place in the file."""

from __future__ import annotations

import json

import pytest

from swarm_envs.training.scoreboard.board import Estimate, read
from tests.helpers.scoreboards import AGENTS, EVIL, TASKS, scores, write_scores


def test_a_scoreboard_is_read_as_it_was_written(tmp_path):
    content = scores()
    board = read(write_scores(tmp_path, content))
    assert [agent.name for agent in board.agents] == list(AGENTS)
    assert len(board.cells) == len(TASKS) * len(AGENTS) == len(content["cells"])
    for cell in content["cells"]:
        read_one = board.pairs[cell["task"], cell["agent"]]
        assert (read_one.status, read_one.episodes) == (cell["status"], cell["episodes"])
        assert (read_one.replay is None) == (cell["replay"] is None)
        for name, given in cell["values"].items():
            ends = given["interval"]
            assert read_one.values[name] == Estimate(given["value"], ends and tuple(ends))
    assert board.aggregates["swap"][EVIL].value == content["aggregates"]["swap"][EVIL]["value"]
    curve = content["profiles"]["ring"]["agents"]["rth3d"]
    assert list(board.profiles["ring"].agents["rth3d"].low) == curve["low"]


def change(content, path, value):
    *way, last = path
    for key in way:
        content = content[key]
    if value is KeyError:
        del content[last]
    else:
        content[last] = value


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["format"], "a list", "its format is 'a list'.*'swarm-envs scoreboard'"),
        (["tasks"], KeyError, "tasks is missing"),
        (["tasks", 1, "id"], "swap-circle-2-v1", "tasks has 'swap-circle-2-v1' twice"),
        (
            ["metrics", 0, "better"],
            "more",
            r"metrics\[0\].better is 'more'.*higher, lower, neither",
        ),
        (["agents", 2, "privileged"], 1, r"agents\[2\].privileged is 1, but must be true or false"),
        (["cells", 3, "task"], "swap-x", r"cells\[3\].task is 'swap-x', but must be one of"),
        (["cells", 3, "episodes"], -1, r"cells\[3\].episodes is -1, but must be a whole number"),
        (["cells", 3, "values", "speed"], {"value": 1.0}, r"cells\[3\].values names 'speed'"),
        (["cells", 3, "values", "energy_j", "value"], "x", r"energy_j.value is 'x'.*a number"),
        (["cells", 3, "values", "energy_j", "value"], float("nan"), "it holds NaN.*null says"),
        (["cells", 3, "values", "energy_j", "interval"], [2, 1], "two numbers in order"),
        (["cells", 3, "replay", "file"], "javascript:alert(1)", "must be replays/NAME.html"),
        (["aggregates", "hop"], {}, "aggregates names 'hop', which the file does not list"),
        (["aggregates", "swap", "rth3d", "value"], 1.5, r"must be a score in \[0, 1\]"),
        (
            ["profiles", "swap", "thresholds"],
            [0, 0],
            "thresholds must be two or more, and increase",
        ),
        (["profiles", "swap", "agents", "rth3d", "low"], [0.5], "low is .*a list of 41 of numbers"),
    ],
)
def test_what_is_wrong_is_named_by_its_place(tmp_path, path, value, said):
    content = scores()
    change(content, path, value)
    write_scores(tmp_path, content)
    with pytest.raises(ValueError, match=f"scores.json' cannot be shown: .*{said}.*write it anew"):
        read(tmp_path)


def test_what_is_no_scoreboard_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no scores.json in .*swarm-envs benchmark --out"):
        read(tmp_path)
    for text in ("[]", "{", json.dumps({"format": "swarm-envs scoreboard"})):
        (tmp_path / "scores.json").write_text(text)
        with pytest.raises(ValueError, match="cannot be shown"):
            read(tmp_path)
