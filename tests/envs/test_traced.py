"""Who reads one step of an environment from top to bottom gets through few files and functions."""

from __future__ import annotations

import pytest

from swarm_envs.physics import bullet_available
from tests.helpers.traced import crossed, table

MOST_FILES, MOST_FUNCTIONS = 15, 50


def test_a_step_crosses_few_files_and_functions() -> None:
    if not bullet_available():
        pytest.skip("pybullet is not installed")
    found = crossed()
    functions = sum(len(names) for names in found.values())
    assert 0 < len(found) <= MOST_FILES, table(found)
    assert 0 < functions <= MOST_FUNCTIONS, table(found)
