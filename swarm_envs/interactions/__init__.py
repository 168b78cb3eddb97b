"""Aerodynamic interaction forces between drones, and between a drone and the ground.

from swarm_envs.interactions import load
force = load("learned").forces(position, velocity, "LS")    # (E, N, 3) newton
"""

from swarm_envs.interactions.base import InteractionModel, load
from swarm_envs.interactions.field import ForceField

__all__ = ["ForceField", "InteractionModel", "load"]
