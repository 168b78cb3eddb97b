"""`make quick` runs the tests that see a change, and `make stale` names what a model made."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.helpers import stale
from tests.helpers.imports import ROOT
from tests.helpers.quick import DOCS_TESTS, nearest_tests


def test_the_nearest_tests_come_first():
    order = nearest_tests(["swarm_envs/noise.py"])
    assert order[0] == "tests/test_noise.py"
    assert "tests/envs/test_actions.py" in order[1:]  # through the observation, which adds noise
    assert "tests/test_house.py" not in order


def test_a_changed_test_helper_and_page_are_seen_by_their_tests():
    assert "tests/test_house.py" in nearest_tests(["tests/helpers/imports.py"])
    assert nearest_tests(["docs/rl.md", "Makefile"]) == list(DOCS_TESTS)


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


@pytest.fixture
def record(tmp_path, monkeypatch):
    monkeypatch.setattr(stale, "RECORD", tmp_path / "made_from.json")
    stale.record(list(stale.PRODUCTS))
    return tmp_path / "made_from.json"


def test_every_file_of_the_table_exists_and_has_a_record():
    for product in stale.PRODUCTS.values():
        for name in (*product.files, *product.sources):
            assert (ROOT / name).is_file(), name
    stale.stale()  # reads the record in the repository


def test_what_a_changed_model_made_is_stale_and_so_is_what_that_made(record):
    assert stale.stale() == {}
    record.write_text(
        record.read_text().replace(stale.digests((stale.LEARNED,))[stale.LEARNED], "")
    )
    found = stale.stale()
    assert found["belief"] == [stale.LEARNED]
    assert stale.BELIEF in found["figure-8"]  # the belief itself is stale
    assert {stale.LEARNED, stale.BELIEF} == {*found["benchmark"]} - {*stale.POLICIES}
    assert "belief-wake" not in found
    stale.record(list(found))
    assert stale.stale() == {}
