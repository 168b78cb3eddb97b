"""The steps tried in an installation: each is a few commands, run away from the checkout."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from tests.packaging.installation import ROOT, Installation

INSIDE = Path(__file__).parent / "inside"
TESTS = (
    "physics/test_rigid_body.py",
    "physics/test_twins.py",
    "interactions/test_models.py",
    "control/test_closed_loop.py",
    "envs/test_turns.py",
    "envs/test_gymnasium.py",
    "test_camera.py",
)
"""Tests that are run against the installation: those nearest to the kernels and the interfaces."""


def modules(here: Installation) -> None:
    """Every module imports, but those that need an extra that was not asked for."""
    here.python(INSIDE / "every_module.py", *here.row.absent())


def first_step(here: Installation) -> None:
    """The first `env.step`, compilation included."""
    said = here.python(INSIDE / "first_step.py")
    pybullet = here.row.python < "3.12"  # as text: versions have one form here
    if said.split()[-1] != ("bullet" if pybullet else "batch"):
        raise AssertionError(f"another engine than expected flew: {said}")


def agents(here: Installation) -> None:
    """Every shipped agent flies the start of an episode."""
    here.python(INSIDE / "shipped_agents.py")


def demo(here: Installation) -> None:
    """The demo, with fewer swaps and no video."""
    here.command("demo", "--swaps", 1, "--no-video", "--out", "demo")
    _expect(here.home / "demo", "summary.json", "demo.png")


def fly(here: Installation) -> None:
    """A shipped policy flies an episode, solves it and is filmed."""
    files = ("--json", "flight.json", "--video", "flight.gif")
    here.command("fly", "--agent", "swap-dagger", "--seed", 3, *files)
    _expect(here.home, "flight.gif")
    flown = json.loads((here.home / "flight.json").read_text(encoding="utf-8"))
    if not flown["metrics"]["success"]:
        raise AssertionError(f"swap-dagger does not solve seed 3: {flown['metrics']}")


def evaluate(here: Installation) -> None:
    """A shipped policy is scored, and solves what it solves elsewhere."""
    task = ("--layout", "random", "--agent", "swap-dagger", "--episodes", 16, "--seed", 7)
    here.command("evaluate", *task, "--json", "scores.json")
    report = json.loads((here.home / "scores.json").read_text(encoding="utf-8"))
    rate = report["success_rate"]
    if rate < 0.8:
        raise AssertionError(f"swap-dagger solves {rate:.0%} of 16 random swaps")


def readme(here: Installation) -> None:
    """The README's Python blocks run."""
    here.python(INSIDE / "blocks.py", ROOT / "README.md")


def quickstart(here: Installation) -> None:
    """The quickstart's Python blocks run."""
    here.python(INSIDE / "blocks.py", ROOT / "docs" / "quickstart.md")


def refusals(here: Installation) -> None:
    """Without an extra, what needs it says so before any work, and which one it is."""
    log = ("fly", "--agent", "hover", "--trajectory", "flight.parquet")
    here.refused(*log, says="swarm-envs[parquet]")
    here.refused("train", "--out", "run", says="swarm-envs[train]")
    asked = ("evaluate", "--agent", "hover", "--episodes", 1, "--ray", "local")
    here.refused(*asked, says="swarm-envs[ray]")


def page(here: Installation) -> None:
    """The replay page of a flight, and its log in Parquet."""
    files = ("--replay", "replay.html", "--trajectory", "flight.parquet")
    here.command("fly", "--agent", "swap-dagger", "--seed", 3, *files)
    _expect(here.home, "replay.html", "flight.parquet")


def cluster(here: Installation) -> None:
    """Episodes flown by a Ray cluster of this machine."""
    asked = ("--agent", "hover", "--episodes", 2, "--ray", "local", "--workers", 1)
    here.command("evaluate", *asked, "--json", "cluster.json")


def train(here: Installation) -> None:
    """The smallest training, and an episode of what came out."""
    small = ("--task", "swap", "--layout", "random", "--drones", 2, "--steps", 2048)
    here.command("train", *small, "--out", "run")
    here.command("evaluate", "--drones", 2, "--agent", "run", "--episodes", 1)


def tests(here: Installation) -> None:
    """A kernel-sized part of the test-suite, against what is installed."""
    here.install("pytest", "hypothesis")
    away = here.home / "checkout"  # without the package
    shutil.copytree(ROOT / "tests", away / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", away)
    files = [f"tests/{name}" for name in TESTS]
    here.python("-m", "pytest", "-q", "-p", "no:cacheprovider", *files, folder=away)


def _expect(folder: Path, *names: str) -> None:
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise AssertionError(f"{missing} were not written")


_FIRST = (modules, first_step, agents, demo, fly, evaluate, readme, quickstart)
_STEPS = (*_FIRST, refusals, page, cluster, train, tests)
STEPS: Mapping[str, Callable[[Installation], None]] = {
    "README" if step is readme else step.__name__.replace("_", " "): step for step in _STEPS
}
"""Every step by its name, in the order of the table's columns."""
