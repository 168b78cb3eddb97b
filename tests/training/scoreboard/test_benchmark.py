"""The command `benchmark`: failures, the same results by any workers, resuming, foreign parts."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.agents.evaluation import EpisodeFile
from swarm_envs.cli import main
from swarm_envs.training.scoreboard.results import Cell, Results, read_results
from tests.helpers.interrupts import calls_of
from tests.helpers.users_agents import FAILING, FINE

pytest.importorskip("pyarrow")

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


def benchmark(out: Path, *more: str) -> int:
    return main(["benchmark", "--out", str(out), *more])


def cells(out: Path) -> dict[tuple[str, str], Cell]:
    """By the last part of the agent's name, and task."""
    return {(c.agent.split(":")[-1], c.task): c for c in read_results(out).cells}


def untimed(out: Path) -> list[dict[str, Any]]:
    """The rows of a benchmark without the times of decisions."""
    rows = rows_of(read_results(out))
    return [{k: v for k, v in row.items() if not k.startswith("act_us")} for row in rows]


def rows_of(results: Results) -> list[dict[str, Any]]:
    return [row for cell in results.cells for row in cell.rows]


def test_agents_that_fail_are_named_and_the_others_go_on(tmp_path, mine, capsys):
    names = ["Fine", "Raises", "Nan", "Picky", "Choosy", "Five", "Unmade"]
    agents = ["hover", "swap-dagger", *(f"{mine}:{name}" for name in names)]
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    few = ["--task", PAIR, FOUR, "--agent", *agents, "--episodes", "4", "--json", str(copy)]
    assert benchmark(out, *few) == 1
    said = capsys.readouterr()
    assert said.out.count("FAILED") == 6
    assert "mine.py" in said.err  # where it failed, for whoever wrote it
    found = cells(out)
    assert len(found) == 2 * len(agents)
    assert {found[name, FOUR].status for name in ("hover", "swap-dagger", "Fine")} == {"flown"}
    assert "decision 1: KeyError: 'nothing'" in found["Raises", FOUR].reason
    assert "must be finite" in found["Nan", PAIR].reason
    assert not found["Nan", PAIR].rows
    assert found["Picky", PAIR].status == "flown"
    assert found["Picky", FOUR].reason == "only pairs"
    assert found["Picky", FOUR].status == found["Five", PAIR].status == "unsupported"
    assert "requires num_drones=5, not 2" in found["Five", PAIR].reason
    assert "SystemExit: no" in found["Unmade", PAIR].reason
    assert found["Choosy", PAIR].status == "flown"
    assert "episodes: odd seed" in found["Choosy", PAIR].reason
    written = json.loads(copy.read_text())
    standings = written["families"]["classic"]
    assert standings[f"{mine}:Raises"]["value"] == 0.0  # a failure counts as nothing reached
    picky = standings[f"{mine}:Picky"]
    assert (picky["tasks"], picky["of"]) == (1, 2)  # a task that is not supported does not count
    assert "| hover | 0 | 0 |" in (out / "report.md").read_text()
    assert {file.name for file in out.glob("*.png")} == {"scores.png", "success.png"}


def test_the_file_has_every_episode_and_how_it_was_made(tmp_path):
    out = tmp_path / "out"
    agents = ["swap-dagger", "detour", "gates-dagger"]
    assert benchmark(out, "--task", FOUR, "ring-5-v2", "--agent", *agents, "--episodes", "3") == 0
    results = read_results(out)
    rows, about = rows_of(results), results.about
    assert [row["episode"] for row in rows] == [0, 1, 2] * 6
    flown = [row for row in rows if row["refusal"] is None]
    assert {(row["agent"], row["task"]) for row in flown} == {
        ("swap-dagger", FOUR), ("detour", FOUR), ("detour", "ring-5-v2"),
    }  # fmt: skip
    assert all(0 < row["act_us_p50"] <= row["act_us_p99"] for row in flown)
    assert all(0.3 < row["score"] < 1.0 for row in flown if row["agent"] == "detour")
    assert about["seed"] == 2026 and about["versions"]["swarm_envs"]
    assert set(about["tasks"]) == {FOUR, "ring-5-v2"}
    detour = about["agents"]["detour"]
    assert detour["privileged"] and len(detour["digest"]) == 64


def test_a_killed_run_goes_on_with_the_episodes_that_it_flew(tmp_path):
    few = ["--task", PAIR, FOUR, "--episodes", "3", "--agent", "hover", "straight-line"]
    outs = [tmp_path / "whole", tmp_path / "killed"]
    assert benchmark(outs[0], *few) == 0
    with calls_of(EpisodeFile, "add", killed_at=3) as before:
        assert benchmark(outs[1], *few) == 130
    assert not (outs[1] / "episodes.parquet").exists()
    with calls_of(EpisodeFile, "add") as after:
        assert benchmark(outs[1], *few) == 0
    flown = [
        (file.path.name, episode["seed"])
        for file, *episodes in before[:2] + after  # the third was not written
        for episode in episodes
    ]
    assert len(flown) == len(set(flown)) == 2 * 2 * 3  # each episode once
    assert untimed(outs[0]) == untimed(outs[1])


def test_episodes_of_another_agent_or_seed_are_flown_anew(tmp_path, mine):
    out, few = tmp_path / "out", ["--task", PAIR, "--episodes", "1", "--agent", f"{mine}:Fine"]
    for edit, more, flown in (
        ("", [], 1),
        ("", [], 0),
        ("", ["--seed", "5"], 1),
        ("\n# edited\n", [], 1),
    ):
        mine.write_text(MINE + edit, encoding="utf-8")
        with calls_of(EpisodeFile, "add") as calls:
            assert benchmark(out, *few, *more) == 0
        assert len(calls) == flown
        assert len(rows_of(read_results(out))) == 1


def test_without_pyarrow_nothing_flies(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert benchmark(tmp_path / "out", "--agent", "hover") == 1
    assert "swarm-envs[parquet]" in capsys.readouterr().err
    assert not [*(tmp_path / "out").glob("*")]


def test_what_cannot_be_flown_is_misuse(tmp_path, refused):
    def misused(*arguments, said):
        assert said in refused("benchmark", *arguments)

    misused("--out", tmp_path / "none", "--agent", "swap-daggr", said="did you mean 'swap-dagger'")
    misused("--out", tmp_path / "none", "--quick", "--episodes", "3", said="give one")
    misused("--out", tmp_path / "none", "--json", "out.txt", said="must end in .json")
    assert not (tmp_path / "none").exists()
