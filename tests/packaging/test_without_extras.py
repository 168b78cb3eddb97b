"""Without torch and every other extra: all modules but the trainers import, all agents fly."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests.helpers.imports import ROOT
from tests.packaging.rows import EVERY_OPTIONAL
from tests.packaging.steps import INSIDE

BLOCKED = """
import runpy, sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in %r:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nothing())
script, sys.argv = sys.argv[1], sys.argv[1:]
runpy.run_path(script, run_name="__main__")
"""


def run_without(absent, *command):
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED % set(absent), *map(str, command)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_all_modules_but_the_trainers_import():
    said = run_without(EVERY_OPTIONAL, INSIDE / "every_module.py", *sorted(EVERY_OPTIONAL))
    assert int(said.split()[0]) > 200
    needing = re.findall(r"^(\S+) needs", said, re.MULTILINE)
    assert needing
    assert {".".join(name.split(".")[:2]) for name in needing} == {"swarm_envs.training"}


def test_a_module_that_needs_what_may_not_be_missing_is_told():
    with pytest.raises(AssertionError, match="torch"):
        run_without({"torch"}, INSIDE / "every_module.py", "ray")


@pytest.mark.slow
def test_every_shipped_agent_flies():
    assert run_without(EVERY_OPTIONAL, INSIDE / "shipped_agents.py").count("flies") >= 16
