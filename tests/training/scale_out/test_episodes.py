"""Evaluation by several processes: the report of one, whatever dies or fails on the way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import EpisodeFile, frozen_seeds, source_digest
from swarm_envs.cli import main
from swarm_envs.training.scale_out import episodes
from swarm_envs.training.scale_out.episodes import (
    AgentEpisodes,
    EvaluationSpec,
    evaluate_distributed,
    fly_chunk,
)
from swarm_envs.training.scale_out.jobs import Serial
from tests.helpers.users_agents import FINE

QUICK = ["--drones", "2", "--horizon-s", "0.5", "--episodes", "20", "--seed", "7"]

MINE = (
    FINE
    + """
from pathlib import Path
class Some(Fine):
    def say(self): return np.full(3, np.nan if self.seed % 3 == 0 and self.count > 2 else 0.0)
class Killed(Fine):
    def say(self): __import__('os').kill(__import__('os').getpid(), 9)
"""
)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    return file


def report(out: Path) -> dict[str, Any]:
    """A report without the times that decisions took."""
    content = json.loads((out / "report.json").read_text())
    for agent in (content, *content["agents"]):
        agent.pop("act_ms", None)
    return content


def kept_seeds(out: Path) -> dict[str, list[int]]:
    """Seeds of the episodes in each file, in the order in which they were kept."""
    files = {file.name: file.read_text().splitlines()[1:] for file in out.glob("episodes/*.jsonl")}
    return {name: [json.loads(line)["seed"] for line in lines] for name, lines in files.items()}


def test_processes_give_the_report_of_one(tmp_path, mine, capfd):
    names = ["swap-dagger", f"{mine}:Fine", f"{mine}:Some"]
    outs = [tmp_path / "one", tmp_path / "two"]
    for out, more in zip(outs, ([], ["--workers", "2"]), strict=True):
        assert main(["evaluate", *QUICK, "--agent", *names, "--out", str(out), *more]) == 1
    assert report(outs[0]) == report(outs[1])
    assert "in the episode of seed" in report(outs[1])["agents"][2]["error"]
    assert "ValueError" in capfd.readouterr().err
    for seeds in kept_seeds(outs[1]).values():
        assert len(seeds) == len(set(seeds))
    assert main(["evaluate", *QUICK, "--agent", *names[:2], "--out", str(outs[1])]) == 0
    assert f"{names[1]}: 20 of 20 episodes were flown before" in capfd.readouterr().out


def test_an_agent_that_kills_its_process_is_named(tmp_path, mine):
    agents = ["--agent", f"{mine}:Killed", f"{mine}:Fine"]
    few = ["--episodes", "2", "--out", str(tmp_path / "out"), "--workers", "2"]
    assert main(["evaluate", *QUICK, *agents, *few]) == 1
    killed, fine = report(tmp_path / "out")["agents"]
    assert "WorkerDied" in killed["error"]
    assert "killed by SIGKILL" in killed["error"]
    assert fine["episodes"] == 2


def chunk(name: str, seeds: list[int], digest: str = "") -> dict[str, Any]:
    about = {"name": name, "digest": digest or source_digest(load(name))}
    setting = {"num_drones": 2, "horizon_s": 0.5, "physics": "batch"}
    return fly_chunk(about, "swap_v1", setting, {}, seeds, 0)


def test_a_chunk_that_takes_long_is_handed_out_in_parts(tmp_path, monkeypatch):
    whole = chunk("hover", frozen_seeds(1, 5))["episodes"]
    monkeypatch.setattr(episodes, "PATIENCE_S", 0.0)
    assert len(chunk("hover", frozen_seeds(1, 5))["episodes"]) == 1
    kept = EpisodeFile(tmp_path, "hover", {})
    record = AgentEpisodes("hover", source_digest(load("hover")), kept=kept)
    setting = {"num_drones": 2, "horizon_s": 0.5, "physics": "batch"}
    evaluate_distributed([EvaluationSpec(record, "swap_v1", setting, frozen_seeds(1, 5))], Serial())
    assert [e["metrics"] for e in record.flown(frozen_seeds(1, 5))] == [e["metrics"] for e in whole]
    assert EpisodeFile(tmp_path, "hover", {}).episodes.keys() == set(frozen_seeds(1, 5))


def test_another_agent_of_the_same_name_is_refused():
    with pytest.raises(ValueError, match="'hover' is another here"):
        chunk("hover", [1], digest="0")


@pytest.mark.parametrize("more", ["", "+filter"])
def test_an_agent_s_file_may_vanish_once_it_was_sent(mine, more):
    name = f"{mine}:Fine{more}"
    record = AgentEpisodes(name, source_digest(load(name)))
    spec = EvaluationSpec(record, "swap_v1", {"num_drones": 2, "horizon_s": 0.2}, [3])
    (job,) = episodes._jobs(spec, "0", 1)
    mine.write_text("raise RuntimeError('edited since')")
    assert fly_chunk(**job.arguments)["episodes"][0]["seed"] == 3
