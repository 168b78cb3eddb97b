"""Training killed by SIGKILL at random moments: nothing that was saved is lost, nothing differs."""

from __future__ import annotations

import csv
import multiprocessing
import os
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from safetensors import safe_open

from swarm_envs.agents.policy import FILE
from swarm_envs.cli import main
from tests.training.test_rl import TINY as PPO
from tests.training.test_rl_algorithms import COMMON, TINY

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="no SIGKILL on this system"),
]

COMMANDS = {
    "ppo": [*PPO, "--no-progress", "--steps", "10000"],
    "mappo": ["--algo", "mappo", *COMMON, *TINY["mappo"], "--steps", "5000"],
    "sac": ["--algo", "sac", *COMMON, *TINY["sac"], "--steps", "3000"],
}
TIMES = {"ppo": 10, "mappo": 4, "sac": 4}


def train(algo: str, out: Path) -> int:
    return main(["train", *COMMANDS[algo], "--out", str(out)])


def begun(algo: str, out: Path) -> BaseProcess:
    """A process that has begun to train: its folder is claimed."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.helpers.warm_training"])
    process = context.Process(target=train, args=(algo, out))
    process.start()
    while process.is_alive() and not (out / ".lock").is_file():
        time.sleep(0.002)
    return process


def curve(folder: Path) -> list[dict[str, str]]:
    path = folder / "curve.csv"
    if not path.is_file():
        return []
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def checkpoints(folder: Path) -> int:
    """How many segments the checkpoint has behind it; it must be readable."""
    path = folder / "checkpoint.safetensors"
    if not path.is_file():
        return 0
    with safe_open(path, framework="np") as file:
        return file.metadata()["progress"].count('"collision"')


@pytest.fixture(scope="module")
def wholes(tmp_path_factory) -> dict[str, Path]:
    """Runs that nothing interrupted."""
    found = {algo: tmp_path_factory.mktemp(algo) / "run" for algo in COMMANDS}
    for algo, out in found.items():
        process = begun(algo, out)
        process.join()
        assert process.exitcode == 0
    return found


@pytest.mark.parametrize(("algo", "number"), [(a, k) for a in COMMANDS for k in range(TIMES[a])])
def test_killed_at_a_random_moment_it_ends_as_if_nothing_had_happened(
    algo, number, wholes, tmp_path
):
    """Random are the segment and, up to that of about one segment, the time after its start."""
    whole, out, draws = wholes[algo], tmp_path / "run", np.random.default_rng(number)
    until, rest_s = draws.integers(checkpoints(whole)), draws.uniform(0.0, 0.1)
    process = begun(algo, out)
    while process.is_alive() and checkpoints(out) < until:
        time.sleep(0.001)
    time.sleep(rest_s)
    process.kill()
    process.join()
    saved = checkpoints(out)
    assert saved >= until
    assert len(curve(out)) in (saved, saved - 1)  # the table follows the checkpoint
    again = begun(algo, out)
    again.join()
    assert again.exitcode == 0
    assert curve(out) == curve(whole)
    assert checkpoints(out) == checkpoints(whole)
    assert (out / FILE).read_bytes() == (whole / FILE).read_bytes()
    assert {file.name for file in out.iterdir()} == {file.name for file in whole.iterdir()}
    print(f"{algo}: killed with {saved} of {checkpoints(whole)} segments saved")
