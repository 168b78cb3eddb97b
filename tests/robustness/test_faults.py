"""Every operation on the disk fails once, in every command that writes: nothing half is left.

Random kills (`tests/robustness/kills.py`) do not reach each of them.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from swarm_envs import cli
from tests.helpers.faults import FaultyDisk
from tests.robustness.kills import COMMANDS, FLY, Run, differences, run

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names open files by /proc")
QUICK = {
    "evaluate": run(
        *("evaluate", "--drones", "2", "--horizon-s", "0.1", "--agent", "hover", "--episodes", "2")
    ),
    "plan": run("plan", "--grid", "12x12x6", "--density", "0.2"),
    "fly": lambda out: run(*FLY, "--trajectory", str(out / "flight.npz"))(out / "rest"),
    "assignment": COMMANDS["assignment"],
    "export": COMMANDS["export"],
    "grade": COMMANDS["grade"],
}


def every_fault(job: Run, folder: Path, most: int) -> int:
    """Let every operation fail in turn (evenly chosen ones, if there are more than `most`)."""
    whole, out = folder / "whole", folder / "out"
    disk = FaultyDisk(out)
    with disk.mounted():
        assert job(out) == 0
    out.rename(whole)  # both are flown in one folder: its name may stand in what is written
    count = len(disk.done)
    for n in range(1, count + 1, -(-count // most)):
        shutil.rmtree(out, ignore_errors=True)
        with FaultyDisk(out, n).mounted() as faulty:
            code = job(out)
        # A folder that is there need not be made: then nothing is amiss, or the command says so.
        assert code in (1, 2) or not differences(whole, out), f"operation {n}, exit code {code}"
        half = [file.name for file in out.rglob("*partial*")] if out.exists() else []
        assert not half, f"operation {n} ({faulty.done[-1]}) left {half}"
        if code:
            assert job(out) == 0, f"after operation {n} ({faulty.done[-1]}) it does not go on"
        assert not differences(whole, out), f"after operation {n} ({faulty.done[-1]})"
    return count


@pytest.mark.parametrize("name", QUICK)
def test_no_fault_leaves_half_a_file(tmp_path, name, monkeypatch):
    black = np.zeros((32, 32, 3), np.uint8)  # to draw takes longer than all else
    monkeypatch.setattr("swarm_envs.viewing.video.film", lambda recording: [black] * 4)
    assert every_fault(QUICK[name], tmp_path, most=8) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_no_fault_of_any_operation_leaves_half_a_file(tmp_path, name):
    assert every_fault(QUICK.get(name, COMMANDS[name]), tmp_path, most=200) >= 4


def test_every_command_is_killed_and_given_faults():
    assert {name.split()[0] for name in COMMANDS} == set(cli.COMMANDS)
