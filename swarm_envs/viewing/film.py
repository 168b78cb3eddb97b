"""The film of a recorded episode, in real time."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from swarm_envs.state import SwarmState
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.camera import Camera
from swarm_envs.viewing.overlay import Overlay
from swarm_envs.viewing.palette import drone_colors
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.summary import outcome, team_label
from swarm_envs.viewing.typeface import font

WIDTH, HEIGHT, FPS = 768, 544, 24
"""Size of a picture, pixels, and pictures per second."""
_HEADER = 40
_SMOOTH = 2
_TRAIL_S = 2.0
_REST_S = 1.0
"""The last frame stands so long, to be read."""
_METRE_PER_GRAM = 0.012
_WEAKEST_N = 0.5 * GRAM_FORCE
_INK, _QUIET, _PAPER = "#1c2127", "#5c6670", "#ffffff"


def count_frames(recording: Recording) -> int:
    """How many frames the film has."""
    return math.ceil((float(recording.time[-1]) + _REST_S) * FPS) + 1


def film(recording: Recording) -> Iterator[npt.NDArray[np.uint8]]:
    """Frames (544, 768, 3) of an episode at 24 a second; its end stands for another second.

    Raises:
        ImportError: pybullet is not installed.
    """
    size = (_SMOOTH * WIDTH, _SMOOTH * (HEIGHT - _HEADER))
    camera = Camera(recording.team, *size)
    try:
        seen = (recording.position, recording.goal, recording.reference)
        camera.aim(np.concatenate([array.reshape(-1, 3) for array in seen]))
        for k in range(count_frames(recording)):
            yield _frame(camera, recording, k / FPS)
    finally:
        camera.close()


def _frame(camera: Camera, recording: Recording, time: float) -> npt.NDArray[np.uint8]:
    from PIL import Image, ImageDraw

    index = int(np.searchsorted(recording.time, time + 1e-9)) - 1
    scene = camera.picture(_state(recording, index), _overlay(recording, index))
    canvas = Image.new("RGB", (WIDTH, HEIGHT), _PAPER)
    canvas.paste(Image.fromarray(scene).reduce(_SMOOTH), (0, _HEADER))
    pen, about = ImageDraw.Draw(canvas), recording.about
    seed = "" if about.seed is None else f", seed {about.seed}"
    title = f"{about.task}, {team_label(recording.team)}, {about.agent}{seed}"
    pen.text((16, 11), title, fill=_INK, font=font(15, bold=True))
    clock = f"{recording.time[index]:.2f} s"
    pen.text((WIDTH - 16, 11), clock, fill=_INK, font=font(15), anchor="ra")
    if index == len(recording.time) - 1:
        pen.text((16, HEIGHT - 30), outcome(recording), fill=_QUIET, font=font(15, bold=True))
    return np.asarray(canvas)


def _state(recording: Recording, index: int) -> SwarmState:
    return SwarmState(
        position=recording.position[index],
        velocity=recording.velocity[index],
        quaternion=recording.quaternion[index],
        angular_velocity=np.zeros_like(recording.velocity[index]),
        rotor_thrust=recording.rotor_thrust[index],
        battery=np.ones(len(recording.team)),
    )


def _overlay(recording: Recording, index: int) -> Overlay:
    now = recording.time[index]
    first = int(np.searchsorted(recording.time, now - _TRAIL_S))
    position, force = recording.position[index], recording.force[index]
    strong = np.linalg.norm(force, axis=-1) > _WEAKEST_N
    tips = position + _METRE_PER_GRAM / GRAM_FORCE * force
    reference, goal = recording.reference[index], recording.goal[index]
    return Overlay(
        colors=drone_colors(recording.team),
        arena=np.array(recording.about.arena),
        solids=recording.about.solids,
        goals=goal,
        references=None if np.array_equal(reference, goal) else reference,
        trails=recording.position[first : index + 1],
        arrows=np.stack([position, tips], axis=1)[strong],
        enlarged=True,
    )
