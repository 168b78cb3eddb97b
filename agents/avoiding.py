"""Scripted agents that avoid each other by what they observe: fast line, ORCA, roundabout.

All three ask for kd (v - velocity), where v points to the goal at kp / kd times the distance, at
most the cruise speed, and fly behind a `swarm_envs.agents.SafetyFilter`:

- `fast-line` asks for no more than that.
- `orca` (van den Berg et al., Reciprocal n-body collision avoidance, 2011) is the same law behind a
  filter whose rate is about kd and that predicts no response: its inequalities on accelerations
  are then ORCA's half-spaces of velocities, n . (v' - v) >= -share h.
- `roundabout` counts the neighbours whose straight way comes near its own at about the same time.
  Where there is more than one it steers to the right, slows down, and takes a height that follows
  from its heading, so that ways that cross in one point become a roundabout on several floors.

The numbers are tuned on seeds apart: `python -m examples.tune_agents`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from swarm_envs.agents.features import ObservationColumns, observation_columns
from swarm_envs.agents.protocol import RowAgent
from swarm_envs.agents.safety import Safety, SafetyFilter
from swarm_envs.agents.scripted import steer
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_number, check_type
from swarm_envs.tasks.base import SPEED_LIMIT

__all__ = ["TUNED", "Avoidance", "Cruise", "RoundaboutAgent"]

_KEEP_M, _SLOPE = 0.25, 2.5
"""Drones approach obstacles at most as fast as `_SLOPE` times what they are farther away, 1/s."""


@dataclass(frozen=True, kw_only=True)
class Cruise:
    """How a drone flies straight to its goal."""

    position_gain: float = 6.0
    """Acceleration for each metre to the goal, 1/s^2."""
    velocity_gain: float = 4.0
    """Acceleration for each m/s that is missing, 1/s."""
    speed_mps: float = 1.8
    """The cruise speed."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for name in ("position_gain", "velocity_gain"):
            check_number(name, getattr(self, name), above=0.0)
        check_number("speed_mps", self.speed_mps, above=0.0, at_most=SPEED_LIMIT, unit="m/s")


@dataclass(frozen=True, kw_only=True)
class Roundabout:
    """What a drone does where several ways meet."""

    turn_rad: float = 0.889
    """By how much it steers to the right at most."""
    full: float = 1.96
    """Neighbours beyond the first that make it steer so much."""
    near_m: float = 0.644
    """Distance below which two straight ways meet, m."""
    ahead_s: float = 1.51
    """How far ahead ways are looked at, s."""
    slower: float = 0.253
    """Share of the cruise speed that it gives up at most."""
    climb_m: float = 0.46
    """How far above or below its way it flies at most, by its heading, m."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("turn_rad", self.turn_rad, at_least=0.0, at_most=np.pi / 2, unit="rad")
        check_number("full", self.full, above=0.0)
        check_number("near_m", self.near_m, above=0.0, unit="m")
        check_number("ahead_s", self.ahead_s, above=0.0, unit="s")
        check_number("slower", self.slower, at_least=0.0, at_most=1.0)
        check_number("climb_m", self.climb_m, at_least=0.0)


class CruiseAgent(RowAgent):
    """Flies to its goal at a cruise speed, by what it observes of itself.

    Args:
        cruise: how fast.
    """

    requires: Mapping[str, Any] = MappingProxyType(
        {"action": "acceleration", "observation": "flat", "decision_rate": 20}
    )
    most_crossing: int | None = 12
    """As of `StraightLineAgent`, but faster: up to seven drones on a circle all succeed; of nine to
    twelve as `fast-line` 72 to 100 % and as `orca` 44 to 100, of 13 none and 3 (256 episodes)."""

    avoids_obstacles = True

    def __init__(self, cruise: Cruise | None = None) -> None:
        self.cruise = cruise or Cruise()
        self._at: ObservationColumns

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Note where observations have what is needed."""
        self._at = observation_columns({f.name: f.where for f in env.observation_layout})

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """The accelerations (..., 3) of drones, cut at what the environment allows."""
        at, kd = self._at, self.cruise.velocity_gain
        velocity = SPEED_LIMIT * rows[..., at.velocity : at.velocity + 3]
        wanted = self.wanted(rows, rows[..., at.goal : at.goal + 3])
        return steer(kd * (self._around(rows, wanted) - velocity))

    def wanted(self, rows: Float32Array, way: Float32Array) -> Float32Array:
        """The velocity (..., 3) that a drone would like, m/s, for the ways (..., 3) to goals, m."""
        distance = np.sqrt(np.square(way).sum(axis=-1, keepdims=True))
        slope = self.cruise.position_gain / self.cruise.velocity_gain
        wanted: Float32Array = way * np.minimum(
            slope, self.cruise.speed_mps / np.maximum(distance, 1e-6)
        )
        return wanted

    def _around(self, rows: Float32Array, wanted: Float32Array) -> Float32Array:
        """The velocities (..., 3), turned to the right where they lead into an obstacle, m/s.

        Always to the right: who turned to the side of the goal would stop before a face behind
        which the goal is.
        """
        at = self._at
        for first in range(at.obstacles, at.obstacles + 4 * at.num_obstacles, 4):
            x, y, _, mask = np.moveaxis(rows[..., first : first + 4], -1, 0)
            away = np.maximum(np.hypot(x, y), 1e-6)
            towards = (wanted[..., 0] * x + wanted[..., 1] * y) / away
            excess = np.maximum(towards - _SLOPE * np.maximum(away - _KEEP_M, 0.0), 0.0) * mask
            turn = np.stack([y - x, -x - y, np.zeros_like(x)], axis=-1)
            wanted = wanted + (excess / away)[..., None] * turn
        return wanted


