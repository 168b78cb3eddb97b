"""`BulletPhysics`: rigid bodies in pybullet, with one client for each environment."""

from __future__ import annotations

import importlib
import weakref
from collections.abc import Sequence
from struct import Struct
from typing import Any

import numpy as np

from swarm_envs.physics.base import Physics
from swarm_envs.physics.contact import BOX
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.physics.step import BEGIN, CONTACTS, CONTROL, FORCES
from swarm_envs.physics.workers import Call
from swarm_envs.state import BoolArray, IntArray
from swarm_envs.vehicles import GRAVITY, Vehicle

__all__ = ["build_body", "import_bullet"]


def build_body(
    bullet: Any, client: int, vehicle: Vehicle, mass: float, inertia: list[float]
) -> int:
    """Create a vehicle's body, free, undamped and without a limit of its angular velocity.

    Args:
        bullet: the pybullet module.
        client: id of the physics client.
        vehicle: the vehicle, for the collision radius.
        mass: mass, kg.
        inertia: principal moments of inertia, kg m^2.

    Returns:
        Bullet's id of the body.
    """
    sphere = bullet.createCollisionShape(
        bullet.GEOM_SPHERE, radius=vehicle.radius, physicsClientId=client
    )
    body = bullet.createMultiBody(
        baseMass=mass,
        baseCollisionShapeIndex=sphere,
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
        maxJointVelocity=1e6,  # by default Bullet clamps angular velocities at 100 rad/s
        contactProcessingThreshold=0.0,  # no contact force before bodies touch
        physicsClientId=client,
    )
    return int(body)


def build_floor(bullet: Any, client: int) -> int:
    """Create the ground at z = 0, for contact forces; return Bullet's id of it."""
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
    body = bullet.createMultiBody(
        baseMass=0.0, baseCollisionShapeIndex=plane, physicsClientId=client
    )
    return int(body)


def build_obstacle(bullet: Any, client: int, row: Sequence[float]) -> int:
    """Create a static obstacle from its row (7,); return Bullet's id of it."""
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
        baseMass=0.0, baseCollisionShapeIndex=shape, basePosition=center, physicsClientId=client
    )
    return int(body)


_ORIGIN = [0.0, 0.0, 0.0]
_BODY = Struct("13d")
"""The first columns of a drone: position, quaternion, velocity, angular velocity."""


def bullet_available() -> bool:
    """Return True if pybullet can be imported; an installed one may be broken."""
    try:
        import_bullet()
    except ImportError:
        return False
    return True


def import_bullet() -> Any:
    """Import pybullet.

    Raises:
        ImportError: it is not installed or broken; the message gives the reason and the fix.
    """
    try:
        bullet = importlib.import_module("pybullet")
        _ = bullet.connect  # since any folder of this name on the path can be imported
    except Exception as error:  # a broken library may raise anything
        missing = isinstance(error, ModuleNotFoundError) and error.name == "pybullet"
        state = "is not installed" if missing else "is installed, but does not work"
        raise ImportError(
            f"physics='bullet' needs pybullet, which {state} ({error}). It has wheels for Linux "
            "x86-64 and CPython up to 3.11: `pip install pybullet`. Elsewhere use "
            "physics='batch', which computes the same flight."
        ) from error
    return bullet


