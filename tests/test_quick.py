"""`make quick` runs the tests that see a change, the nearest first, and ends in time."""

from __future__ import annotations

import subprocess
import sys

from tests.helpers.imports import ROOT
from tests.helpers.quick import DOCS_TESTS, nearest_tests


def test_the_nearest_tests_come_first():
    order = nearest_tests(["swarm_envs/noise.py"])
    assert order[0] == "tests/test_noise.py"
    assert (
        "tests/envs/test_observation.py" in order[1:]
    )  # through the observation, which adds noise
    assert "tests/test_files.py" not in order


def test_a_changed_test_helper_and_page_are_seen_by_their_tests():
    assert "tests/test_house.py" in nearest_tests(["tests/helpers/imports.py"])
    assert nearest_tests(["tests/test_noise.py"]) == ["tests/test_noise.py"]
    assert nearest_tests(["docs/rl.md"]) == list(DOCS_TESTS)
    assert nearest_tests(["Makefile"]) == []


def test_no_test_begins_when_the_time_is_over(tmp_path):
    file = tmp_path / "test_slow.py"
    file.write_text("def test_a(): pass\ndef test_b(): assert False\n")
    script = f"""
import pytest
from tests.helpers.quick import Budget
ways = ["-q", "-p", "no:cacheprovider", "--rootdir", {str(tmp_path)!r}, {str(file)!r}]
raise SystemExit(pytest.main(ways, plugins=[Budget(0.0)]))
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert "1 passed" in done.stdout, done.stdout
    assert "`make test` runs them all" in done.stdout
