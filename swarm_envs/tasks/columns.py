"""Columns: drones gather in two vertical columns and stay in the downwash of those above.

Drones start next to their column, each at the height of its first slot and in its own direction,
so that straight paths within a column do not intersect, with any assignment of slots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_interval, check_name, check_type
from swarm_envs.state import IntArray
from swarm_envs.tasks.base import Given, Placement, Success, Task
from swarm_envs.tasks.learning import in_time
from swarm_envs.tasks.motion import LINES, Motion
from swarm_envs.vehicles import Team, parse_team

__all__ = ["COLUMN_LAYOUTS", "ColumnsTask"]


class ColumnLayout(NamedTuple):
    """Parameters of a layout; by default those of `stack`."""

    gap_m: tuple[float, float] = (0.36, 0.42)
    """Range of the vertical distance between slots, m."""
    payload_kg: tuple[float, float] = (0.008, 0.011)
    """Range of the payload of half of each column's drones, kg; one value per episode."""
    beside_m: float = 0.6
    """Distance of starts from the column, m."""
    travel_s: float = 2.5
    """Time of the reference from start to slot, s."""
    success: Success = Success(0.06, 1.0, named=False)
    """The criterion of success."""
    episode_s: float = 6.0
    """Time limit, s."""


COLUMN_LAYOUTS: Mapping[str, ColumnLayout] = MappingProxyType(
    {
        "stack": ColumnLayout(),
        "sprint": ColumnLayout((0.28, 0.36), (0.0, 0.0), 0.5, 0.9, Success(0.03, 1.0), 2.0),
    }
)
"""The layouts by name."""
LOWEST_M, APART_M = 0.4, 1.5
"""Height of the lowest slots, and distance between the columns, m."""
DOWNWASH_DEFAULTS: Mapping[str, Any] = MappingProxyType(
    {"num_neighbors": 7, "observe_load": True, "on_contact": "end_pair", "world": "hall"}
)
"""Defaults of options in tasks about downwash."""
RAMP = 0.5  # Share of the duration in which the reference accelerates, and in which it decelerates


def column_team(layout: str, num_drones: int | None) -> Team:
    """Return a layout's team: small drones; in `sprint` one `S*` in each column, and `L`.

    Args:
        layout: `stack` or `sprint`.
        num_drones: N; None for 8 in `stack` and 6 in `sprint`.
    """
    if layout == "stack":
        return parse_team("S" * (num_drones or 8))
    sizes = map(len, in_columns(num_drones or 6))
    return parse_team("".join("L" * (size - 1) + "S*" for size in sizes if size))


def in_columns(num_drones: int) -> list[IntArray]:
    """Return the indices of the drones of the first and of the second column."""
    return np.array_split(np.arange(num_drones), 2)


