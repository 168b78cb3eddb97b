"""Ring: intertwined circles and ellipses, as in Neural-Swarm2 (Sec. VII-E, Fig. 1 and 9).

The rule, for any team:

- The drones with the largest thrust-to-weight ratio, (6 n + 4) // 10 of n (3 of 5, 10 of 16), fly
  on upright circles, since those pass through downwash; the others on one level ellipse.
- Up to five of the former share one circle; more fly on two. Each circle's centre is a tip of the
  ellipse, its plane holds the tip and the vertical axis, so that the rings are links of a chain.
- Drones of one ring are evenly spaced. Where the radii are equal, so are the angular rates, and a
  drone of the upright circle is at its lowest when one of the level ring is right above it.
- Above 16 drones the team splits into groups of at most 16, in its order, each with rings of its
  own, side by side and one above another.

Rings of the shipped layouts stay apart whatever the phases: two drones could only meet if they
shared a ring, where they keep their distance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task, TrackingSuccess
from swarm_envs.tasks.mission import Orbit, Placement
from swarm_envs.tasks.motion import ORBITS, Motion
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.tasks.rewards import REWARD_NAMES, check_reward_weights, write_terms
from swarm_envs.tasks.rings import (
    GROUP_SIZE,
    RingLayout,
    check_speed,
    group_centers,
    layout_for,
    rings_of_group,
)
from swarm_envs.vehicles import Team, parse_team

REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 0.0,
        "at_goal": 0.0,
        "tracking": 3.0,
        "effort": -0.1,
        "proximity": -4.0,
        "crash": -1.0,
        "success": 3.0,
    }
)
"""Default weight of each reward term; see `swarm_envs.tasks.rewards.write_terms`."""


def ring_team(num_drones: int) -> Team:
    """The team that flies if none is named: the paper's for 5 and 16 drones, else small ones."""
    teams = {5: "S*S*S*LL", 16: "LSSLSS" + 10 * "S*"}
    return parse_team(teams.get(num_drones, num_drones * "S"))


@typed
@dataclass(frozen=True)
class RingTask(Task):
    """Keep to a reference on intertwined rings. See the module for who flies where."""

    team: Team
    """The drones."""
    rings: RingLayout | None = None
    """Sizes, speed and phases; None: those of the paper for 5 or 16 drones, whichever fits."""
    success: TrackingSuccess = TrackingSuccess()
    """When the team has done its task. Its `settle_s` is also the time of the smooth start-up."""
    scored_s: float = 10.0
    """Seconds flown after the start-up."""
    reward_weights: Mapping[str, float] = field(default_factory=lambda: REWARD_WEIGHTS)
    """Weight of each reward term."""
    obstacles: tuple[Obstacle, ...] = ()
    """What stands in the way."""

    name = "ring_v0"
    reward_names = REWARD_NAMES
    write_reward_terms = staticmethod(write_terms)

    def __post_init__(self) -> None:
        """Refuse rings that do not fit, on which drones would collide, or that are too fast."""
        check_reward_weights(self.reward_weights, self.reward_names)
        for name, value in (("settle_s", self.success.settle_s), ("scored_s", self.scored_s)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} is {value!r}, but must be positive and finite, in s")
        check_speed(self.orbit, self.team)
        self._check_arena()

    @property
    def layout(self) -> RingLayout:
        """Sizes, speed and phases that are flown."""
        return self.rings or layout_for(min(len(self.team), GROUP_SIZE))

    @cached_property
    def orbit(self) -> Orbit:
        """The ring of each drone; its phase is that of a start with no lead."""
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
        """On the rings, from rest to full rate within the start-up."""
        return Motion(ORBITS, float(self.success.settle_s))

    @property
    def episode_s(self) -> float:
        """Start-up and scored flight, s."""
        return self.success.settle_s + self.scored_s

    def draw(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw how far the team is ahead; a start that is given is flown from to the rings.

        Raises:
            ValueError: a goal is given: here goals are wherever the reference is.
        """
        if goal is not None:
            raise ValueError(
                "a goal is given, but in ring goals are where the reference is; leave it out"
            )
        lead = rng.uniform(*self.layout.lead_s)
        orbit = self.orbit._replace(phase=self.orbit.phase + self.orbit.rate * lead)
        on_ring = points_at(orbit, orbit.phase)
        return Placement(on_ring if start is None else start, on_ring[None], 0.0, orbit)

    def _check_arena(self) -> None:
        for angle in np.linspace(0.0, 2 * np.pi, 24, endpoint=False):
            points = points_at(self.orbit, np.full(len(self.team), angle))
            low, high = points - self.radius[:, None], points + self.radius[:, None]
            if (low < self.arena[0]).any() or (high > self.arena[1]).any():
                raise ValueError(
                    f"rings of {self.layout} reach out of the arena of {self.arena[1]} m; make "
                    "them smaller or change height_m"
                )


def points_at(orbit: Orbit, angle: FloatArray) -> FloatArray:
    """Points (N, 3), m, of the ellipses at angles (N,), rad."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.asarray(orbit.center + orbit.first * c + orbit.second * s)
