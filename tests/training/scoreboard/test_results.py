"""Results that somebody sends: what was changed is found, and several become one page."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.cli import main
from swarm_envs.training.scoreboard.results import verify_results

TASK = "swap-circle-2-v2"


def flown(out: Path, agents: list[str], *more: str) -> dict[str, Any]:
    options = ["--no-replays", "--table", "csv", "--task", TASK, "--agent", *agents, *more]
    assert main(["benchmark", "--out", str(out), *options]) == 0
    found: dict[str, Any] = json.loads((out / "scores.json").read_text())
    return found


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("board")
    return out, flown(out, ["hover", "fast-line"])


def test_what_was_flown_is_verified(board, capsys):
    out, content = board
    assert main(["benchmark", "--verify", str(out)]) == 0
    assert "verified" in capsys.readouterr().out
    assert [cell["episodes"] for cell in content["cells"]] == [128, 256]


def problems_of(folder: Path, content: dict[str, Any]) -> list[str]:
    file = folder / "sent.json"
    file.write_text(json.dumps(content))
    return [*verify_results(file)]


def changed(content: dict[str, Any], what: str) -> dict[str, Any]:
    """A file that was tampered with."""
    made = copy.deepcopy(content)
    cell = made["cells"][1]
    results, values = cell["results"], cell["values"]
    if what == "rate":
        values["success_rate"]["value"] = 0.5
    elif what == "time":
        results["makespan_s"][7] *= 0.5
    elif what == "score":
        results["score"][3] = 1.5
    elif what == "few":
        cell["results"] = {name: column[:20] for name, column in results.items()}
    elif what == "board":
        made["aggregates"]["classic"]["fast-line"]["value"] = 0.99
    elif what == "task":
        made["tasks"][0]["digest"] = "0" * 16
    elif what == "seed":
        made["manifest"]["seed"] = 3
    elif what == "agent":
        made["agents"][1]["digest"] = "0" * 64
    else:  # hover, which reaches nothing, said to have done what fast-line did
        made["cells"][0] |= {"results": {k: v[:128] for k, v in results.items()}}
    return made


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("rate", "success_rate does not follow"),
        ("time", "but its time gives"),
        ("score", r"cannot score 1\.5"),
        ("few", "20 episodes, but the benchmark flies 256"),
        ("board", "leaderboards do not follow"),
        ("task", "is another task here"),
        ("seed", "its seed is 3"),
        ("agent", "is another one here"),
        ("stolen", "hover on"),
    ],
)
def test_what_was_changed_is_found(board, what, said, tmp_path):
    problems = " ".join(problems_of(tmp_path, changed(board[1], what)))
    assert re.search(said, problems), problems


def test_a_consistent_forgery_of_a_shipped_agent_is_flown_again(board, tmp_path):
    """All numbers that follow from the episodes are right, but nobody flew them."""
    made = copy.deepcopy(board[1])
    hover, line = made["cells"]
    hover["results"] = {k: v[:128] for k, v in line["results"].items()}
    hover["values"] |= {k: line["values"][k] for k in ("success_rate", "score")}
    assert any("hover on" in each for each in problems_of(tmp_path, made))


def test_several_files_become_one_page(board, tmp_path, capsys):
    other = flown(tmp_path / "b", ["straight-line+filter", "hover"], "--episodes", "4")
    files = [str(board[0]), str(tmp_path / "b" / "scores.json")]
    assert main(["benchmark", "--join", *files, "--out", str(tmp_path / "all")]) == 0
    capsys.readouterr()
    joined = json.loads((tmp_path / "all" / "scores.json").read_text())
    assert [agent["name"] for agent in joined["agents"]] == [
        "hover",
        "fast-line",
        "straight-line+filter",
    ]
    first, both = board[1]["aggregates"]["classic"], joined["aggregates"]["classic"]
    assert {name: both[name] for name in first} == first  # of hover the first file's
    theirs = other["aggregates"]["classic"]["straight-line+filter"]
    assert both["straight-line+filter"] == theirs
    assert "straight line + filter" in (tmp_path / "all" / "report.html").read_text()
    hover = next(agent for agent in other["agents"] if agent["name"] == "hover")
    hover["digest"] = "1" * 64  # another agent, by the same name
    (tmp_path / "b" / "scores.json").write_text(json.dumps(other))
    assert main(["benchmark", "--join", *files, "--out", str(tmp_path / "c")]) == 0
    again = json.loads((tmp_path / "c" / "scores.json").read_text())
    assert f"hover ({files[1]})" in {a["name"] for a in again["agents"]}


@pytest.mark.parametrize("text", ["", "[]", '{"format": "swarm-envs scoreboard"}', "{", "NaN"])
def test_what_is_no_results_file_is_refused(tmp_path, capsys, text):
    file = tmp_path / "scores.json"
    file.write_text(text)
    assert main(["benchmark", "--verify", str(file)]) == 2
    assert "is no results file" in capsys.readouterr().err
    assert main(["benchmark", "--verify", str(tmp_path / "none.json")]) == 2
    with pytest.raises(SystemExit):
        main(["benchmark", "--join", str(file)])
