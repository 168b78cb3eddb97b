"""Skybrush's compiled shows (.skyc): a zip with `show.json`, whose curves are those of the show.

A trajectory is a list of `[time, point, control points]`, of cubic Bezier curves, and a light
program is the bytecode of Skybrush's LED controller in base64: colours that are faded to, durations
in 1/50 s (github.com/skybrush-io: show-format, pyledctrl).
"""

from __future__ import annotations

import base64
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.shows.planning import Show
from swarm_envs.state import FloatArray

__all__ = ["write_skyc"]

_END, _SET_COLOR, _FADE_TO_COLOR = 0x00, 0x04, 0x08
_TICKS = 50
TAKEOFF_S = 2.0  # Time in which drones rise from the floor to where the paths begin, and back, s


def write_skyc(path: Path, show: Show, title: str) -> None:
    """Write a show for Skybrush, whole or not at all.

    Drones rise from the floor before the show and land after it.

    Raises:
        OSError: the file cannot be written.
    """
    content = json.dumps(show_content(show, title), separators=(",", ":"), allow_nan=False)
    with written_whole(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        entry = zipfile.ZipInfo("show.json", (1980, 1, 1, 0, 0, 0))
        entry.compress_type = zipfile.ZIP_DEFLATED
        archive.writestr(entry, content)


def show_content(show: Show, title: str) -> dict[str, Any]:
    """The content of `show.json`."""
    speed, _ = show.paths.largest()
    count = show.light_colors.shape[1]
    cues = [{"name": name, "time": round(time + TAKEOFF_S, 3)} for name, time in show.cues]
    limits = {"maxVelocityXY": round(speed + 0.01, 2), "maxVelocityZ": round(speed + 0.01, 2)}
    return {
        "version": 1,
        "meta": {"title": title},
        "environment": {"type": "indoor"},
        "settings": {"cues": {"version": 1, "items": cues}, "validation": limits},
        "swarm": {"drones": [_drone(show, i) for i in range(count)]},
    }


def _drone(show: Show, i: int) -> dict[str, Any]:
    points = trajectory_points(show, i)
    settings = {
        "name": f"drone_{i}",
        "home": points[0][1],
        "trajectory": {"version": 1, "points": points, "takeoffTime": 0},
        "lights": {"version": 1, "data": base64.b64encode(light_program(show, i)).decode()},
    }
    return {"type": "generic", "settings": settings}


def trajectory_points(show: Show, i: int) -> list[list[Any]]:
    """Times, s, points and control points, m, of a drone, with its take-off and landing."""
    knots, pieces = show.paths.knots + TAKEOFF_S, show.paths.points[:, :, i]
    first, last = pieces[0, 0], pieces[-1, -1]
    low = np.array([1.0, 1.0, 0.0])
    rows: list[list[Any]] = [[0.0, _rounded(first * low), []]]
    rows.append([TAKEOFF_S, _rounded(first), [_rounded(first * low), _rounded(first)]])
    for end, piece in zip(knots[1:], pieces):
        control = [] if (piece == piece[0]).all() else [_rounded(p) for p in piece[1:3]]
        rows.append([round(float(end), 3), _rounded(piece[3]), control])
    landing = [_rounded(last), _rounded(last * low)]
    return [*rows, [round(float(knots[-1]) + TAKEOFF_S, 3), landing[1], landing]]


def _rounded(point: FloatArray) -> list[float]:
    return [round(float(x), 4) for x in point]


def light_program(show: Show, i: int) -> bytes:
    """The bytecode of a drone's light: dark at first, then faded to each colour."""
    ticks = np.rint((show.light_times + TAKEOFF_S) * _TICKS).astype(int)
    colors = np.rint(255.0 * show.light_colors[:, i]).astype(int)
    code = bytes([_SET_COLOR, 0, 0, 0, 0])
    for color, duration in zip(colors, np.diff(ticks, prepend=0)):
        code += bytes([_FADE_TO_COLOR, *color.tolist()]) + _variable(int(duration))
    return code + bytes([_END])


def _variable(value: int) -> bytes:
    """An unsigned integer, seven bits a byte, lowest first."""
    parts = [value & 0x7F]
    while value := value >> 7:
        parts[-1] |= 0x80
        parts.append(value & 0x7F)
    return bytes(parts)
