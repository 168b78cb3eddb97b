"""`make stale` names what was computed from a model that has changed since."""

from __future__ import annotations

import pytest

from tests.helpers import stale
from tests.helpers.imports import ROOT


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
