"""A show from its formations: transitions, rests and lights on one clock; its file for Skybrush.

Skybrush's compiled shows (.skyc) are a zip with `show.json`, whose curves are those of the show.
A trajectory is a list of `[time, point, control points]`, of cubic Bezier curves, and a light
program is the bytecode of Skybrush's LED controller in base64: colours that are faded to, durations
in 1/50 s (github.com/skybrush-io: show-format, pyledctrl).
"""

from __future__ import annotations

import base64
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.files import written_whole
from swarm_envs.shows.choreography import Choreography, hold, joined
from swarm_envs.shows.formations import Formation, Room
from swarm_envs.shows.transitions import Pace, Transition, assigned, labelled
from swarm_envs.state import FloatArray

__all__ = ["plan_show", "write_skyc"]


@dataclass(frozen=True, eq=False)
class Show:
    """What N drones fly and show, from the ground to the ground."""

    paths: Choreography  # Where they should be
    light_times: FloatArray
    """(L,) s, increasing from 0 to the end; between them colours change linearly."""
    light_colors: FloatArray  # (L, N, 3) red, green and blue in [0, 1]
    cues: tuple[tuple[str, float], ...]  # Each formation and the time at which it stands, s
    transitions: tuple[Transition, ...]  # The ways between them

    @property
    def least(self) -> float:
        """A lower bound of the scaled distance of two drones at any time, m."""
        return min(transition.least for transition in self.transitions)

    def colors(self, times: FloatArray) -> FloatArray:
        """(T, N, 3) colours at times (T,), s."""
        known = self.light_times
        k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
        share = np.clip((times - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0)[:, None, None]
        return np.asarray((1 - share) * self.light_colors[k] + share * self.light_colors[k + 1])

    def facts(self) -> dict[str, Any]:
        """What was planned, as JSON has it."""
        speed, acceleration = self.paths.largest()
        rows = [
            {
                "to": name,
                "seconds": way.paths.duration_s,
                "alone_s": way.alone_s,
                "ratio": way.paths.duration_s / way.alone_s,
                "least_distance_m": way.least,
            }
            for (name, _), way in zip(self.cues, self.transitions, strict=True)
        ]
        return {
            "drones": self.light_colors.shape[1],
            "duration_s": self.paths.duration_s,
            "least_distance_m": self.least,
            "largest_speed_m_s": speed,
            "largest_acceleration_m_s2": acceleration,
            "transitions": rows,
        }


def plan_show(
    formations: Sequence[Formation],
    room: Room,
    pace: Pace,
    hold_s: float = 3.0,
    labels: bool = False,
    seed: int = 0,
    watch: Callable[[str], None] = lambda _: None,
) -> Show:
    """Fly from formation to formation and rest at each.

    Args:
        formations: at least two, of as many drones; the first is where they begin.
        room: the spacing that is kept.
        pace: the limits that are kept.
        hold_s: rest at each formation but the first and the last, s.
        labels: whether drone i has place i of every formation; where a show begins and ends on the
            same places, each drone returns to its own. If not, any drone takes any place.
        seed: of labelled ways.
        watch: called with the name of each formation when the way to it is planned.

    Raises:
        ValueError: the spacing cannot be kept.
    """
    here = formations[0].places
    if labels:  # who begins where is free
        here = assigned(formations[1].places, here, room, pace).paths.points[-1, -1]
    home, colors = here, formations[0].colors
    parts, lights, times, cues, ways = [], [colors], [0.0], [], []
    for k, goal in enumerate(formations[1:], start=1):
        watch(goal.name)
        ends = k == len(formations) - 1
        if labels:
            places = home if ends and goal is formations[0] else goal.places
            way = labelled(here, places, room, pace, seed + k)
        else:
            way = assigned(here, goal.places, room, pace)
        here = way.paths.points[-1, -1]
        colors = goal.colors[cKDTree(goal.places).query(here)[1]]
        rest_s = 1.0 if ends else hold_s
        parts += [way.paths, hold(here, rest_s)]
        times += [times[-1] + way.paths.duration_s, times[-1] + way.paths.duration_s + rest_s]
        lights += [colors, colors]
        cues.append((goal.name, times[-2]))
        ways.append(way)
    return Show(joined(parts), np.array(times), np.array(lights), tuple(cues), tuple(ways))


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
