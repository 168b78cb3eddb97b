"""Tests that ask for an `engine` run on both; without pybullet, on the compiled one alone."""

from __future__ import annotations

import pytest

from swarm_envs.physics import bullet_available


@pytest.fixture(params=["batch", "bullet"])
def engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine."""
    if request.param == "bullet" and not bullet_available():
        pytest.skip("pybullet is not installed")
    return request.param