class RoundaboutAgent(CruiseAgent):
    """Steers to the right, slows down and changes its height where several ways meet.

    Args:
        cruise: how fast it flies elsewhere.
        rule: what it does there.
    """

    requires: Mapping[str, Any] = MappingProxyType({**CruiseAgent.requires, "num_neighbors": 7})
    most_crossing = None

    def __init__(self, cruise: Cruise | None = None, rule: Roundabout | None = None) -> None:
        super().__init__(cruise)
        self.rule = rule or Roundabout()

    def wanted(self, rows: Float32Array, way: Float32Array) -> Float32Array:
        """As of the base; turned, slower and higher or lower among others."""
        rule, share = self.rule, self._crowding(rows, way)
        wanted = super().wanted(rows, way) * (1.0 - rule.slower * share)[..., None]
        turn = -rule.turn_rad * share
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, z = np.moveaxis(wanted, -1, 0)
        heading = np.arctan2(way[..., 1], way[..., 0])
        slope = self.cruise.position_gain / self.cruise.velocity_gain
        rise = slope * rule.climb_m * share * np.cos(heading)
        turned: Float32Array = np.stack([cos * x - sin * y, sin * x + cos * y, z + rise], axis=-1)
        return turned

    def _crowding(self, rows: Float32Array, way: Float32Array) -> Float32Array:
        """Share (...) in [0, 1] of all that it may do, by how many neighbours converge."""
        at, rule = self._at, self.rule
        end = at.neighbors + at.num_neighbors * at.neighbor_width
        seen = rows[..., at.neighbors : end].reshape(*rows.shape[:-1], at.num_neighbors, -1)
        # Both fly straight to their goals, at the cruise speed.
        mine = super().wanted(rows, way)[..., None, :]
        theirs = super().wanted(rows, seen[..., 6:9])
        place, rate = seen[..., 0:3], theirs - mine
        square = np.square(rate).sum(axis=-1)
        when = -(place * rate).sum(axis=-1) / np.maximum(square, 1e-6)
        when = np.clip(when, 0.0, rule.ahead_s)
        apart = np.sqrt(np.square(place + when[..., None] * rate).sum(axis=-1))
        meets = np.maximum(1.0 - apart / rule.near_m, 0.0) * (when > 0.0) * seen[..., -1]
        share: Float32Array = np.clip((meets.sum(axis=-1) - 1.0) / rule.full, 0.0, 1.0)
        return share


@dataclass(frozen=True, kw_only=True)
class Avoidance:
    """Every number of an agent that flies behind its own filter."""

    cruise: Cruise = Cruise()
    """How it flies to its goal."""
    safety: Safety = Safety()
    """Of its filter."""
    roundabout: Roundabout | None = None
    """What it does where several ways meet; None for nothing."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_type("cruise", self.cruise, Cruise)
        check_type("safety", self.safety, Safety)
        check_type("roundabout", self.roundabout, Roundabout | None)

    def agent(self) -> SafetyFilter:
        """An agent with these numbers."""
        if self.roundabout is None:
            return SafetyFilter(CruiseAgent(self.cruise), self.safety)
        return SafetyFilter(RoundaboutAgent(self.cruise, self.roundabout), self.safety)


def _safety(*numbers: float) -> Safety:
    """A filter of the numbers of `Safety` in order."""
    names = ("margin_m", "horizon_s", "response_s", "rate", "share", "downwash", "aside_m")
    return Safety(**dict(zip(names, numbers, strict=True)))  # type: ignore[arg-type]


TUNED: Mapping[str, Avoidance] = MappingProxyType(
    {
        "fast-line": Avoidance(
            safety=_safety(0.11, 0.45, 0.103, 9.48, 0.759, 1.67, 0.0419),
        ),
        "orca": Avoidance(
            cruise=Cruise(position_gain=7.13),
            safety=_safety(0.12, 1.72, 0.0, 3.52, 0.781, 1.09, 0.03),
        ),
        "roundabout": Avoidance(
            cruise=Cruise(position_gain=8.4),
            safety=_safety(0.134, 0.394, 0.126, 8.73, 0.5, 1.15, 0.0269),
            roundabout=Roundabout(),
        ),
    }
)
"""The agents that ship, by name, with their numbers."""


fast_line, orca, roundabout = (numbers.agent for numbers in TUNED.values())
"""Make the agents of these names."""
