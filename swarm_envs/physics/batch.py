"""`BatchPhysics`: the compiled engine. Any number of environments, no dependency on Bullet."""

from __future__ import annotations

import numpy as np

from swarm_envs.compiled import announce_compilation
from swarm_envs.physics.base import Physics
from swarm_envs.physics.step import step_all
from swarm_envs.state import FloatArray


class BatchPhysics(Physics):
    """Free rigid bodies in struct-of-arrays form, integrated in compiled code.

    It is the twin of `BulletPhysics`: the same step rule, to 1e-9 until the first contact. After a
    contact it goes on without response: drones pass through each other and through walls.
    """

    name = "batch"

    def _advance(self, commands: FloatArray, external: FloatArray) -> None:
        announce_compilation(step_all)
        step_all(self.world, np.ascontiguousarray(commands), external, self._total)
