"""Fits of tests look for the largest forces in a few swarms; thousands take longer than they do."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def few_swarms() -> Iterator[None]:
    """Every fit examines 20 swarms of each size in place of 2000."""
    with pytest.MonkeyPatch.context() as patch:
        if importlib.util.find_spec("torch") is not None:
            patch.setattr("swarm_envs.training.force_model.evaluate._SWARMS", 20)
        yield
