"""Ring: intertwined circles and ellipses, as in Neural-Swarm2 (Sec. VII-E, Fig. 1 and 9).

Teams are distributed over rings as follows:

- The drones with the largest thrust-to-weight ratio, (6 n + 4) // 10 of n (3 of 5, 10 of 16), fly
  on vertical circles, since these pass through downwash; the others on one horizontal ellipse.
- Up to five of the former share one circle; more fly on two. The center of each circle is a vertex
  of the ellipse, and its plane contains that vertex and the vertical axis of the ellipse, so that
  the rings are linked like those of a chain.
- Drones of one ring are evenly spaced. If the radii are equal, so are the angular rates, and a
  drone of the vertical circle is at its lowest point when one of the horizontal ring is above it.
- A team of more than 16 drones is split, in its order, into groups of at most 16. Each group has
  its own rings, side by side and one above another.

Drones on different rings of the shipped layouts cannot collide, whatever their phases; drones on
one ring keep their distance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_integer, check_interval, check_number, check_numbers, check_type
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Given, Orbit, Placement, Task, TrackingSuccess
from swarm_envs.tasks.learning import RATES, Learning, Metrics
from swarm_envs.tasks.motion import ORBITS, Motion
from swarm_envs.tasks.placing import WALL_MARGIN
from swarm_envs.vehicles import GRAVITY, Team, parse_team

__all__ = ["CLOSE_FIVE", "CLOSE_SIXTEEN", "REWARD_WEIGHTS", "RingLayout", "RingTask", "ring_team"]

GROUP_SIZE = 16  # Largest number of drones on one set of rings
PER_CIRCLE = 5  # Largest number of drones on one vertical circle
GAP = 0.4  # Smallest distance between the rings of two groups, m
_SPARE = 0.05  # Smallest distance of drones on rings beyond the sum of radii, m


@dataclass(frozen=True)
class RingLayout:
    """Sizes, speeds and phases of one set of rings. Raises ValueError for invalid values."""

    horizontal_m: tuple[float, float]
    """Half axes of the horizontal ellipse along x and y, m."""
    vertical_m: float
    """Radius of the vertical circles, m."""
    speed_m_s: float
    """Mean speed along every ring, m/s."""
    height_m: float = 1.2
    """Height of the horizontal ellipse, m; of the lowest one, if there are several groups."""
    phases_rad: tuple[float, float] = (0.0, 0.0)
    """Angles of the first drone of the horizontal ellipse, from the vertex in the direction of x,
    and of the first drone of each vertical circle, from its lowest point, rad."""
    lead_s: tuple[float, float] = (0.0, 60.0)
    """Range of the flight time by which starts are ahead of these phases, s; sampled once per
    episode for all drones, so that their relative phases do not change."""
    upright_speed_m_s: float | None = None
    """Mean speed along the vertical circles, m/s; None: `speed_m_s`."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_numbers("horizontal_m", self.horizontal_m, 2, above=0.0)
        check_numbers("phases_rad", self.phases_rad, 2)
        for name in ("vertical_m", "height_m"):
            check_number(name, getattr(self, name), above=0.0, unit="m")
        check_number("speed_m_s", self.speed_m_s, above=0.0, unit="m/s")
        if self.upright_speed_m_s is not None:
            check_number("upright_speed_m_s", self.upright_speed_m_s, above=0.0, unit="m/s")
        check_interval("lead_s", self.lead_s, at_least=0.0, unit="s")


FIVE = RingLayout((0.55, 0.55), 0.55, 0.65)
"""Two rings for up to 8 drones: Neural-Swarm2, Fig. 9, enlarged; see `CLOSE_FIVE`."""
SIXTEEN = RingLayout((1.0, 0.6), 0.5, 0.5)
"""Three rings for up to 16 drones: Neural-Swarm2, Fig. 1, enlarged; see `CLOSE_SIXTEEN`."""
CLOSE_SIXTEEN = RingLayout((0.5, 0.3), 0.3, 0.51, 0.7, (0.0, 0.32), upright_speed_m_s=0.377)
"""Sizes, speeds and phases of Fig. 1 in the authors' flights: the ellipse, the circles and the
period of five seconds are measured on the trajectories in their repository
(aerorobotics/neural-swarm, commit 48b1851, `three_rings16_pps`). References come within 0.26 m of
each other; those of the authors within 0.25 m, and 0.24 m at the beginning and at the end."""
CLOSE_FIVE = RingLayout((0.5, 0.5), 0.3, 0.628, 0.7, upright_speed_m_s=0.377)
"""Fig. 9 in the sizes of `CLOSE_SIXTEEN`; its own trajectories are not published."""


