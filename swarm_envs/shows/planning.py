"""A show from its formations: transitions, rests and lights on one clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.shows.choreography import Choreography, between, hold, joined
from swarm_envs.shows.formations import Formation, Room
from swarm_envs.shows.transitions import Pace, Transition, assigned, labelled
from swarm_envs.state import FloatArray

__all__ = ["plan_show"]


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
        return between(self.light_times, self.light_colors, times)

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
