"""Flights give what they gave when they were frozen, byte for byte: see `tests.helpers.frozen`.

A change that is meant to alter flights freezes them anew: `python -m tests.helpers.frozen --write`.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.helpers.frozen import (
    FLIGHTS,
    JOBS,
    TWINS,
    can_fly,
    differences,
    fingerprint,
    frozen,
    read,
)


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    """The file."""
    return read()


@pytest.fixture(scope="module")
def same_machine(kept: dict[str, Any]) -> bool:
    """Return True if this machine's arithmetic is the one that the file was written with."""
    return fingerprint() == kept["fingerprint"]


@pytest.mark.parametrize(("name", "seed"), JOBS)
def test_flights_are_as_they_were_frozen(
    name: str, seed: int, kept: dict[str, Any], same_machine: bool
) -> None:
    if not can_fly(name):
        pytest.skip("pybullet is not installed")
    now = frozen(FLIGHTS[name].fly(seed))
    assert differences(now, kept["flights"][f"{name}, seed {seed}"], same_machine) == []


@pytest.mark.parametrize(("name", "twin"), TWINS.items())
def test_threads_and_snapshots_change_nothing(name: str, twin: str, kept: dict[str, Any]) -> None:
    for seed in FLIGHTS[name].seeds:
        assert kept["flights"][f"{name}, seed {seed}"] == kept["flights"][f"{twin}, seed {seed}"]


def test_the_file_holds_every_flight_and_no_other(kept: dict[str, Any]) -> None:
    assert [*kept["flights"]] == [f"{name}, seed {seed}" for name, seed in JOBS]


def test_numbers_are_compared_where_bytes_cannot_be() -> None:
    then = {"hashes": {"states": "a"}, "numbers": [1.0, 2.0]}
    near = {"hashes": {"states": "b"}, "numbers": [1.0 + 1e-11, 2.0]}
    far = {"hashes": {"states": "b"}, "numbers": [1.0 + 1e-8, 2.0]}
    assert differences(near, then, same_machine=True) == ["states"]
    assert differences(near, then, same_machine=False) == []
    assert len(differences(far, then, same_machine=False)) == 1
    assert differences({**far, "numbers": None}, then, same_machine=False) == []
