"""The shapes of the drones: a dark body on two bars, and four colored rotors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Team, Vehicle
from swarm_envs.viewing.lens import Lens

__all__ = ["Airframes"]

_DARK = (38, 38, 46)
_BODY_HALF_M, _BAR_HALF_M = 0.009, 0.004
_ROTOR_M = (0.0105, 0.0135)  # Heights of a rotor's lower and upper side
_RIM = 20  # Number of corners of a rotor
_AMBIENT, _DIFFUSE = 0.8, 0.2

Face = tuple[list[float], tuple[int, int, int]]  # x, y, x, y, ... of its corners; its color


class Airframes:
    """The faces of N drones in the view of a lens.

    Args:
        team: the vehicles.
    """

    def __init__(self, team: Team) -> None:
        self._boxes = np.array([_boxes(vehicle) for vehicle in team])
        self._rotors = np.array([_rotors(vehicle) for vehicle in team])

    def faces(
        self,
        lens: Lens,
        position: FloatArray,
        quaternion: FloatArray,
        inks: Sequence[Sequence[int]],
    ) -> list[list[Face]]:
        """Return the visible faces of each drone, in the order in which they are drawn.

        Args:
            lens: the lens of the canvas.
            position: (N, 3) m.
            quaternion: (N, 4) attitudes, body to world.
            inks: N colors of the rotors: red, green, blue, 0 to 255.
        """
        n = len(position)
        turn = Rotation.from_quat(quaternion).as_matrix()
        boxes = _placed(self._boxes, turn, position)
        normals = np.cross(boxes[:, :, 1] - boxes[:, :, 0], boxes[:, :, 2] - boxes[:, :, 1])
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        seen = ((lens.eye - boxes[:, :, 0]) * normals).sum(axis=-1) > 0.0
        over = ((lens.eye - position) * turn[:, :, 2]).sum(axis=-1) > 0.0
        up = np.where(over[:, None], turn[:, :, 2], -turn[:, :, 2])
        light = _light(lens)
        dark = _shaded(np.array(_DARK), normals @ light).tolist()
        bright = _shaded(np.array(inks, dtype=float)[:, :3], up @ light).tolist()
        frames = lens.project(boxes).reshape(n, -1, 8).tolist()
        rotors = lens.project(_placed(self._rotors, turn, position)).reshape(n, 8, -1).tolist()
        drones = []
        for i in range(n):
            frame = [(frames[i][k], tuple(dark[i][k])) for k in np.flatnonzero(seen[i])]
            discs = [(rotor, tuple(bright[i])) for rotor in rotors[i]]
            drones.append([*frame, *discs] if over[i] else [*discs, *frame])
        return drones


def _placed(points: FloatArray, turn: FloatArray, position: FloatArray) -> FloatArray:
    """Transform points (N, F, K, 3) by rotations (N, 3, 3) and positions (N, 3)."""
    return np.asarray(points @ turn.swapaxes(1, 2)[:, None] + position[:, None, None])


def _light(lens: Lens) -> FloatArray:
    """Return the direction to the light: above the camera, slightly to the right."""
    toward = 0.4 * lens.right + 2.0 * lens.up - lens.forward
    return np.asarray(toward / np.linalg.norm(toward))


def _shaded(colors: FloatArray, cosine: FloatArray) -> npt.NDArray[np.int64]:
    lit = _AMBIENT + _DIFFUSE * np.maximum(cosine, 0.0)
    return np.minimum(np.rint(colors * lit[..., None]), 255.0).astype(np.int64)


def _boxes(vehicle: Vehicle) -> FloatArray:
    """Return the faces (18, 4, 3) of bars and body, counter-clockwise from outside, m."""
    arm = vehicle.arm
    bars = [_box((arm, 0.08 * arm, _BAR_HALF_M), yaw) for yaw in (math.pi / 4, -math.pi / 4)]
    return np.concatenate([*bars, _box((0.25 * arm, 0.25 * arm, _BODY_HALF_M), 0.0)])


def _box(half: tuple[float, float, float], yaw: float) -> FloatArray:
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    top = np.column_stack([square, np.ones(4)])
    faces = []
    for axis in range(3):  # `top` is +z; cyclic permutations give +x and +y
        face = np.roll(top, axis + 1, axis=1)
        faces += [face, -face[::-1]]
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(np.array(faces) * half @ turn.T)


def _rotors(vehicle: Vehicle) -> FloatArray:
    """Return the rims (8, 20, 3) of both sides of the rotors, m."""
    angle = 2 * np.pi * np.arange(_RIM) / _RIM
    rim = vehicle.rotor_radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_RIM)])
    offset = vehicle.arm / math.sqrt(2.0)
    hubs = [[x * offset, y * offset, z] for z in _ROTOR_M for x in (1, -1) for y in (1, -1)]
    return np.asarray(np.array(hubs)[:, None] + rim)
