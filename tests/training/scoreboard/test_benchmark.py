"""The command `benchmark`: failures, killed runs, the same results; and that they are verified."""

from __future__ import annotations

import copy
import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.cli import main
from swarm_envs.training.scoreboard.manifest import FILE, Manifest
from swarm_envs.training.scoreboard.metrics import write_rows
from swarm_envs.training.scoreboard.results import verify_results
from tests.helpers.scoreboards import scores, write_scores
from tests.helpers.users_agents import FAILING, FINE

CONFIG = {"seed": 1, "episodes": None, "agents": {"hover": "a1", "detour": "b2"}, "quick": False}


def test_runs_of_the_same_options_follow_each_other(tmp_path):
    Manifest(tmp_path, CONFIG).begin(["swarm-envs", "benchmark", "--out", "a b"])  # then killed
    second = Manifest(tmp_path, CONFIG)
    second.begin(["swarm-envs"])
    second.end()
    found = json.loads((tmp_path / FILE).read_text())
    assert [("wall_s" in run) for run in found["runs"]] == [False, True]
    assert found["started"] == found["runs"][0]["started"]
    assert found["cpu_s"] == found["runs"][1]["cpu_s"] >= 0.0
    assert found["versions"]["swarm_envs"]
    assert found["machine"]["cores"] >= 1
    assert found["config"] == CONFIG
    assert len(found["config_hash"]) == 64
    assert found["seed"] == 1


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"config": 3, "runs": []}'])
def test_a_damaged_manifest_is_named(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ValueError, match=r"manifest.json' is damaged .*delete it"):
        Manifest(tmp_path, CONFIG)


MINE = (
    FINE
    + FAILING
    + """
class Picky(Fine):
    def reset(self, env, seed):
        super().reset(env, seed)
        if len(env.agents) > 2: raise ValueError('only pairs')
class Choosy(Fine):
    def reset(self, env, seed):
        super().reset(env, seed)
        if seed % 2: raise ValueError('odd seed')
class Five(Fine):
    requires = {**Fine.requires, 'num_drones': 5}
class Unmade(Fine):
    def __init__(self): raise SystemExit('no')
"""
)
PAIR, FOUR = "swap-circle-2-v2", "swap-circle-4-v2"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    return file


def benchmark(out: Path, *more: str, replays: str = "--no-replays") -> int:
    return main(["benchmark", "--out", str(out), replays, *more])


def content(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "scores.json").read_text(encoding="utf-8"))
    return found


def without_times(out: Path) -> dict[str, Any]:
    """What `scores.json` holds but for what is measured with a clock."""
    found = content(out)
    del found["manifest"]
    for cell in found["cells"]:
        for name in ("act_us_p50", "act_us_p99"):
            cell["values"].pop(name, None)
    return found


