"""A recorded episode as a self-contained HTML page, which needs no server and no network.

The page contains the data and a script that draws them. Its content security policy forbids all
requests.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.style import drone_colors, type_color
from swarm_envs.viewing.summary import (
    Event,
    events,
    metric_rows,
    near_misses,
    outcome,
    team_label,
)

__all__ = ["write_replay"]

_UNIT = {"position": 1e-3, "reference": 1e-3, "goal": 1e-3, "force": 0.01, "quaternion": 1e-4}
"""Units of the page's integers: m, grams, and 1 for quaternions."""
MOST_SAMPLES = 50_000
"""Largest number of drones times frames in a page; samples of longer flights are skipped."""
_FASTEST = 60.0  # Largest number of frames per second of a page
_LONGEST_ARROW_M = 0.45
_SCALES = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Possible lengths of an arrow of one gram, m; the longest that fits is used."""


def write_replay(path: Path, recording: Recording, most_samples: int = MOST_SAMPLES) -> None:
    """Write the replay page of a recording atomically.

    Args:
        path: the file, with the suffix `.html`.
        recording: the recording.
        most_samples: the largest number of drones times frames, besides frames of events.

    Raises:
        ValueError: the suffix is not `.html`.
        OSError: the file cannot be written.
    """
    if path.suffix != ".html":
        raise ValueError(f"the replay's path is {str(path)!r}, but must end in .html")
    page = replay_page(recording, most_samples)
    with written_whole(path) as partial:
        partial.write_text(page, encoding="utf-8")


def replay_page(recording: Recording, most_samples: int = MOST_SAMPLES) -> str:
    """Return the HTML of the page; the arguments are those of `write_replay`."""
    about, happened = recording.about, events(recording)
    marked = sorted([*happened, *near_misses(recording)], key=lambda event: event.frame)
    data = json.dumps(
        page_data(recording, marked, most_samples), separators=(",", ":"), allow_nan=False
    )
    seed = "" if about.seed is None else f", seed {about.seed}"
    good = bool(about.metrics) and bool(about.metrics["success"])
    flown = f"{about.physics} engine, {about.decision_rate} decisions per second"
    texts = {
        "title": escape(f"{about.task}, {team_label(recording.team)}, {about.agent or 'flight'}"),
        "subtitle": escape(f"{len(recording.team)} drones{seed}; {flown}"),
        "outcome": escape(outcome(recording)),
        "outcome_class": "good" if good else "bad" if happened else "",
        "error_name": "Tracking error" if _moves(recording.reference) else "Distance to goal",
        "legend": _legend(recording, marked),
        "metrics": "".join(
            f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>"
            for label, value in metric_rows(about.metrics)
        ),
        "css": asset("replay.css"),
        "scene": asset("scene.js"),
        "script": asset("replay.js"),
        "data": data.replace("</", "<\\/").replace("<!--", "<\\u0021--"),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: texts[found[1]], asset("replay.html"))


def page_data(
    recording: Recording, happened: Sequence[Event], most_samples: int = MOST_SAMPLES
) -> dict[str, Any]:
    """Return the data of the page: flat arrays of integers, ordered by frame and drone."""
    frames = _frames(recording, happened, most_samples)
    place = {int(frame): k for k, frame in enumerate(frames)}
    types = list(dict.fromkeys(recording.team))
    separation, touching = _separation(recording)
    arrays = {
        "position": recording.position,
        "quaternion": recording.quaternion,
        "force": recording.force / GRAM_FORCE,
        "reference": recording.reference,
        "goal": recording.goal,
    }
    return {
        "time": np.round(recording.time[frames], 5).tolist(),
        "unit": _UNIT,
        **{name: _integers(name, array, frames) for name, array in arrays.items()},
        "separation": np.round(separation[frames], 4).tolist() if len(separation) else [],
        "touching": np.round(touching[frames], 4).tolist() if len(touching) else [],
        "drones": [
            {"name": f"drone_{i}", "type": types.index(vehicle), "color": color}
            for i, (vehicle, color) in enumerate(
                zip(recording.team, drone_colors(recording.team), strict=True)
            )
        ],
        "types": [{"arm": v.arm, "rotor_radius": v.rotor_radius} for v in types],
        "arena": [list(corner) for corner in recording.about.arena],
        "solids": [np.round(s.rings(), 3).tolist() for s in recording.about.solids],
        "view": _framing(recording),
        "moving": _moves(recording.reference),
        "meter_per_gram": _arrow_scale(recording),
        "events": [
            {
                "frame": place[event.frame],
                "at": np.round(event.position, 3).tolist(),
                "text": event.text,
                "near": event.kind == "near miss",
            }
            for event in happened
        ],
    }


def _frames(recording: Recording, happened: Sequence[Event], most_samples: int) -> IntArray:
    """Return the indices of the page's samples: evenly spaced, and those of events."""
    steps, drones = recording.position.shape[:2]
    fast = recording.about.decision_rate / _FASTEST
    stride = max(1, int(np.ceil(fast)), int(np.ceil(steps * drones / most_samples)))
    kept = [*range(0, steps, stride), steps - 1, *(event.frame for event in happened)]
    return np.unique(np.array(kept, dtype=np.int64))


