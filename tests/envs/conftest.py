"""The fixture `face` of the tests of environments: every interface."""

from __future__ import annotations

import importlib.util

import pytest

from tests.helpers.faces import FACES, Face


@pytest.fixture(params=FACES, ids=lambda face: face.name)
def face(request: pytest.FixtureRequest) -> Face:
    """An interface; that of Stable-Baselines3 where it is installed."""
    if request.param.name == "shared policy" and not importlib.util.find_spec("stable_baselines3"):
        pytest.skip("Stable-Baselines3 is not installed")
    return request.param
