"""The oldest dependencies, read from pyproject.toml, and that the matrix knows every extra."""

from __future__ import annotations

import tomllib

import pytest

from tests.helpers.imports import ROOT
from tests.packaging.lower_bounds import lowest
from tests.packaging.matrix import table
from tests.packaging.rows import OPTIONAL, ROWS
from tests.packaging.steps import STEPS

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
