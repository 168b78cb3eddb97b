"""Columns: drones gather in two vertical columns and stay in the downwash of those above.

Layouts:

- `stack`: half of each column's drones carry a payload, which is drawn. Any drone may take any
  place, so a drone with little thrust to spare had better stand on top. The task's reference leads
  each drone to the place nearest to it.
- `sprint`: each drone has a place of its own, and just the time to get there and stay. Who stands
  above whom is drawn.

Drones start next to their column, each at the height of its first place and in a direction of its
own, so that straight ways within a column do not meet, with any assignment of places.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_interval, check_number, check_type
from swarm_envs.state import IntArray
from swarm_envs.tasks.base import Given, Placement, Success, Task
from swarm_envs.tasks.learning import in_time
from swarm_envs.tasks.motion import LINES, Motion
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.vehicles import Team, parse_team

__all__ = ["COLUMN_LAYOUTS", "ColumnsTask"]

COLUMN_LAYOUTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "stack": {},
        "sprint": {
            "gap_m": (0.28, 0.36),
            "payload_kg": (0.0, 0.0),
            "beside_m": 0.5,
            "travel_s": 0.9,
            "success": Success(0.03, 1.0),
            "episode_s": 2.0,
        },
    }
)
"""Each layout by name, as options of `ColumnsTask`."""
RAMP = 0.5  # Share of the way's time in which the reference speeds up, and in which it slows down


def column_team(layout: str, num_drones: int | None) -> Team:
    """The vehicles of a layout: small ones; in `sprint` one `S*` in each column, the others `L`.

    Args:
        layout: `stack` or `sprint`.
        num_drones: N; None for 8 in `stack`, and 6 in `sprint`.
    """
    if layout == "stack":
        return parse_team("S" * (num_drones or 8))
    sizes = map(len, in_columns(num_drones or 6))
    return parse_team("".join("L" * (size - 1) + "S*" for size in sizes if size))


def in_columns(num_drones: int) -> list[IntArray]:
    """Indices of the drones of the first and of the second column."""
    return np.array_split(np.arange(num_drones), 2)


@dataclass(frozen=True)
class ColumnsTask(Task):
    """Gather in two columns. The defaults are those of `stack`; see the module."""

    team: Team
    """The drones; the first half of them, rounded up, start at the first column."""
    gap_m: tuple[float, float] = (0.36, 0.42)
    """Range of the vertical distance between places, m."""
    payload_kg: tuple[float, float] = (0.008, 0.011)
    """Range of what half of each column's drones carry, kg; in an episode all of them the same."""
    lowest_m: float = 0.4
    """Height of the lowest places, m."""
    apart_m: float = 1.5
    """Distance between the columns, m."""
    beside_m: float = 0.6
    """Distance from their column at which drones start, m."""
    travel_s: float = 2.5
    """Time in which the reference gets there, s."""
    success: Success = Success(0.06, 1.0, named=False)
    """When the team has gathered."""
    episode_s: float = 6.0
    """Time limit, s."""

    name = "columns_v0"
    layouts = tuple(COLUMN_LAYOUTS)
    default_weights = REWARD_WEIGHTS
    goals_are = "the places of the columns"
    learning = in_time(
        {
            "stack": {"layout": "stack", "gap_m": (0.28, 0.42), "payload_kg": (0.008, 0.016)},
            **{name: {"layout": name} for name in COLUMN_LAYOUTS if name != "stack"},
        }
    )  # The gaps and payloads of `stack` are those of the default and of the benchmark

    def __post_init__(self) -> None:
        """Refuse teams and gaps of which no columns can be made."""
        check_interval("gap_m", self.gap_m, above=0.0, unit="m")
        check_interval("payload_kg", self.payload_kg, at_least=0.0)
        for name in ("lowest_m", "apart_m", "beside_m"):
            check_number(name, getattr(self, name), above=0.0, unit="m")
        for name in ("travel_s", "episode_s"):
            check_number(name, getattr(self, name), above=0.0, unit="s")
        check_type("success", self.success, Success)
        super().__post_init__()
        size, widest = len(in_columns(len(self.team))[0]), max(v.radius for v in self.team)
        if self.gap_m[0] <= 2.0 * widest:
            raise ValueError(
                f"gap_m begins at {self.gap_m[0]} m, but these drones touch at {2 * widest:.3f} m; "
                "use a larger gap"
            )
        top, ceiling = self.lowest_m + self.gap_m[1] * (size - 1), self.arena[1, 2] - widest
        if top > ceiling:
            raise ValueError(
                f"columns of {size} drones from {self.lowest_m} m with gaps of up to "
                f"{self.gap_m[1]} m reach {top:.2f} m, but must stay below {ceiling:.2f} m; use "
                "fewer drones or a smaller gap_m"
            )

    @property
    def motion(self) -> Motion:
        """Straight lines to the places."""
        return Motion(LINES, RAMP)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Draw gap, turn, who starts where, who carries the payload, and how much that is."""
        n, team = len(self.team), list(self.team)
        gap, turn = rng.uniform(*self.gap_m), rng.uniform(0.0, 2 * np.pi)
        payload = rng.uniform(*self.payload_kg)
        places, beside = np.empty((n, 3)), np.zeros((n, 3))
        for side, column in zip((-0.5, 0.5), in_columns(n), strict=True):
            size = len(column)
            places[column, 0] = side * self.apart_m * np.cos(turn)
            places[column, 1] = side * self.apart_m * np.sin(turn)
            places[column, 2] = self.lowest_m + gap * rng.permutation(size)
            angle = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * rng.permutation(size) / max(size, 1)
            beside[column, 0] = self.beside_m * np.cos(angle)
            beside[column, 1] = self.beside_m * np.sin(angle)
            for i in rng.permutation(column)[: size // 2].tolist():
                team[i] = replace(team[i], mass=team[i].mass + payload)
        begin = places + beside if start is None else start
        return Placement(begin, places[None], float(self.travel_s), team=tuple(team))
