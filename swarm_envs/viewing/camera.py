"""A camera that draws a swarm with Bullet's renderer on the CPU: it needs no display."""

from __future__ import annotations

import importlib
import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.physics.bullet_bodies import build_body
from swarm_envs.state import FloatArray, SwarmState
from swarm_envs.vehicles import Vehicle, parse_team
from swarm_envs.viewing.backdrop import Backdrop
from swarm_envs.viewing.lens import Lens, aim
from swarm_envs.viewing.overlay import Overlay, draw_behind

_BACKGROUND = -1
"""What Bullet's segmentation says where it drew nothing."""


class Camera:
    """Draws pictures of a team from states of any engine, in a Bullet client of its own.

    It stands still: it aims at the drones of the first picture, or at what `aim` was given, and
    aims anew only when a drone leaves the picture. Call `close()` when done.

    Args:
        team: the vehicles, N of them.
        width: of the picture, pixels.
        height: of the picture, pixels.
        azimuth_deg: where the camera stands seen from the swarm, counter-clockwise from x.
        elevation_deg: how far above the swarm's horizon it stands, 0 to 89.
        field_of_view_deg: vertical, 5 to 120.

    Raises:
        ImportError: pybullet is not installed.
        ValueError: the picture would be empty, or an angle is impossible.
    """

    def __init__(
        self,
        team: str | Sequence[Vehicle],
        width: int = 640,
        height: int = 400,
        *,
        azimuth_deg: float = -60.0,
        elevation_deg: float = 16.0,
        field_of_view_deg: float = 35.0,
    ) -> None:
        self.team = parse_team(team)
        _check("width", width, 16, 4096)
        _check("height", height, 16, 4096)
        _check("azimuth_deg", azimuth_deg, -360, 360)
        _check("elevation_deg", elevation_deg, 0, 89)
        _check("field_of_view_deg", field_of_view_deg, 5, 120)
        self.width, self.height = width, height
        self._angles = azimuth_deg, elevation_deg, field_of_view_deg
        self._radius = np.array([vehicle.radius for vehicle in self.team])
        self._backdrop: Backdrop | None = None
        self._matrices: tuple[Any, Any] = ((), ())
        self._bullet = _import_renderer()
        self._client = int(self._bullet.connect(self._bullet.DIRECT))
        if self._client < 0:
            raise RuntimeError("Bullet gave no client: too many are open; close() what is done")
        self._finalizer = weakref.finalize(self, self._bullet.disconnect, self._client)
        self._bodies = [
            build_body(self._bullet, self._client, vehicle, vehicle.mass, list(vehicle.inertia))
            for vehicle in self.team
        ]

    @property
    def lens(self) -> Lens:
        """Where the camera stands and what it sees.

        Raises:
            RuntimeError: it has not aimed yet.
        """
        if self._backdrop is None:
            raise RuntimeError("the camera has not aimed yet; call aim() or picture() first")
        return self._backdrop.lens

    def aim(self, points: npt.ArrayLike) -> None:
        """Stand so that points (..., 3), m, are in the picture, with room around them."""
        margin = 2.0 * float(self._radius.max()) + 0.05
        lens = aim(points, self.width, self.height, *self._angles, margin)
        self._backdrop = Backdrop(lens)
        view = self._bullet.computeViewMatrix(
            lens.eye.tolist(), (lens.eye + lens.forward).tolist(), [0.0, 0.0, 1.0]
        )
        opening = math.degrees(2.0 * math.atan(lens.tangent))
        projection = self._bullet.computeProjectionMatrixFOV(
            opening, self.width / self.height, 0.05, 100.0
        )
        self._matrices = view, projection

    def picture(self, state: SwarmState, overlay: Overlay | None = None) -> npt.NDArray[np.uint8]:
        """Draw a state.

        Args:
            state: its arrays lead with N alone, as those of `env.view.state`.
            overlay: what to draw behind the drones.

        Returns:
            (height, width, 3) RGB, a new array.

        Raises:
            ValueError: the state is not one of this team.
            RuntimeError: the camera is closed.
        """
        position = self._place(state)
        if self._backdrop is None or not self.lens.sees(position).all():
            self.aim(position)
        assert self._backdrop is not None
        picture = self._backdrop.draw(position, self._radius)
        if overlay is not None:
            picture = draw_behind(picture, self.lens, overlay)
        drones, drawn = self._draw_drones()
        picture[drawn] = drones[drawn]
        return picture

    def close(self) -> None:
        """Free Bullet's client. May be called more than once."""
        self._finalizer()

    def _place(self, state: SwarmState) -> FloatArray:
        if not self._finalizer.alive:
            raise RuntimeError("this camera is closed; make a new one")
        position, quaternion = np.asarray(state.position), np.asarray(state.quaternion)
        n = len(self.team)
        if position.shape != (n, 3) or quaternion.shape != (n, 4):
            raise ValueError(
                f"the state has positions of shape {position.shape}, but this camera's team needs "
                f"({n}, 3): give the state of one environment, without the leading axis"
            )
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            raise ValueError("the state holds NaN or infinity; it cannot be drawn")
        for body, p, q in zip(self._bodies, position.tolist(), quaternion.tolist(), strict=True):
            self._bullet.resetBasePositionAndOrientation(body, p, q, physicsClientId=self._client)
        return position

    def _draw_drones(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """Picture of the drones alone, and where they are in it.

        The floor is not Bullet's: its renderer takes five times as long with one.
        """
        shape = (self.height, self.width)
        _, _, colors, _, labels = self._bullet.getCameraImage(
            self.width,
            self.height,
            *self._matrices,
            lightDirection=(self.lens.right * 0.4 - self.lens.forward + self.lens.up * 2).tolist(),
            lightAmbientCoeff=0.75,
            lightDiffuseCoeff=0.55,
            lightSpecularCoeff=0.1,
            shadow=0,
            renderer=self._bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        rgba = np.asarray(colors, dtype=np.uint8).reshape(*shape, 4)
        return rgba[..., :3], np.asarray(labels).reshape(shape) != _BACKGROUND


def _import_renderer() -> Any:
    try:
        return importlib.import_module("pybullet")
    except ImportError as error:
        raise ImportError(
            f"drawing needs pybullet, which cannot be imported here ({error}). It has wheels for "
            "Linux x86-64 and CPython up to 3.11: `pip install pybullet`. Without it fly with "
            "render_mode=None and look at the replay page, which needs none: `swarm-envs fly "
            "--replay out.html`, or swarm_envs.viewing.replay.write_replay(path, recording)."
        ) from error


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} is {value}, but must lie in [{low}, {high}]")