def _integers(name: str, array: FloatArray, frames: IntArray) -> list[int]:
    kept = array[frames] if name in ("position", "quaternion", "force") or _moves(array) else None
    values = array[:1] if kept is None else kept
    return [int(v) for v in np.rint(values / _UNIT[name]).ravel()]


def _moves(points: FloatArray) -> bool:
    return bool(np.ptp(points, axis=0).max() > 1e-9)


def _separation(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return smallest distance (T,) and contact distance of two drones, m; empty for one drone."""
    drones = len(recording.team)
    if drones < 2:
        return np.empty(0), np.empty(0)
    radius = np.array([vehicle.radius for vehicle in recording.team])
    one, other = np.triu_indices(drones, 1)
    nearest = np.empty((2, len(recording.time)))
    for k, p in enumerate(recording.position):
        distance = np.linalg.norm(p[one] - p[other], axis=1)
        pair = int(distance.argmin())
        nearest[:, k] = distance[pair], radius[one[pair]] + radius[other[pair]]
    return nearest[0], nearest[1]


def _framing(recording: Recording) -> dict[str, Any]:
    """Return center and radius, m, of a sphere that contains the flight and its goals."""
    seen = (recording.position, recording.goal, recording.reference)
    points = np.concatenate([array.reshape(-1, 3) for array in seen])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max()) + 0.2
    return {"center": np.round(middle, 3).tolist(), "radius": round(radius, 3)}


def _arrow_scale(recording: Recording) -> float:
    strongest = float(np.linalg.norm(recording.force, axis=-1).max()) / GRAM_FORCE
    fitting = [scale for scale in _SCALES if scale * strongest <= _LONGEST_ARROW_M]
    return fitting[0] if fitting else _SCALES[-1]


def _legend(recording: Recording, marked: Sequence[Event]) -> str:
    counts = Counter(vehicle.token for vehicle in recording.team)
    entries = [
        f'<span><i style="background:{type_color(token)}"></i>{count} × {escape(token)}</span>'
        for token, count in counts.items()
    ]
    scale = _arrow_scale(recording)
    entries.append("<span><b>◇</b>goal</span>")
    if _moves(recording.reference):
        entries.append("<span><b>○ ⋯</b>reference</span>")
    entries.append(
        f'<span><b style="color:#b0149b">→</b>interaction force: {10 * scale:.3g} m is 10 g</span>'
    )
    entries.append('<span><b class="bad">×</b>collision</span>')
    if any(event.kind == "near miss" for event in marked):
        entries.append('<span><b class="near">|</b>near miss</span>')
    return "".join(entries)


@cache
def asset(name: str) -> str:
    """Return the text of a file of the folder `page`."""
    folder = resources.files("swarm_envs.viewing").joinpath("page")
    return folder.joinpath(name).read_text(encoding="utf-8")
