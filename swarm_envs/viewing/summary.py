"""Summary of an episode as text: outcome, collisions and metrics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import NEAR_MISS
from swarm_envs.vehicles import Vehicle, team_string
from swarm_envs.viewing.record import Recording

__all__ = ["events", "metric_rows", "outcome"]

_LONGEST_TEAM = 6
_UNITS = {"_m": "m", "_s": "s", "_g": "g", "_j": "J"}


class Event(NamedTuple):
    """A collision or tumble at its first sample, or a near miss at its closest sample."""

    frame: int  # Index of the sample
    time: float  # s
    kind: str  # `drone`, `floor`, `wall`, `obstacle`, `tumbling` or `near miss`
    drones: tuple[int, ...]  # Indices of the one or two drones
    position: FloatArray  # (3,) m
    text: str  # Description


_ALONE = {
    "floor": ("contact_floor", "hits the floor"),
    "wall": ("contact_wall", "hits a wall"),
    "obstacle": ("contact_obstacle", "hits an obstacle"),
    "tumbling": ("tumbling", "tumbles"),
}
"""Field of the recording and verb of each kind of event of a single drone."""


def team_label(team: Sequence[Vehicle]) -> str:
    """Return a short label of a team: its string, or the number of each type if that is long."""
    if len(team) <= _LONGEST_TEAM:
        return team_string(team)
    counts = Counter(vehicle.token for vehicle in team)
    return " + ".join(f"{count} {token}" for token, count in counts.items())


def events(recording: Recording) -> list[Event]:
    """Return the collisions and tumbles of an episode in order of time, each at its beginning."""
    return sorted([*_pairs(recording), *_alone(recording)], key=lambda event: event.frame)


def near_misses(recording: Recording) -> list[Event]:
    """Return encounters of two drones within 1.5 times the sum of their radii without contact.

    They are in order of time, each at the sample where the drones are closest. Unlike the metric of
    that name, they depend only on the samples, one per decision.
    """
    found = [event for pair in _close_pairs(recording) for event in _encounters(recording, *pair)]
    return sorted(found, key=lambda event: event.frame)


def _close_pairs(recording: Recording) -> list[tuple[int, int]]:
    """Return the pairs that come within 1.5 times the sum of their radii at some sample."""
    radius = np.array([vehicle.radius for vehicle in recording.team])
    limit = NEAR_MISS * (radius[:, None] + radius)
    close = np.zeros(limit.shape, dtype=np.bool_)
    for p in recording.position:
        close |= np.linalg.norm(p[:, None] - p, axis=-1) < limit
    return [(i, j) for i, j in np.argwhere(np.triu(close, 1)).tolist()]


def _encounters(recording: Recording, i: int, j: int) -> Iterator[Event]:
    distance = np.linalg.norm(recording.position[:, i] - recording.position[:, j], axis=-1)
    touching = recording.team[i].radius + recording.team[j].radius
    hit = (recording.contact_drone[:, i] == j) | (recording.contact_drone[:, j] == i)
    close = np.concatenate([[False], (distance < NEAR_MISS * touching) | hit, [False]])
    edges = np.flatnonzero(np.diff(close.astype(np.int8))).reshape(-1, 2)
    for first, end in edges.tolist():
        frame = first + int(distance[first:end].argmin())
        if hit[first:end].any() or distance[frame] < touching:
            continue
        middle = recording.position[frame, [i, j]].mean(axis=0)
        text = f"drone_{i} and drone_{j} come within {distance[frame]:.2f} m"
        yield _event(recording, frame, "near miss", (i, j), middle, text)


def _pairs(recording: Recording) -> Iterator[Event]:
    before: set[tuple[int, ...]] = set()
    for frame, others in enumerate(recording.contact_drone):
        touching = {tuple(sorted((i, j))) for i, j in enumerate(others.tolist()) if j >= 0}
        for i, j in sorted(touching - before):
            middle = recording.position[frame, [i, j]].mean(axis=0)
            text = f"drone_{i} and drone_{j} collide"
            yield _event(recording, frame, "drone", (i, j), middle, text)
        before = touching


def _alone(recording: Recording) -> Iterator[Event]:
    for kind, (field, verb) in _ALONE.items():
        touched = np.asarray(getattr(recording, field))
        on = touched if touched.dtype == np.bool_ else touched >= 0
        begins = on & ~np.concatenate([np.zeros_like(on[:1]), on[:-1]])
        for frame, i in np.argwhere(begins).tolist():
            place, text = recording.position[frame, i], f"drone_{i} {verb}"
            yield _event(recording, frame, kind, (i,), place, text)


def _event(
    recording: Recording,
    frame: int,
    kind: str,
    drones: tuple[int, ...],
    position: FloatArray,
    text: str,
) -> Event:
    time = float(recording.time[frame])
    return Event(frame, time, kind, drones, position, f"{time:.2f} s: {text}")


def outcome(recording: Recording) -> str:
    """Return the outcome of an episode as a sentence."""
    metrics, last = recording.about.metrics, float(recording.time[-1])
    if not metrics:
        return f"Recorded for {last:.2f} s; the episode had not ended."
    if metrics["success"]:
        return f"Success, after {last:.2f} s."
    found = events(recording)
    ending = [event for event in found if event.frame == len(recording.time) - 1]
    if ending:
        more = f" and {len(ending) - 1} more" if len(ending) > 1 else ""
        return f"Ended in flight, at {ending[0].text}{more}."
    hit = {drone for event in found for drone in event.drones}
    cause = f"{len(hit)} of {len(recording.team)} drones collided or tumbled; " if hit else ""
    return f"No success: {cause}the time limit was reached after {last:.2f} s."


def metric_rows(metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return label and value, with unit, of each metric that is a single number and not None."""
    rows = []
    for name, value in metrics.items():
        if value is None or isinstance(value, list):
            continue
        unit = next((u for end, u in _UNITS.items() if name.endswith(end)), "")
        label = (name[:-2] if unit else name).replace("_", " ").replace("rms", "RMS")
        rows.append((label[0].upper() + label[1:], _value(value, unit)))
    return rows


def _value(value: Any, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{text} {unit}".strip()
