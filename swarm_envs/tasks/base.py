"""What a task is: where drones start, where they belong, what is good, and when it is over."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import check_array
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team

SPEED_LIMIT = 2.0
"""Largest speed that actions ask for, m/s, the same for every type."""
ACCELERATION_LIMIT = 5.0
"""Largest acceleration that actions ask for, m/s^2, the same for every type."""
WALL_MARGIN = 0.3
"""Starts and goals keep this distance from the walls, m."""


ARENA_WIDTH, ARENA_HEIGHT = 4.0, 2.5
"""Size of the arena for up to 16 drones, m."""


def arena_of(num_drones: int) -> FloatArray:
    """Corners (2, 3) of the arena, m: 4 x 4 x 2.5, grown with (N / 16)^(1/3) above 16 drones."""
    grown = max(1.0, (num_drones / 16) ** (1 / 3))
    half = ARENA_WIDTH / 2
    return np.array([[-half, -half, 0.0], [half, half, ARENA_HEIGHT]]) * grown


class Placement(NamedTuple):
    """One episode of one environment, as a task draws it."""

    start: FloatArray
    """(N, 3) start positions, m."""
    goal: FloatArray
    """(N, 3) goal positions, m."""
    duration: float
    """Seconds that the reference takes from start to goal; 0 if there is none."""


class Mission(NamedTuple):
    """What the task keeps of every environment's episode: arrays that lead with E."""

    start: FloatArray
    """(E, N, 3) start positions, m."""
    goal: FloatArray
    """(E, N, 3) goal positions, m."""
    duration: FloatArray
    """(E,) seconds that the reference takes; 0 if there is none."""
    distance: FloatArray
    """(E, N) distance to the goal at the last decision, m."""

    def place(self, e: int, placement: Placement) -> None:
        """Begin a new episode in environment `e`."""
        self.start[e], self.goal[e], self.duration[e] = placement
        self.distance[e] = np.linalg.norm(placement.goal - placement.start, axis=-1)


class Situation(NamedTuple):
    """What rewards are computed from, after a decision has been flown."""

    distance: FloatArray
    """(E, N) distance to the goal, m."""
    last_distance: FloatArray
    """(E, N) the same one decision earlier, m."""
    tracking_error: FloatArray
    """(E, N) distance to the reference, m."""
    effort: FloatArray
    """(E, N) mean square of the action, in [0, 1]."""
    clearance: FloatArray
    """(E, N) smallest distance to another drone in this decision, over the sum of radii."""
    crashed: BoolArray
    """(E, N) collided, left the arena or tumbled in this decision."""
    succeeded: BoolArray
    """(E,) the task is done."""


def new_mission(num_envs: int, num_drones: int) -> Mission:
    """A mission whose environments have not begun."""
    shape = (num_envs, num_drones)
    return Mission(
        start=np.zeros((*shape, 3)),
        goal=np.zeros((*shape, 3)),
        duration=np.zeros(num_envs),
        distance=np.zeros(shape),
    )


@dataclass(frozen=True)
class Success:
    """When a team has done its task: every drone near its goal, for a while."""

    radius: float = 0.10
    """How near a drone must be to its goal, m."""
    hold_s: float = 0.5
    """For how long all must stay there, s, as seen at decisions."""


class Task(ABC):
    """A task for a team. Stateless: what changes over an episode lives in the `Mission`."""

    name: str
    """Versioned name, such as `swap_v0`."""
    team: Team
    success: Success
    reward_weights: Mapping[str, float]
    """Weight of each reward term; a term left out has none."""
    reward_names: tuple[str, ...]
    """Names of the T reward terms."""
    write_reward_terms: Callable[[Situation, float, float, FloatArray], None]
    """A kernel that writes the bounded terms (T, E, N) of a `Situation`; it is also told the time
    between decisions and the clock, s."""

    @property
    def arena(self) -> FloatArray:
        """Corners (2, 3) of the arena, m."""
        return arena_of(len(self.team))

    @abstractmethod
    def place(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw an episode; a start or goal that is given is kept.

        Raises:
            RuntimeError: no placement was found within a bounded number of draws.
        """

    @abstractmethod
    def reference(self, mission: Mission, time: FloatArray) -> Reference:
        """Where the drones should be at `time` (E,), s: arrays (E, N, 3)."""


def check_placement(
    placement: Placement, radius: FloatArray, arena: FloatArray, where: str = "start"
) -> None:
    """Refuse starts (or goals) that collide, or lie outside the arena.

    Args:
        placement: what was drawn or given.
        radius: (N,) collision radii, m.
        arena: (2, 3) corners, m.
        where: `start` or `goal`, the field to check.

    Raises:
        ValueError: naming the drones, their distance and the rule.
    """
    points: FloatArray = check_array(where, getattr(placement, where), (len(radius), 3))
    low, high = arena[0] + radius[:, None], arena[1] - radius[:, None]
    outside = np.argwhere((points < low) | (points > high))
    if len(outside):
        i, axis = (int(k) for k in outside[0])
        raise ValueError(
            f"{where} of drone {i} has {'xyz'[axis]} = {points[i, axis]:.3f} m, but must lie "
            f"between {low[i, axis]:.3f} and {high[i, axis]:.3f} m to be inside the arena"
        )
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    touching = np.argwhere(np.triu(distance < radius[:, None] + radius[None], 1))
    if len(touching):
        i, j = (int(k) for k in touching[0])
        raise ValueError(
            f"{where}s of drones {i} and {j} are {distance[i, j]:.3f} m apart, closer than the "
            f"collision distance of {radius[i] + radius[j]:.3f} m; move them apart"
        )


def draw_apart(
    rng: np.random.Generator, low: Sequence[float], high: Sequence[float], n: int, distance: float
) -> FloatArray:
    """Draw n points (n, 3) in a box, all at least `distance` (m) apart, one after another.

    Raises:
        RuntimeError: the box is too full: no place was found in 10,000 draws.
    """
    points = np.empty((n, 3))
    placed, corner, size = 0, np.array(low), np.subtract(high, low)
    for _ in range(10_000):
        point = corner + size * rng.random(3)
        offset = points[:placed] - point
        if (np.square(offset).sum(axis=1) >= distance**2).all():
            points[placed] = point
            placed += 1
            if placed == n:
                return points
    raise RuntimeError(
        f"found room for {placed} of {n} drones {distance} m apart within 10,000 draws; "
        "use fewer drones or give reset(options={'start': ...})"
    )


def derangement(rng: np.random.Generator, n: int) -> npt.NDArray[np.int64]:
    """A random permutation (n,), n >= 2, that leaves nothing in its place; each equally likely.

    Permutations are drawn until one fits, which takes e = 2.7 draws on average.

    Raises:
        RuntimeError: a thousand draws did not fit, which does not happen by chance.
    """
    places = np.arange(n)
    for _ in range(1000):
        order = rng.permutation(n)
        if not (order == places).any():
            return order
    raise RuntimeError(f"found no derangement of {n} in a thousand draws; n must be at least 2")
