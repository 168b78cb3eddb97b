"""The oldest dependencies, the matrix of extras; and without any extra all agents fly."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib

import pytest

from tests.helpers.sources import ROOT
from tests.packaging.lower_bounds import lowest
from tests.packaging.matrix import table
from tests.packaging.rows import EVERY_OPTIONAL, OPTIONAL, ROWS
from tests.packaging.steps import INSIDE, STEPS

PROJECT = """
[project]
dependencies = ["numpy>=1.26", "pybullet>=3.2.6; python_version < '3.12'"]
[project.optional-dependencies]
ray = ["ray>=2.40"]
all = ["own-tool>=1", "swarm-envs[ray,all-of-ray]"]
all-of-ray = ["swarm-envs[ray]"]
bad = ["torch"]
worse = ["torch>=2.0,<3.0"]
"""


@pytest.fixture
def pyproject(tmp_path):
    file = tmp_path / "pyproject.toml"
    file.write_text(PROJECT, encoding="utf-8")
    return file


def test_every_bound_is_taken_as_it_stands(pyproject):
    assert lowest(pyproject) == ["numpy==1.26", "pybullet==3.2.6; python_version < '3.12'"]


def test_extras_that_name_extras_are_followed_once(pyproject):
    assert lowest(pyproject, ["all"])[2:] == ["own-tool==1", "ray==2.40"]


@pytest.mark.parametrize(("extra", "said"), [("bad", "needs a lower"), ("worse", "not written")])
def test_other_bounds_are_refused(pyproject, extra, said):
    with pytest.raises(ValueError, match=said):
        lowest(pyproject, [extra])


def test_ours_can_be_read_and_the_matrix_knows_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"])
    assert len(lowest(ROOT / "pyproject.toml", sorted(extras))) > len(project["dependencies"])
    assert set(OPTIONAL) == extras - {"dev"}
    assert {extra for row in ROWS for extra in row.extras} <= extras
    assert {step for row in ROWS for step in row.steps} == set(STEPS)


def test_the_table_says_what_failed_and_what_was_not_tried():
    good = {"row": "newest", "python": "3.11", "extras": [], "megabytes": 7, "failed": {}}
    bad = {"row": "all", "python": "3.12", "extras": ["all"], "failed": {"demo": "no"}}
    good |= {"cpu_s": {"install": 3.6, "demo": 8.1}}
    bad |= {"cpu_s": {"install": 2.0, "demo": 0.1}}
    assert table([good, bad]).splitlines()[2:] == [
        "| newest | 3.11 |  | 7 | 4 | 8 |",
        "| all | 3.12 | all |  | 2 | FAILED |",
    ]


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


@pytest.mark.slow
def test_every_shipped_agent_flies():
    assert run_without(EVERY_OPTIONAL, INSIDE / "shipped_agents.py").count("flies") >= 16