@dataclass(frozen=True)
class ColumnsTask(Task):
    """Columns, version 0: drones gather in columns and stay in the downwash of those above.

        from swarm_envs import columns_v0
        env = columns_v0.parallel_env(layout="stack")

    Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. By default drones fly in
    the world `"hall"`, and each observes seven neighbors and, with `observe_load`, the thrust
    margin, mass and charge of itself and of its neighbors.

    **Layouts.** `stack`: eight small drones, half of them with a payload of 8 to 11 g, in two
    columns of four slots, 0.36 to 0.42 m apart. `sprint`: two large drones and a strong small one
    in each column, in random order, 0.28 to 0.36 m apart.

    **Start.** Next to the column, 0.6 m away in `stack` and 0.5 m in `sprint`, each drone at the
    height of its first slot. Gap, rotation, payload, the drones that carry it, and starts are
    random. `reset(options={"start": ...})` sets other starts. Goals cannot be set.

    **Success.** `stack`: all slots are occupied, within 0.06 m, for 1 s. Any drone may take any
    slot: a drone that reaches the slot of another exchanges goals with it, so that `task.goal` is
    always a slot that no other drone has. The neighbors' goals show the other slots. `sprint`:
    every drone stays within 0.03 m of its own slot for 1 s. In both, without a collision.

    **Rewards** (`parallel_env` lists terms and weights): as in swap.

    **End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision,
    the floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes
    are terminated by success and truncated after 6 s in `stack` and 2 s in `sprint`.

    **Versions.** v0: first version.
    """

    layout: str = "stack"
    """The layout: `stack` or `sprint`."""
    gap_m: tuple[float, float] | None = None
    """Range of the vertical distance between slots, m; None: the layout's."""
    payload_kg: tuple[float, float] | None = None
    """Range of the payload of half of each column's drones, kg; None: the layout's."""
    success: Success | None = None  # type: ignore[assignment]  # set below
    """The criterion of success; None: the layout's."""

    name = "columns_v0"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": None, **DOWNWASH_DEFAULTS}
    layouts = tuple(COLUMN_LAYOUTS)
    goals_are = "the slots of the columns"
    learning = in_time(
        {
            "stack": {"layout": "stack", "gap_m": (0.28, 0.42), "payload_kg": (0.008, 0.016)},
            **{name: {"layout": name} for name in COLUMN_LAYOUTS if name != "stack"},
        }
    )  # The ranges of `stack` contain those of its default and of the benchmark

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and for columns that do not fit the team."""
        check_name("layout", self.layout, COLUMN_LAYOUTS)
        check_interval("gap_m", self.ranges.gap_m, above=0.0, unit="m")
        check_interval("payload_kg", self.ranges.payload_kg, at_least=0.0)
        check_type("success", self.success, Success | None)
        super().__post_init__()
        if self.success is None:
            object.__setattr__(self, "success", self.ranges.success)
        size, widest = len(in_columns(len(self.team))[0]), max(v.radius for v in self.team)
        narrow, wide = self.ranges.gap_m
        if narrow <= 2.0 * widest:
            raise ValueError(
                f"gap_m begins at {narrow} m, but these drones touch at {2 * widest:.3f} m; "
                "use a larger gap_m"
            )
        top, ceiling = LOWEST_M + wide * (size - 1), self.arena[1, 2] - widest
        if top > ceiling:
            raise ValueError(
                f"columns of {size} drones from {LOWEST_M} m with gaps of up to {wide} m reach "
                f"{top:.2f} m, but must stay below {ceiling:.2f} m; use fewer drones or a smaller "
                "gap_m"
            )

    @classmethod
    def default_team(cls, options: Any) -> Team:
        """Return the layout's team."""
        check_name("layout", options.layout, COLUMN_LAYOUTS)
        return column_team(options.layout, options.num_drones)

    @cached_property
    def ranges(self) -> ColumnLayout:
        """The parameters of the layout, with `gap_m` and `payload_kg` replaced if given."""
        given = {"gap_m": self.gap_m, "payload_kg": self.payload_kg}
        own: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        return COLUMN_LAYOUTS[self.layout]._replace(**own)

    @property
    def episode_s(self) -> float:
        """The layout's time limit, s."""
        return self.ranges.episode_s

    @property
    def motion(self) -> Motion:
        """Straight lines to the slots."""
        return Motion(LINES, RAMP)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample gap, rotation, slots, starts, payload and the drones that carry it."""
        n, team = len(self.team), list(self.team)
        ranges = self.ranges
        gap, turn = rng.uniform(*ranges.gap_m), rng.uniform(0.0, 2 * np.pi)
        payload = rng.uniform(*ranges.payload_kg)
        slots, beside = np.empty((n, 3)), np.zeros((n, 3))
        for side, column in zip((-0.5, 0.5), in_columns(n), strict=True):
            size = len(column)
            slots[column, 0] = side * APART_M * np.cos(turn)
            slots[column, 1] = side * APART_M * np.sin(turn)
            slots[column, 2] = LOWEST_M + gap * rng.permutation(size)
            angle = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * rng.permutation(size) / max(size, 1)
            beside[column, 0] = ranges.beside_m * np.cos(angle)
            beside[column, 1] = ranges.beside_m * np.sin(angle)
            for i in rng.permutation(column)[: size // 2].tolist():
                team[i] = replace(team[i], mass=team[i].mass + payload)
        begin = slots + beside if start is None else start
        return Placement(begin, slots[None], ranges.travel_s, team=tuple(team))
