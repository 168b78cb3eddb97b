"""`BulletPhysics`: pybullet rigid bodies, one client an environment."""

from __future__ import annotations

import importlib
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import announce_compilation, entry_point
from swarm_envs.interactions import InteractionModel
from swarm_envs.motors import BatteryModel
from swarm_envs.physics.base import Physics
from swarm_envs.physics.bullet_bodies import build_body, build_floor, build_obstacle
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.physics.step import blow_and_prepare, take_bodies
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import GRAVITY, Vehicle

_ORIGIN = [0.0, 0.0, 0.0]


def bullet_available() -> bool:
    """Whether pybullet can be imported here: tried, since it may be there and broken.

    Python keeps the module once it was imported, so that asking again costs nothing.
    """
    try:
        import_bullet()
    except ImportError:
        return False
    return True


def import_bullet() -> Any:
    """Import pybullet.

    Raises:
        ImportError: it is not installed, or broken; the message says why and what to do.
    """
    try:
        bullet = importlib.import_module("pybullet")
        _ = bullet.connect  # any folder of that name on the path can be imported
    except Exception as error:  # a broken library fails in ways of its own
        missing = isinstance(error, ModuleNotFoundError) and error.name == "pybullet"
        state = "is not installed" if missing else "is installed, but does not work"
        raise ImportError(
            f"physics='bullet' needs pybullet, which {state} ({error}). It has wheels for Linux "
            "x86-64 and CPython up to 3.11: `pip install pybullet`. Elsewhere use "
            "physics='batch', which computes the same flight."
        ) from error
    return bullet


class BulletPhysics(Physics):
    """Rigid bodies in Bullet, built once for a team; a reset sets poses and velocities.

    Bullet's contacts give the response after a collision; collisions themselves are decided by
    `find_contacts`, as on the compiled engine. Call `close()` when done, or use it in `with`.

    Raises:
        ImportError: pybullet is not installed, or broken.
    """

    name = "bullet"

    def __init__(
        self,
        team: str | Sequence[Vehicle],
        num_envs: int = 1,
        interactions: str | Path | InteractionModel = "learned",
        *,
        arena: npt.ArrayLike | None = None,
        battery: BatteryModel | None = None,
        force_rate: int = PHYSICS_RATE,
        gusts: tuple[float, float] | None = None,
        obstacles: npt.ArrayLike | None = None,
    ) -> None:
        super().__init__(
            team,
            num_envs,
            interactions,
            arena=arena,
            battery=battery,
            force_rate=force_rate,
            gusts=gusts,
            obstacles=obstacles,
        )
        self._bullet = import_bullet()
        self.clients: list[int] = []
        self.bodies: list[list[int]] = []
        self._finalizer = weakref.finalize(self, _disconnect, self._bullet, self.clients)
        for e in range(num_envs):
            self.clients.append(self._connect())
            self.bodies.append(self._populate(e))
        self.wrench: FloatArray = np.zeros((len(self.team), 6))
        self._moved: FloatArray = np.zeros((len(self.team), 13))
        self._take: Callable[..., None] | None = None
        self._built = self._body_numbers()
        self._built_teams = list(self.teams)
        self.place_bodies(np.ones(num_envs, dtype=np.bool_))

    def __enter__(self) -> BulletPhysics:
        """Use as a context that closes itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def close(self) -> None:
        """Disconnect every client. May be called more than once."""
        self._finalizer()

    def _connect(self) -> int:
        bullet = self._bullet
        client = int(bullet.connect(bullet.DIRECT))
        if client < 0:
            raise RuntimeError(
                "Bullet gave no client: too many are open; close() environments that are done"
            )
        return client

    def _populate(self, e: int) -> list[int]:
        """Empty the world of environment `e` and build floor, obstacles and drones; their ids."""
        bullet, client = self._bullet, self._client(e)
        bullet.resetSimulation(physicsClientId=client)
        bullet.setTimeStep(TIME_STEP, physicsClientId=client)
        bullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
        build_floor(bullet, client)
        for row in self.obstacles.tolist():
            build_obstacle(bullet, client, row)
        return [
            build_body(bullet, client, vehicle, *self._inertia(e, i))
            for i, vehicle in enumerate(self.teams[e])
        ]

    def _inertia(self, e: int, i: int) -> tuple[float, list[float]]:
        return float(self.parameters.mass[e, i]), self.parameters.inertia[e, i].tolist()

    def _body_numbers(self) -> FloatArray:
        """(E, N, 4) mass and moments of inertia, as bodies are built from."""
        mass, inertia = self.parameters.mass, self.parameters.inertia
        return np.concatenate([mass[..., None], inertia], axis=-1)

    def _rebuild(self, e: int, i: int, body: int) -> None:
        mass, inertia = self._inertia(e, i)
        client = self._client(e)
        self._bullet.changeDynamics(
            body, -1, mass=mass, localInertiaDiagonal=inertia, physicsClientId=client
        )

    def place_bodies(self, mask: BoolArray) -> None:
        """Move the bodies of the environments in the mask to their states, masses included.

        Where other vehicles fly, all bodies are built anew: Bullet cannot change a body's shape.
        """
        wanted = self._body_numbers()
        changed = (wanted != self._built).any(axis=-1)
        for e in np.flatnonzero(mask).tolist():
            if self.teams[e] != self._built_teams[e]:
                self.bodies[e], self._built_teams[e] = self._populate(e), self.teams[e]
            else:
                for i in np.flatnonzero(changed[e]).tolist():
                    self._rebuild(e, i, self.bodies[e][i])
            self._built[e] = wanted[e]
            self.settle(e)

    def settle(self, e: int) -> None:
        """Put the bodies of environment `e` where its state says, to the last bit.

        Bullet keeps attitudes in a form of its own, and rounds one that it is given. Done between
        decisions, this makes the state all there is: what is restored from it goes on alike.
        """
        state, bullet, client = self._state, self._bullet, self._client(e)
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

    def _client(self, e: int) -> int:
        if not self.clients:
            raise RuntimeError("this BulletPhysics is closed; make a new one")
        return self.clients[e]

    def _advance(self, commands: FloatArray, external: FloatArray) -> None:
        announce_compilation(blow_and_prepare)
        for e in range(self.num_envs):
            blow_and_prepare(e, self.world, commands, external, self.wrench)
            self.move_bodies(e)

    def move_bodies(self, e: int) -> None:
        """Advance the bodies of environment `e` by one step under `wrench`, unchecked."""
        client, bodies, bullet = self._client(e), self.bodies[e], self._bullet
        push, turn, link = bullet.applyExternalForce, bullet.applyExternalTorque, bullet.LINK_FRAME
        for body, row in zip(bodies, self.wrench.tolist(), strict=True):
            push(body, -1, row[:3], _ORIGIN, link, client)
            turn(body, -1, row[3:], link, client)
        bullet.stepSimulation(client)
        pose, twist = bullet.getBasePositionAndOrientation, bullet.getBaseVelocity
        self._moved[:] = [
            (*position, *quaternion, *velocity, *rate)
            for (position, quaternion), (velocity, rate) in [
                (pose(body, client), twist(body, client)) for body in bodies
            ]
        ]
        if self._take is None:
            self._take = entry_point(take_bodies, e, self.world, self._moved)
        self._take(e, self.world, self._moved)


def _disconnect(bullet: Any, clients: list[int]) -> None:
    while clients:
        bullet.disconnect(clients.pop())