def num_upright(n: int) -> int:
    """Return the number of drones, of n, on vertical circles."""
    return (6 * n + 4) // 10


def layout_for(n: int) -> RingLayout:
    """Return the shipped layout for a group of n drones."""
    return FIVE if num_upright(n) <= PER_CIRCLE else SIXTEEN


def perimeter(a: float, b: float) -> float:
    """Return the length of an ellipse with half axes a and b, by Ramanujan's second formula."""
    h = ((a - b) / (a + b)) ** 2
    return math.pi * (a + b) * (1.0 + 3.0 * h / (10.0 + math.sqrt(4.0 - 3.0 * h)))


def rings_of_group(team: Team, layout: RingLayout, center: FloatArray) -> Orbit:
    """Return the rings of the drones of a group of at most 16.

    Args:
        team: the group.
        layout: sizes, speeds and phases.
        center: (3,) center of the rings, at the height of the horizontal ellipse, m.

    Raises:
        ValueError: drones would collide.
    """
    n, (a, b), r = len(team), layout.horizontal_m, layout.vertical_m
    strongest = sorted(range(n), key=lambda i: -team[i].thrust_to_weight)
    upright = sorted(strongest[: num_upright(n)])
    level = sorted(strongest[num_upright(n) :])
    circles = np.array_split(upright, max(1, -(-len(upright) // PER_CIRCLE)))
    shift = np.array([-r / 2 if len(circles) == 1 and level else 0.0, 0.0, 0.0])
    orbit = Orbit(*(np.zeros((n, 3)) for _ in range(3)), *(np.zeros(n) for _ in range(2)))
    middle = center + shift
    x, y, z = np.eye(3)
    _put(orbit, np.array(level, dtype=np.int64), middle, a * x, b * y, layout, 0)
    for k, members in enumerate(circles):
        side = 1.0 - 2.0 * k
        tip = middle + side * a * x if level else center
        _put(orbit, members, tip, -r * z, side * r * x, layout, 1)
    _check_apart(orbit, 2.0 * max(vehicle.radius for vehicle in team) + _SPARE)
    return orbit


def _put(
    orbit: Orbit,
    members: np.typing.NDArray[np.int64],
    center: FloatArray,
    first: FloatArray,
    second: FloatArray,
    layout: RingLayout,
    kind: int,
) -> None:
    """Write the orbits of drones that are evenly spaced on a ring."""
    a, b = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    orbit.center[members], orbit.first[members], orbit.second[members] = center, first, second
    speed = (layout.upright_speed_m_s or layout.speed_m_s) if kind else layout.speed_m_s
    orbit.rate[members] = 2 * np.pi * speed / perimeter(a, b)
    spread = 2 * np.pi * np.arange(len(members)) / max(len(members), 1)
    orbit.phase[members] = layout.phases_rad[kind] + spread


def _check_apart(orbit: Orbit, least: float) -> None:
    """Raise ValueError if drones could come closer than `least`, m, at any phases between rings."""
    angle = np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    n = len(orbit.rate)
    for i in range(n):
        mine = orbit.center[i] + orbit.first[i] * c + orbit.second[i] * s
        for j in range(i):
            same = all((part[i] == part[j]).all() for part in orbit[:3])
            if same:
                ahead = angle + orbit.phase[j] - orbit.phase[i]
                d, t = np.cos(ahead)[:, None], np.sin(ahead)[:, None]
                theirs = orbit.center[j] + orbit.first[j] * d + orbit.second[j] * t
                gap = np.linalg.norm(mine - theirs, axis=-1).min()
            else:
                theirs = orbit.center[j] + orbit.first[j] * c + orbit.second[j] * s
                gap = np.linalg.norm(mine[:, None] - theirs[None], axis=-1).min()
            if gap < least:
                raise ValueError(
                    f"on these rings drones {j} and {i} of a group come within {gap:.2f} m, but "
                    f"must keep {least:.2f} m; use fewer drones, or larger rings: "
                    "rings=RingLayout(...) of swarm_envs.tasks.ring"
                )


def check_speed(orbit: Orbit, team: Team) -> None:
    """Raise ValueError if rings need more than half of a drone's thrust beyond its weight."""
    reach = np.maximum(np.linalg.norm(orbit.first, axis=1), np.linalg.norm(orbit.second, axis=1))
    for i, (needed, vehicle) in enumerate(zip(reach * orbit.rate**2, team, strict=True)):
        limit = 0.5 * GRAVITY * (vehicle.thrust_to_weight - 1.0)
        if needed > limit:
            raise ValueError(
                f"drone {i} would accelerate at {needed:.2f} m/s^2 on its ring, but its thrust "
                f"allows {limit:.2f} m/s^2; use a lower speed_m_s or larger rings"
            )


def group_centers(groups: int, layout: RingLayout, arena: FloatArray) -> FloatArray:
    """Return the centers (groups, 3) of the groups' rings, m: side by side, then one above another.

    Raises:
        ValueError: the groups do not fit the arena.
    """
    (a, b), r = layout.horizontal_m, layout.vertical_m
    size = np.array([2.0 * (a + r), 2.0 * b, 2.0 * r])
    lowest = layout.height_m - r
    room = arena[1] - arena[0] - np.array([2 * WALL_MARGIN, 2 * WALL_MARGIN, lowest + WALL_MARGIN])
    counts = np.maximum(np.floor((room + GAP) / (size + GAP) + 1e-9), 1.0).astype(int)
    if groups > 1 and groups > counts.prod():
        raise ValueError(
            f"{groups} groups of up to {GROUP_SIZE} drones do not fit: with {layout} there is room "
            f"for {counts.prod()}; use fewer drones or smaller rings"
        )
    nx, ny, nz = counts.tolist()
    cells = [(i, j, k) for k in range(nz) for i in range(nx) for j in range(ny)]
    used = np.array(cells[:groups], dtype=np.float64)
    middle = np.ptp(used, axis=0) / 2
    middle[2] = 0.0
    return np.asarray((used - middle) * (size + GAP) + np.array([0.0, 0.0, layout.height_m]))


REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 0.0,
        "at_goal": 0.0,
        "tracking": 0.25,
        "effort": -0.1,
        "proximity": -4.0,
        "crash": -1.0,
        "success": 3.0,
    }
)
"""Default weight of each reward term; see `swarm_envs.tasks.rewards.write_terms`."""


def ring_team(num_drones: int) -> Team:
    """Return the default team: the paper's for 5 and 16 drones, else small drones."""
    check_integer("num_drones", num_drones, at_least=1)
    teams = {5: "S*S*S*LL", 16: "LSSLSS" + 10 * "S*"}
    return parse_team(teams.get(num_drones, num_drones * "S"))


LOST_M = 0.15
"""Value of `worst_height_error_m` for an episode without success, m."""


def worst_height_error_m(metrics: Metrics) -> float:
    """Return the largest height error of any drone, m; `LOST_M` without success."""
    error = metrics["worst_height_error_m"]
    return LOST_M if error is None or not metrics["success"] else float(error)


@dataclass(frozen=True)
class RingTask(Task):
    """Ring, version 1: drones track references on intertwined rings, through each other's downwash.

        from swarm_envs import ring_v1
        env = ring_v1.parallel_env(num_drones=5, action="setpoint")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`. The goal,
    which is observed as `task.goal`, is the present position of the reference.

    **Teams.** 5 drones (the default, `S*S*S*LL`): three small drones on a vertical circle and two
    large drones on a horizontal circle of the same radius, 0.55 m, at 0.65 m/s; a small drone is at
    its lowest point when a large one is right above it. 16 drones (`LSSLSS` and ten `S*`): two
    large and four small drones on a horizontal ellipse with half axes of 1.0 and 0.6 m, and two
    times five drones on vertical circles of radius 0.5 m at its vertices, at 0.5 m/s. For other
    teams see `swarm_envs.tasks.ring`. `rings=RingLayout(...)` changes sizes and speeds:
    `CLOSE_SIXTEEN` of that module has those of Neural-Swarm2, Fig. 1, with references within 0.26 m
    of each other, and `CLOSE_FIVE` those of Fig. 9.

    **Start.** On the rings, at rest. Relative phases are fixed; the whole team starts at a random
    point of its motion. The speed grows smoothly within 2 s. `reset(options={"start": ...})` sets
    other starts; the reference stays the same. Goals cannot be set.

    **Success.** No collision until the time limit, and after the first 2 s every drone stays within
    0.15 m of its reference. Success is determined, and rewarded, at the time limit.

    **Rewards** (`parallel_env` lists terms and weights): as in swap, with `tracking` in place of
    `progress` and `at_goal`.

    **End.** The episode is terminated by a collision, the floor, a wall, an obstacle or tumbling
    (150 rad/s). It is truncated after 2 + 10 s.

    **Versions.** v1: first version.
    """

    rings: RingLayout | None = None
    """Sizes, speeds and phases; None: a shipped layout for up to 8 or up to 16 drones."""
    success: TrackingSuccess = TrackingSuccess()
    """The criterion of success. Its `settle_s` is also the duration of the smooth start-up."""
    scored_s: float = 10.0
    """Time after the start-up, s."""

    name = "ring_v1"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 5}
    default_weights = REWARD_WEIGHTS
    goals_are = "the positions of the reference"
    learning = Learning(
        layouts={"rings": {}},
        horizon_s=5.0,
        reward_weights={"progress": 1.0, "at_goal": 3.0, "tracking": 6.0},
        measures={**RATES, "worst_height_error_m": worst_height_error_m},
        cost={"worst_height_error_m": 1.0 / LOST_M},
    )

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and for rings too large, too close or too fast."""
        check_type("rings", self.rings, RingLayout | None)
        check_type("success", self.success, TrackingSuccess)
        check_number("scored_s", self.scored_s, above=0.0, unit="s")
        super().__post_init__()
        check_number("settle_s", self.success.settle_s, above=0.0, unit="s")
        check_speed(self.orbit, self.team)
        self._check_arena()

    @classmethod
    def default_team(cls, options: Any) -> Team:
        """Return the paper's team for 5 and 16 drones, else small drones."""
        return ring_team(options.num_drones)

    @property
    def layout(self) -> RingLayout:
        """The sizes, speeds and phases."""
        return self.rings or layout_for(min(len(self.team), GROUP_SIZE))

    @cached_property
    def orbit(self) -> Orbit:
        """The rings of the drones, with the phases of a start without lead."""
        n, layout = len(self.team), self.layout
        groups = np.array_split(np.arange(n), -(-n // GROUP_SIZE))
        centers = group_centers(len(groups), layout, self.arena)
        parts = [
            rings_of_group(tuple(self.team[i] for i in group), layout, center)
            for group, center in zip(groups, centers, strict=True)
        ]
        return Orbit(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    @property
    def motion(self) -> Motion:
        """Motion on the rings, which starts from rest."""
        return Motion(ORBITS, float(self.success.settle_s))

    @property
    def episode_s(self) -> float:
        """The time of start-up and scored flight, s."""
        return self.success.settle_s + self.scored_s

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample the lead; a given start does not change the reference."""
        lead = rng.uniform(*self.layout.lead_s)
        orbit = self.orbit._replace(phase=self.orbit.phase + self.orbit.rate * lead)
        on_ring = orbit.at(orbit.phase)
        return Placement(on_ring if start is None else start, on_ring[None], 0.0, orbit)

    def _check_arena(self) -> None:
        for angle in np.linspace(0.0, 2 * np.pi, 24, endpoint=False):
            points = self.orbit.at(np.full(len(self.team), angle))
            low, high = points - self.radius[:, None], points + self.radius[:, None]
            if (low < self.arena[0]).any() or (high > self.arena[1]).any():
                raise ValueError(
                    f"rings of {self.layout} leave the arena, which ends at {self.arena[1]} m; use "
                    "smaller rings or another height_m"
                )
