"""Operations on the disk fail, in every command that writes: nothing half is left.

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
from tests.robustness.kills import COMMANDS, Run, contents, different

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names open files by /proc")


def every_fault(job: Run, folder: Path, error: type[Exception], most: int) -> int:
    """Let operations fail in turn: the first and the last that each line of the package does."""
    out = folder / "out"
    disk = FaultyDisk(out)
    with disk.mounted():
        assert job(out) == 0
    whole = contents(
        out
    )  # now: the folder's name, which it leaves out, may stand in what is written
    for n in disk.ends()[:: -(-len(disk.ends()) // most)]:
        shutil.rmtree(out, ignore_errors=True)
        with FaultyDisk(out, n, error).mounted() as faulty:
            code = job(out)
        where = f"operation {n} ({faulty.done[n - 1]}), exit code {code}"
        # A folder that is there need not be made: then nothing is amiss, or the command says so.
        assert code in (1, 2) or not different(whole, contents(out)), where
        if code:
            half = [file.name for file in out.rglob("*partial*")] if out.exists() else []
            assert not half or faulty.done[n - 1] == "unlink", f"{where} left {half}"
            assert job(out) == 0, f"after {where} it does not go on"
        assert not different(whole, contents(out)), f"after {where}"
    return len(disk.done)


@pytest.fixture(autouse=True)
def black(monkeypatch):
    """To draw takes longer than all else."""
    picture = np.zeros((32, 32, 3), np.uint8)
    monkeypatch.setattr("swarm_envs.viewing.video.film", lambda recording: [picture] * 4)


@pytest.mark.parametrize("name", ["assignment", "evaluate", "export", "fly"])
def test_no_fault_leaves_half_a_file(tmp_path, name):
    assert every_fault(COMMANDS[name], tmp_path, OSError, most=6) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("error", [OSError, MemoryError])
@pytest.mark.parametrize("name", COMMANDS)
def test_no_fault_at_any_place_leaves_half_a_file(tmp_path, name, error):
    assert every_fault(COMMANDS[name], tmp_path, error, most=1000) >= 4


def test_every_command_is_killed_and_given_faults():
    assert {name.split()[0] for name in COMMANDS} == set(cli.COMMANDS)