def cells(out: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """By the last part of the agent's name, and task."""
    return {(c["agent"].split(":")[-1], c["task"]): c for c in content(out)["cells"]}


def test_who_fails_is_named_and_the_others_go_on(tmp_path, mine, capsys):
    names = ["Fine", "Raises", "Nan", "Picky", "Choosy", "Five", "Unmade"]
    agents = ["hover", "swap-dagger", *(f"{mine}:{name}" for name in names)]
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    few = ["--task", PAIR, FOUR, "--agent", *agents, "--episodes", "4", "--json", str(copy)]
    assert benchmark(out, *few) == 1
    said = capsys.readouterr()
    assert said.out.count("FAILED") == 6
    assert "mine.py" in said.err  # where it failed, for whoever wrote it
    assert json.loads(copy.read_text()) == content(out)
    found = cells(out)
    assert len(found) == 2 * len(agents)
    assert {found[name, FOUR]["status"] for name in ("hover", "swap-dagger", "Fine")} == {"flown"}
    assert "decision 1: KeyError: 'nothing'" in found["Raises", FOUR]["reason"]
    assert "must be finite" in found["Nan", PAIR]["reason"]
    assert found["Nan", PAIR]["values"] == {}
    assert found["Picky", PAIR]["status"] == "flown"
    assert found["Picky", FOUR] | {"reason": "only pairs"} == found["Picky", FOUR]
    assert found["Picky", FOUR]["status"] == found["Five", PAIR]["status"] == "unsupported"
    assert "requires num_drones=5, not 2" in found["Five", PAIR]["reason"]
    assert "SystemExit: no" in found["Unmade", PAIR]["reason"]
    choosy = found["Choosy", PAIR]
    assert (choosy["status"], choosy["episodes"] + choosy["refused"]) == ("flown", 4)
    assert "episodes: odd seed" in choosy["reason"]


def test_one_that_fails_scores_nothing_and_one_that_refuses_is_left_out(tmp_path, mine):
    agents = [f"{mine}:{name}" for name in ("Picky", "Raises")] + ["detour"]
    out = tmp_path / "out"
    assert benchmark(out, "--task", PAIR, FOUR, "--agent", *agents, "--episodes", "2") == 1
    standings = content(out)["aggregates"]["classic"]
    assert standings[agents[1]]["value"] == 0.0
    assert (standings[agents[0]]["tasks"], standings[agents[0]]["of"]) == (1, 2)
    scores = [cells(out)["detour", task]["values"]["score"]["value"] for task in (PAIR, FOUR)]
    assert 0.3 < min(scores) <= standings["detour"]["value"] <= max(scores) < 1.0
    profile = content(out)["profiles"]["classic"]
    above = dict(zip(profile["thresholds"], profile["agents"]["detour"]["fraction"], strict=True))
    assert (above[0.0], above[1.0]) == (1.0, 0.0)


def test_the_table_has_every_episode_and_no_times(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    agents = ["swap-dagger", "detour", "gates-dagger"]
    assert benchmark(out, "--task", FOUR, "ring-5-v2", "--agent", *agents, "--episodes", "3") == 0
    table = parquet.read_table(out / "episodes.parquet").to_pylist()
    timing = parquet.read_table(out / "timing.parquet").to_pylist()
    assert not [name for name in table[0] if "act_us" in name]
    assert [row["episode"] for row in table] == [0, 1, 2] * 6
    assert len(timing) == 9
    assert all(0 < row["act_us_p50"] <= row["act_us_p99"] for row in timing)
    for cell in content(out)["cells"]:
        mine = [r for r in table if (r["task_id"], r["agent"]) == (cell["task"], cell["agent"])]
        assert [row["refused"] for row in mine] == [cell["status"] == "unsupported"] * 3
        if cell["values"]:
            rate = sum(row["success"] for row in mine) / 3
            assert cell["values"]["success_rate"]["value"] == pytest.approx(rate)


def test_processes_and_a_second_run_give_the_bytes_of_one(tmp_path, mine, capsys):
    few = ["--task", PAIR, FOUR, "--episodes", "20", "--table", "csv", "--agent"]
    few += ["straight-line", "swap-dagger", f"{mine}:Nan", f"{mine}:Choosy"]
    outs = [tmp_path / "one", tmp_path / "two"]
    assert benchmark(outs[0], *few) == benchmark(outs[1], *few, "--workers", "2") == 1
    tables = [(out / "episodes.csv").read_bytes() for out in outs]
    assert tables[0] == tables[1]
    assert without_times(outs[0]) == without_times(outs[1])
    capsys.readouterr()
    assert benchmark(outs[1], *few) == 1
    assert "120 of 160 episodes were flown before" in capsys.readouterr().err
    assert (outs[1] / "episodes.csv").read_bytes() == tables[0]
    assert [("wall_s" in run) for run in content(outs[1])["manifest"]["runs"]] == [True, True]


def test_another_config_is_refused_by_what_differs(tmp_path, mine, capsys):
    out, few = tmp_path / "out", ["--task", PAIR, "--episodes", "1", "--table", "csv", "--agent"]
    assert benchmark(out, *few, f"{mine}:Fine") == 0
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
    assert benchmark(out, *few, f"{mine}:Fine", "hover") == 2
    assert "agents: hover is only asked for now" in capsys.readouterr().err
    assert benchmark(out, *few, f"{mine}:Fine", "--seed", "5") == 2
    assert "seed was 2026, and is 5" in capsys.readouterr().err
    mine.write_text(MINE + "\n# edited\n")
    assert benchmark(out, *few, f"{mine}:Fine") == 2
    assert "mine.py:Fine was" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in before} == before


def test_parquet_without_pyarrow_is_refused_before_anything_flies(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert benchmark(tmp_path / "out", "--agent", "hover") == 1
    assert "swarm-envs[parquet]" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_table_is_the_same_bytes_for_the_same_rows(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [
        {"task_id": "a", "seed": 2**32 - 1, "success": True, "energy_j": x} for x in (0.1, None)
    ]
    for name in ("a.parquet", "b.parquet"):
        write_rows(tmp_path / name, rows)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert parquet.read_table(tmp_path / "a.parquet").to_pylist() == rows
    write_rows(tmp_path / "c.csv", rows)
    lines = ["task_id,seed,success,energy_j", "a,4294967295,True,0.1", "a,4294967295,True,"]
    assert (tmp_path / "c.csv").read_text() == "".join(f"{line}\n" for line in lines)


def test_a_report_is_written_anew_out_of_the_scores_alone(tmp_path, capsys):
    folder = write_scores(tmp_path / "board", scores(seed=1))
    again = ["benchmark", "--report", str(folder), "--no-replays"]
    assert main([*again, "--json", str(tmp_path / "a.json")]) == 0
    assert f"wrote {folder / 'report.html'}" in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text()) == scores(seed=1)
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "report.html", "scores.json"]
    first = (folder / "report.html").read_bytes()
    write_scores(folder, scores(seed=2))
    assert main(again) == 0
    assert (folder / "report.html").read_bytes() != first


def test_what_cannot_be_flown_or_reported_is_misuse(tmp_path, refused):
    def misused(*arguments, said):
        assert said in refused("benchmark", "--no-replays", *arguments)

    misused("--report", tmp_path / "none", said="there is no scores.json in")
    (tmp_path / "scores.json").write_text("{}")
    misused("--report", tmp_path, said="format is missing")
    misused(said="either --out DIR, to fly, or --report DIR")
    misused("--out", tmp_path / "none", "--agent", "swap-daggr", said="did you mean 'swap-dagger'")
    misused("--out", tmp_path / "none", "--quick", "--episodes", "3", said="give one")
    misused("--out", tmp_path / "none", "--json", "out.txt", said="must end in .json")
    misused("--out", tmp_path, "--report", tmp_path, said="either --out DIR")
    assert not (tmp_path / "none").exists()


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
    else:
        made["agents"][1]["digest"] = "0" * 64
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
    names = [agent["name"] for agent in joined["agents"]]
    assert names == ["hover", "fast-line", "straight-line+filter"]
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
    assert main(["benchmark", "--join", str(file)]) == 2
