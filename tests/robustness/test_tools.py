"""The tools that soak, kill and misplace, at their smallest; CONTRIBUTING.md has long runs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from swarm_envs.physics import bullet_available
from tests.robustness import kills, soak
from tests.robustness.soak import ROTA, live

needs_bullet = pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")


@needs_bullet
def test_the_engines_fly_the_same_whatever_is_drawn():
    life = live("swap_v0", ROTA[3], {"batch": 2, "bullet": 1}, seed=1, steps=60)
    assert life.compared > 30 and life.drift < soak.DRIFT_M


def test_growth_is_found():
    flat = [(k / 60, 100.0) for k in range(30)]
    leaky = [(k / 60, 100.0 + k) for k in range(30)]
    assert soak.growth(flat) == pytest.approx(0.0, abs=1e-9)
    assert soak.growth(leaky) == pytest.approx(19.0)


def test_folders_that_differ_are_told_apart(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    for folder, seconds in ((one, "1.5"), (two, "2.5")):
        folder.mkdir()
        (folder / "a.json").write_text(f'{{"wall_s": {seconds}, "score": 1}}', encoding="utf-8")
        (folder / "b.csv").write_text(f"step,seconds\n1,{seconds}\n", encoding="utf-8")
    assert not kills.differences(one, two)
    (two / "b.csv").write_text("step,seconds\n2,1.5\n", encoding="utf-8")
    (two / "c.bin").touch()
    assert kills.differences(one, two) == ["b.csv", "c.bin"]


@pytest.fixture
def disks(tmp_path):
    """Skips the test where no disk in memory can be mounted: root of a container may not either."""
    mount = ["mount", "-t", "tmpfs", "tmpfs", str(tmp_path)]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    subprocess.run(["umount", "-l", str(tmp_path)], check=True)


def needs_learning(name: str) -> None:
    """Skip what trains where there is nothing to train with."""
    if name.startswith("train"):
        pytest.importorskip("stable_baselines3")


def tool(name: str, *words: str) -> None:
    """Run a tool in a process of its own: it forks others."""
    command = [sys.executable, "-m", f"tests.robustness.{name}", *words]
    done = subprocess.run(command, cwd=Path(kills.__file__).parents[2], capture_output=True)
    assert done.returncode == 0, (done.stdout + done.stderr).decode()[-3000:]


@pytest.mark.usefixtures("disks")
@pytest.mark.parametrize(
    "name",
    ["export", *(pytest.param(n, marks=pytest.mark.slow) for n in kills.COMMANDS if n != "export")],
)
def test_every_command_in_every_bad_place(name):
    needs_learning(name)
    tool("outputs", name)


@pytest.mark.slow
@needs_fork
@pytest.mark.parametrize("name", kills.COMMANDS)
def test_killed_again_and_again_it_ends_as_if_nothing_had_happened(name):
    needs_learning(name)
    tool("kills", "--command", name, "--times", "3")


@pytest.mark.slow
@needs_bullet
@pytest.mark.parametrize("task", ["swap", "ring", "formation"])
@pytest.mark.parametrize("backend", ["bullet", "batch"])
def test_a_minute_of_soaking(task, backend):
    tool("soak", "--task", task, "--backend", backend, "--minutes", "1")
