"""What only some systems have is used where it is there, and missed nowhere."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.imports import ROOT, SOURCES, parsed

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


RARE = {"fork", "forkpty", "sched_getaffinity", "sched_setaffinity", "killpg", "getuid", "wait4"}
"""What `os` has on some systems alone."""
RARE_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "pty", "msvcrt", "winreg"}


def asked_for(tree: ast.Module) -> set[str]:
    """Names of `os` that a source makes sure of by `hasattr`."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    sure = (c for c in calls if ast.unparse(c.func) == "hasattr" and ast.unparse(c.args[0]) == "os")
    return {str(ast.literal_eval(call.args[1])) for call in sure}


def unsure(tree: ast.Module) -> set[str]:
    """What a source takes without asking whether this system has it."""
    guarded = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.Try)
        and any("ImportError" in ast.unparse(h.type) for h in node.handlers if h.type)
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "os":
            found |= {node.attr} & RARE - asked_for(tree)
        elif isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in guarded:
            names = {alias.name for alias in node.names}
            found |= (names | {getattr(node, "module", None) or ""}) & RARE_MODULES
            if getattr(node, "module", None) == "os":
                found |= names & RARE
    return found


def test_nothing_is_taken_unasked_that_some_systems_lack() -> None:
    found = {name: unsure(parsed(name)) for name in SOURCES}
    assert not {name: taken for name, taken in found.items() if taken}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import os\nos.fork()", {"fork"}),
        ("from os import sched_getaffinity", {"sched_getaffinity"}),
        ("import os\nif hasattr(os, 'fork'):\n    os.fork()", set()),
        ("import fcntl", {"fcntl"}),
        ("def f():\n    from resource import getrusage", {"resource"}),
        ("try:\n    import fcntl\nexcept ImportError:\n    fcntl = None", set()),
        ("from importlib import resources\nimport os\nos.cpu_count()", set()),
    ],
)
def test_the_finder_of_what_some_systems_lack(source: str, found: set[str]) -> None:
    assert unsure(ast.parse(source)) == found