class BulletPhysics(Physics):
    """The Bullet engine.

    Collisions are detected by the phase `CONTACTS` of `fly`, as on the compiled engine. Bullet
    computes contact forces only if a contact ends the team's episode; otherwise bodies pass through
    each other. Call `close()` at the end, or use it in a `with` statement.

    Raises:
        ImportError: pybullet is not installed or broken.
    """

    name = "bullet"

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._bullet = import_bullet()
        self.clients: list[int] = []
        self.bodies: list[list[int]] = []
        self._finalizer = weakref.finalize(self, _disconnect, self._bullet, self.clients)
        super().__init__(*arguments, **options)
        self.reset()

    def __enter__(self) -> BulletPhysics:
        """Return the engine, which is closed at the end of the `with` statement."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the engine."""
        self.close()

    def close(self) -> None:
        """Disconnect every client. May be called more than once."""
        super().close()
        self._finalizer()

    def _populate(self, e: int) -> list[int]:
        """Build floor, obstacles and drones of environment `e` anew; return the drones' ids."""
        bullet, client = self._bullet, self.clients[e]
        bullet.resetSimulation(physicsClientId=client)
        bullet.setTimeStep(TIME_STEP, physicsClientId=client)
        bullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
        build_floor(bullet, client)
        for row in self.obstacles.tolist():
            build_obstacle(bullet, client, row)
        bodies = [
            build_body(bullet, client, vehicle, *inertia)
            for vehicle, inertia in zip(self.teams[e], self._inertias(e), strict=True)
        ]
        if not self.settings["ends_team"][0]:
            for body in bodies:  # no group and no mask: no collisions
                bullet.setCollisionFilterGroupMask(body, -1, 0, 0, physicsClientId=client)
        return bodies

    def _inertias(self, e: int) -> list[tuple[float, list[float]]]:
        """Return the mass and moments of inertia of each drone of environment `e`."""
        drones = self.world.drones[e]
        return list(zip(drones["mass"].tolist(), drones["inertia"].tolist(), strict=True))

    def place_bodies(self, where: IntArray) -> None:
        """Set poses, velocities and masses of the bodies in environments (M,).

        If the team has changed, all bodies are built anew: Bullet cannot change a body's shape.
        """
        if not self.bodies:
            self._build()
        self._check_open()
        for e in where.tolist():
            inertias, built = self._inertias(e), self._built[e]
            if self.teams[e] != self._built_teams[e]:
                self.bodies[e], self._built_teams[e] = self._populate(e), self.teams[e]
            else:
                for body, new, old in zip(self.bodies[e], inertias, built, strict=True):
                    if new != old:
                        mass, inertia = new
                        self._bullet.changeDynamics(
                            body, -1, mass=mass, localInertiaDiagonal=inertia,
                            physicsClientId=self.clients[e],
                        )  # fmt: skip
            self._built[e] = inertias
            self.settle(e)

    def _build(self) -> None:
        every = range(self.num_envs)
        for e in every:
            client = int(self._bullet.connect(self._bullet.DIRECT))
            if client < 0:
                raise RuntimeError(
                    "Bullet created no client: too many are open; close() other environments"
                )
            self.clients.append(client)
            self.bodies.append(self._populate(e))
        self._built, self._built_teams = list(map(self._inertias, every)), list(self.teams)
        self._memory = self._columns.data.cast("B")
        self._active, self._tumbling = self.world.drones["active"], self.world.drones["tumbling"]
        wrenches = self.world.drones["wrench"]
        self._wrenches = wrenches.reshape(*wrenches.shape[:2], 2, 3)  # views of force and torque

    def settle(self, e: int) -> None:
        """Set the bodies of environment `e` to the state of the drones.

        Bullet rounds attitudes when it stores them. Setting them after every decision makes a
        flight depend only on the state, so that a restored snapshot continues bitwise identically.
        """
        state, bullet, client = self.state, self._bullet, self.clients[e]
        pose, twist = bullet.resetBasePositionAndOrientation, bullet.resetBaseVelocity
        rows = zip(
            self.bodies[e],
            state.position[e].tolist(),
            state.quaternion[e].tolist(),
            state.velocity[e].tolist(),
            state.angular_velocity[e].tolist(),
            strict=True,
        )
        for body, position, quaternion, velocity, rate in rows:
            pose(body, position, quaternion, client)
            twist(body, velocity, rate, client)

    def _check_open(self) -> None:
        if not self.clients:
            raise RuntimeError("this BulletPhysics is closed; make a new one")

    def fly(self, steps: int, flown: BoolArray, then: Call = lambda *_: None) -> None:
        """Simulate the physics steps of a decision; see `Physics.fly`."""
        self._step_bodies(CONTROL | FORCES, steps, np.ascontiguousarray(flown), settles=True)
        then(0, self.num_envs, 0)

    def _advance(self) -> None:
        self._step_bodies(FORCES, 1, self._everywhere, settles=False)

    def _step_bodies(self, before: int, steps: int, flown: BoolArray, settles: bool) -> None:
        """Make physics steps, with Bullet in place of the phase INTEGRATE.

        One call of the kernel ends a step and begins the next, to load and store only once.

        Args:
            before: phases before INTEGRATE.
            steps: number of steps of 1/240 s.
            flown: (E,) environments to simulate.
            settles: True to set the bodies to the state after the last step, as `settle` does.
        """
        if not self.clients:
            self._check_open()
        kernel, given, where = self._compiled, (1, flown, *self._given[0]), flown.nonzero()[0]
        ends_team, bounces = bool(self.settings["ends_team"][0]), bool(self.settings["bounces"][0])
        for k in range(steps):
            if self._functions:
                self._call_functions(flown)
            kernel(0, self.num_envs, before | (CONTACTS if k else BEGIN), *given)
            for e in where.tolist():
                if k and bounces:
                    self.settle(e)
                self._move_bodies(e, settles and k == steps - 1, ends_team)
        kernel(0, self.num_envs, CONTACTS, *given)
        if not ends_team:  # drones that bounced or ended are not at their bodies
            for e in where.tolist():
                self.settle(e)

    def _move_bodies(self, e: int, settles: bool, ends_team: bool) -> None:
        """Let Bullet advance the bodies of environment `e`, and write their states.

        A drone that tumbles is not advanced, nor its team if their episode ends. Numbers are packed
        into the memory of the drones, which is faster than creating an array.
        """
        tumbles = self._tumbling[e].tolist()
        if ends_team and any(tumbles):
            self.settle(e)
            return
        bullet, client, bodies = self._bullet, self.clients[e], self.bodies[e]
        push, turn, link = bullet.applyExternalForce, bullet.applyExternalTorque, bullet.LINK_FRAME
        for body, (force, torque) in zip(bodies, self._wrenches[e].tolist(), strict=True):
            push(body, -1, force, _ORIGIN, link, client)
            turn(body, -1, torque, link, client)
        bullet.stepSimulation(client)
        pose, twist = bullet.getBasePositionAndOrientation, bullet.getBaseVelocity
        put, set_off = bullet.resetBasePositionAndOrientation, bullet.resetBaseVelocity
        write, memory, size = _BODY.pack_into, self._memory, self.world.drones.itemsize
        offset = e * len(bodies) * size
        for body, active, stays in zip(bodies, self._active[e].tolist(), tumbles, strict=True):
            (position, quaternion), (velocity, rate) = pose(body, client), twist(body, client)
            if active and not stays:
                write(memory, offset, *position, *quaternion, *velocity, *rate)
            offset += size
            if settles:
                put(body, position, quaternion, client)
                set_off(body, velocity, rate, client)


def _disconnect(bullet: Any, clients: list[int]) -> None:
    while clients:
        bullet.disconnect(clients.pop())
