"""What the tests of environments share: `engine`, either engine, and `face`, every interface."""

from __future__ import annotations

import importlib.util

import pytest

from swarm_envs.physics import bullet_available
from tests.helpers.faces import FACES, Face


@pytest.fixture(params=["batch", "bullet"])
def engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine; without pybullet, of the compiled one alone."""
    if request.param == "bullet" and not bullet_available():
        pytest.skip("pybullet is not installed")
    return request.param


@pytest.fixture(params=FACES, ids=lambda face: face.name)
def face(request: pytest.FixtureRequest) -> Face:
    """An interface; that of Stable-Baselines3 where it is installed."""
    if request.param.name == "shared policy" and not importlib.util.find_spec("stable_baselines3"):
        pytest.skip("Stable-Baselines3 is not installed")
    return request.param
