"""The fixture `engine` of the tests of physics, the class of either engine."""

from __future__ import annotations

import pytest

from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics, bullet_available

ENGINES = [BatchPhysics] + ([BulletPhysics] if bullet_available() else [])


@pytest.fixture(params=ENGINES, ids=lambda engine: engine.name)
def engine(request: pytest.FixtureRequest) -> type[Physics]:
    """An engine; without pybullet, the compiled one alone."""
    chosen: type[Physics] = request.param
    return chosen
