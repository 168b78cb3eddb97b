"""The scripts in examples/ run as they stand, where their library is installed."""

from __future__ import annotations

import math
import runpy
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import pytest

from swarm_envs import swap_v1

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.filterwarnings("default")


def main_of(name: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]


@pytest.mark.slow
def test_stable_baselines3():
    pytest.importorskip("stable_baselines3")
    assert math.isfinite(main_of("sb3_ppo")(["--steps", "4096", "--envs", "8"]))


@pytest.fixture(params=["end_team", "end_pair"])
def on_contact(request, monkeypatch):
    """Let the examples fly with this effect of a contact, without an edit of them."""
    for module, name in ((swap_v1, "parallel_env"), (gymnasium, "make_vec")):
        made = partial(getattr(module, name), on_contact=request.param)
        monkeypatch.setattr(module, name, made)


@pytest.mark.slow
@pytest.mark.usefixtures("on_contact")
def test_torchrl():
    pytest.importorskip("torchrl", reason="run by `make test-compat`")
    rewards = main_of("torchrl_mappo")(["--steps", "240", "--batch", "120"])
    assert len(rewards) == 2
    assert all(math.isfinite(reward) for reward in rewards)


@pytest.mark.slow
@pytest.mark.usefixtures("on_contact")
def test_skrl(tmp_path):
    pytest.importorskip("skrl", reason="run by `make test-compat`")
    agent = main_of("skrl_ppo")(["--steps", "64", "--envs", "4", "--out", str(tmp_path)])
    deviations = agent.policy.log_std.detach()
    assert deviations.isfinite().all()
    assert not (deviations == -0.5).all()  # it has learned something


def test_every_example_is_run():
    names = {file.stem for file in EXAMPLES.glob("*.py")}
    tests = EXAMPLES.with_name("tests") / "examples"
    elsewhere = {file.stem.removeprefix("test_") for file in tests.glob("test_*.py")}
    elsewhere |= {"ppo", "dagger"}  # tests/training/test_dagger.py
    elsewhere |= {"rllib_ppo", "benchmarl_grid"}  # tests/compat/test_rllib.py, test_benchmarl.py
    elsewhere |= {"tune_agents"}  # tests/test_safety.py
    elsewhere |= {"own_task"}  # tests/tasks/test_own_task.py
    elsewhere |= {"force_knowledge"}  # tests/training/test_force_knowledge.py
    elsewhere |= {"crazyflow_downwash"}  # tests/compat/test_jax.py
    assert names == {"sb3_ppo", "torchrl_mappo", "skrl_ppo"} | elsewhere
