"""What stands in a Bullet world: vehicles (spheres that look like quadrotors), floor, obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from swarm_envs.physics.obstacles import BOX
from swarm_envs.vehicles import Vehicle

_COLORS = {
    "S": [0.13, 0.45, 0.85, 1.0],
    "L": [0.90, 0.45, 0.10, 1.0],
    "S*": [0.10, 0.65, 0.35, 1.0],
}
_OTHER_COLOR = [0.5, 0.5, 0.5, 1.0]
_DARK = [0.15, 0.15, 0.18, 1.0]


def build_body(
    bullet: Any, client: int, vehicle: Vehicle, mass: float, inertia: list[float]
) -> int:
    """Create a vehicle's body: free, undamped, its angular velocity not clamped by Bullet.

    Args:
        bullet: the pybullet module.
        client: id of the physics client.
        vehicle: gives the collision radius and the looks.
        mass: kg.
        inertia: principal moments, kg m^2.

    Returns:
        Bullet's id of the body.
    """
    sphere = bullet.createCollisionShape(
        bullet.GEOM_SPHERE, radius=vehicle.radius, physicsClientId=client
    )
    body = bullet.createMultiBody(
        baseMass=mass,
        baseCollisionShapeIndex=sphere,
        baseVisualShapeIndex=_looks(bullet, client, vehicle),
        useMaximalCoordinates=False,
        physicsClientId=client,
    )
    bullet.changeDynamics(
        body,
        -1,
        linearDamping=0.0,
        angularDamping=0.0,
        jointDamping=0.0,
        localInertiaDiagonal=inertia,
        maxJointVelocity=1e6,  # Bullet would clamp angular velocity at 100 rad/s per component
        contactProcessingThreshold=0.0,  # no push before bodies touch
        physicsClientId=client,
    )
    return int(body)


def _looks(bullet: Any, client: int, vehicle: Vehicle) -> int:
    color = _COLORS.get(vehicle.token, _OTHER_COLOR)
    offset, arm = vehicle.arm / math.sqrt(2.0), vehicle.arm
    half_turns = [math.pi / 8, -math.pi / 8]
    bars = [[0.0, 0.0, math.sin(a), math.cos(a)] for a in half_turns]
    rotors = [[x * offset, y * offset, 0.012] for x in (1, -1) for y in (1, -1)]
    shape = bullet.createVisualShapeArray(
        shapeTypes=[bullet.GEOM_BOX] * 3 + [bullet.GEOM_CYLINDER] * 4,
        halfExtents=[[0.25 * arm, 0.25 * arm, 0.009]]
        + [[arm, 0.08 * arm, 0.004] for _ in bars]
        + [[0.0] * 3] * 4,
        radii=[0.0] * 3 + [vehicle.rotor_radius] * 4,
        lengths=[0.0] * 3 + [0.003] * 4,
        visualFramePositions=[[0.0] * 3] * 3 + rotors,
        visualFrameOrientations=[[0.0, 0.0, 0.0, 1.0], *bars] + [[0.0, 0.0, 0.0, 1.0]] * 4,
        rgbaColors=[_DARK] * 3 + [color] * 4,
        physicsClientId=client,
    )
    return int(shape)


def build_floor(bullet: Any, client: int) -> int:
    """Create the ground at z = 0, for contact response only; returns Bullet's id of it."""
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
    body = bullet.createMultiBody(
        baseMass=0.0, baseCollisionShapeIndex=plane, physicsClientId=client
    )
    return int(body)


def build_obstacle(bullet: Any, client: int, row: Sequence[float]) -> int:
    """Create a static obstacle from its row (7,); returns Bullet's id of it."""
    if row[0] == BOX:
        low, high = row[1:4], row[4:7]
        half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
        center = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
    else:
        center = [row[1], row[2], (row[4] + row[5]) / 2]
        shape = bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=row[3], height=row[5] - row[4], physicsClientId=client
        )
    body = bullet.createMultiBody(
        baseMass=0.0,
        baseCollisionShapeIndex=shape,
        basePosition=center,
        physicsClientId=client,
    )
    return int(body)
