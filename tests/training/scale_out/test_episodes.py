"""Evaluation by several processes: the report of one, whatever dies or fails on the way."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import EpisodeFile, frozen_seeds, source_digest
from swarm_envs.cli import main
from swarm_envs.training.scale_out import episodes
from swarm_envs.training.scale_out.episodes import Entrant, Leg, fly_apart, fly_chunk
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
    names = ["swap-ppo-8", f"{mine}:Fine", f"{mine}:Some", f"{mine}:Missing", "no-such-agent"]
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
    return fly_chunk(about, "swap_v0", setting, {}, seeds, 0)


def test_a_chunk_that_takes_long_is_handed_out_in_parts(tmp_path, monkeypatch):
    whole = chunk("hover", frozen_seeds(1, 5))["episodes"]
    monkeypatch.setattr(episodes, "PATIENCE_S", 0.0)
    assert len(chunk("hover", frozen_seeds(1, 5))["episodes"]) == 1
    kept = EpisodeFile(tmp_path, "hover", {})
    entrant = Entrant("hover", source_digest(load("hover")), kept=kept)
    setting = {"num_drones": 2, "horizon_s": 0.5, "physics": "batch"}
    fly_apart([Leg(entrant, "swap_v0", setting, frozen_seeds(1, 5))], Serial())
    assert [e["metrics"] for e in entrant.flown(frozen_seeds(1, 5))] == [
        e["metrics"] for e in whole
    ]
    assert EpisodeFile(tmp_path, "hover", {}).episodes.keys() == set(frozen_seeds(1, 5))


def test_another_agent_of_the_same_name_is_refused():
    with pytest.raises(ValueError, match="'hover' is another here"):
        chunk("hover", [1], digest="0")


@pytest.mark.parametrize("more", ["", "+filter"])
def test_an_agent_s_file_may_vanish_once_it_was_sent(mine, more):
    name = f"{mine}:Fine{more}"
    entrant = Entrant(name, source_digest(load(name)))
    leg = Leg(entrant, "swap_v0", {"num_drones": 2, "horizon_s": 0.2}, [3])
    (job,) = episodes._jobs(leg, "0", 1)
    mine.write_text("raise RuntimeError('edited since')")
    assert fly_chunk(**job.arguments)["episodes"][0]["seed"] == 3


@pytest.mark.slow
def test_killed_ten_times_nothing_is_lost_and_nothing_doubled(tmp_path):
    """Each time at a random moment, between the start and some episodes after the last kill."""
    rng = random.Random(0)
    arguments = ["evaluate", "--agent", "straight-line", "detour", "--episodes", "120"]
    arguments += ["--seed", "3", "--workers", "2"]
    out, whole = tmp_path / "killed", tmp_path / "whole"
    command = [sys.executable, "-m", "swarm_envs", *arguments, "--out", str(out)]
    for kill in range(10):
        before = kept_count(out)
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 300
        wanted = before + rng.randint(0, 12)
        while kept_count(out) < wanted:
            assert time.monotonic() < deadline
            assert process.poll() is None, f"ended before kill {kill}"
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert kept_count(out) >= before
    assert main([*arguments, "--out", str(out)]) == 0
    assert main([*arguments, "--out", str(whole)]) == 0
    assert report(out) == report(whole)
    for seeds in kept_seeds(out).values():
        assert sorted(seeds) == sorted(frozen_seeds(3, 120))


def kept_count(out: Path) -> int:
    return sum(max(0, file.read_bytes().count(b"\n") - 1) for file in out.glob("episodes/*.jsonl"))
