"""Rigid-body physics in two engines with one interface.

from swarm_envs.physics import BatchPhysics
physics = BatchPhysics("LS", num_envs=1, interactions="learned")
state = physics.reset()
state = physics.step(commands)      # (E, N, 4) thrust of each rotor, N, for 1/240 s
"""

from swarm_envs.physics.base import BatchPhysics, Physics
from swarm_envs.physics.bullet import BulletPhysics, bullet_available
from swarm_envs.physics.contact import Contacts
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP

__all__ = [
    "PHYSICS_RATE",
    "TIME_STEP",
    "BatchPhysics",
    "BulletPhysics",
    "Contacts",
    "Physics",
    "bullet_available",
]
