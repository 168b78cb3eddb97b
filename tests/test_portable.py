"""What only some systems have is used where it is there, and missed nowhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.imports import ROOT

ELSEWHERE = """
import os, sys
sys.modules["fcntl"] = None
del os.fork, os.sched_getaffinity
"""
"""A process as on Windows or macOS, as far as the package looks."""

FLY = """
import numpy as np
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import parse_team

core = SwarmCore(SwapTask(parse_team("SLSS")), EnvConfig(physics="batch"), 256)
core.reset(list(range(256)))
before = core.physics.state.position.copy()
result = core.step(np.full((256, 4, 3), 0.5))
assert np.isfinite(result.observations).all() and result.observations.shape[:2] == (256, 4)
assert (core.physics.state.position != before).any(axis=(1, 2)).all()
assert core.physics.workers.threads == min(os.cpu_count(), 256)
core.close()
"""

WRITE = """
from pathlib import Path
import swarm_envs.cli
from swarm_envs.files import claimed, write_json

folder = Path(sys.argv[1])
with claimed(folder):
    write_json(folder / "numbers.json", {"one": 1})
assert (folder / "numbers.json").read_text() == '{\\n "one": 1\\n}\\n'
assert not [path for path in folder.iterdir() if "partial" in path.name]
"""


@pytest.mark.parametrize("script", [FLY, WRITE], ids=["a batch flies", "a file is written"])
def test_without_what_only_linux_has(script: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", ELSEWHERE + script, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
