"""Evaluation by several processes: the results of one, whatever dies or fails on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import frozen_seeds, source_digest
from swarm_envs.cli import main
from swarm_envs.training.flights import Flight, fly_chunk
from swarm_envs.training.scale_out import ScaleOptions, run_jobs
from tests.helpers.small_jobs import alive, small_job, wait_for
from tests.helpers.users_agents import FINE

QUICK = ["--drones", "2", "--horizon-s", "0.5", "--episodes", "20", "--seed", "7"]
MINE = (
    FINE
    + """
class Some(Fine):
    def say(self): return np.full(3, 0.0 / int(self.seed % 3 > 0 or self.count < 3))
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
    """Return a report without the times that decisions took."""
    content: dict[str, Any] = json.loads((out / "report.json").read_text())
    for agent in (content, *content["agents"]):
        agent.pop("act_ms", None)
    return content


def kept_seeds(out: Path) -> list[list[int]]:
    """Return the seeds of the episodes in each file."""
    files = [file.read_text().splitlines()[1:] for file in out.glob("episodes/*.jsonl")]
    return [[json.loads(line)["seed"] for line in lines] for lines in files]


def test_processes_give_the_report_of_one(tmp_path, mine, capfd):
    names = ["swap-dagger", f"{mine}:Fine", f"{mine}:Some"]
    outs = [tmp_path / "one", tmp_path / "two"]
    for out, more in zip(outs, ([], ["--workers", "2"]), strict=True):
        assert main(["evaluate", *QUICK, "--agent", *names, "--out", str(out), *more]) == 1
    assert report(outs[0]) == report(outs[1])
    assert "in the episode of seed" in report(outs[1])["agents"][2]["error"]
    assert f'{mine}", line ' in capfd.readouterr().err
    assert all(len(seeds) == len(set(seeds)) for seeds in kept_seeds(outs[1]))
    assert main(["evaluate", *QUICK, "--agent", *names[:2], "--out", str(outs[1])]) == 0
    assert f"{names[1]}: resumes after 20 of 20 episodes" in capfd.readouterr().out


def test_an_agent_that_kills_its_process_is_named(tmp_path, mine):
    agents = ["--agent", f"{mine}:Killed", f"{mine}:Fine"]
    few = ["--episodes", "2", "--out", str(tmp_path / "out"), "--workers", "2"]
    assert main(["evaluate", *QUICK, *agents, *few]) == 1
    killed, fine = report(tmp_path / "out")["agents"]
    assert "WorkerDied: the worker process died twice" in killed["error"]
    assert fine["episodes"] == 2


def test_a_job_whose_process_dies_is_repeated(tmp_path):
    notes = tmp_path / "notes"
    notes.mkdir()
    jobs: list[Any] = [(k, ("square", 0.1 * k)) for k in range(20)]
    jobs.append(("dies", ("dies", notes)))
    found: dict[Any, Any] = dict(run_jobs(small_job, jobs, ScaleOptions(workers=2)))
    assert found.pop("dies") == 1.0
    assert len([*notes.iterdir()]) == 2
    assert found == {k: (0.1 * k) * (0.1 * k) / 3.0 for k in range(20)}


DRIVER = """
import signal, sys
from pathlib import Path
from swarm_envs.training.scale_out import ScaleOptions, run_jobs
from tests.helpers.small_jobs import small_job
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    jobs = [(k, ("waits", Path(sys.argv[1]))) for k in range(2)]
    list(run_jobs(small_job, jobs, ScaleOptions(workers=2)))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_their_driver(how, tmp_path):
    notes, script = tmp_path / "notes", tmp_path / "driver.py"
    notes.mkdir()
    script.write_text(DRIVER)
    driver = subprocess.Popen(
        [sys.executable, str(script), str(notes)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stderr=subprocess.DEVNULL,
    )
    wait_for(lambda: len([*notes.iterdir()]) == 2)
    driver.send_signal(how)
    driver.wait(120)
    wait_for(lambda: not any(alive(file) for file in notes.iterdir()))


def test_another_agent_or_version_is_refused():
    digest, setting = source_digest(load("hover")), {"num_drones": 2, "horizon_s": 0.2}
    flight = Flight(
        agent="hover", digest=digest, task="swap_v1", setting=setting, seeds=frozen_seeds(1, 2)
    )
    assert len(fly_chunk(flight).episodes) == 2
    assert "the source of agent 'hover' differs" in fly_chunk(replace(flight, digest="0")).error
    assert "install the same version" in fly_chunk(replace(flight, version="0")).error


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"workers": 2, "ray": "auto"}, "--workers is 2"),
        ({"ray": "http://here:80"}, "must be 'auto', 'local', or host:port"),
    ],
)
def test_impossible_options_are_refused(options, why):
    with pytest.raises(ValueError, match=why):
        ScaleOptions(**options)


def test_without_ray_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install 'swarm-envs\[ray\]'"):
        next(run_jobs(small_job, [(0, ("square", 1.0))], ScaleOptions(ray="local")))
