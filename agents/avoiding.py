"""Scripted agents that avoid each other based on observations: fast-line, ORCA, roundabout.

All three command the acceleration kd (v - velocity), where the desired velocity v points to the
goal and is kp / kd times the distance, at most the cruise speed. A `swarm_envs.agents.SafetyFilter`
corrects the command:

- `fast-line` is this control law and the filter.
- `orca` (van den Berg et al., Reciprocal n-body collision avoidance, 2011) uses a filter with a
  rate of about kd and no predicted response: its inequalities on accelerations are then ORCA's
  half-spaces of velocities, n . (v' - v) >= -share h.
- `roundabout` counts the neighbors whose straight path comes close to its own at about the same
  time. If there is more than one, it steers to the right, slows down, and changes its height
  depending on its heading, so that paths that cross in one point become a multi-level roundabout.

The parameters were tuned on separate seeds: `python -m examples.tune_agents`.
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
"""Drones approach obstacles at most at `_SLOPE`, 1/s, times the distance beyond `_KEEP_M`, m."""


@dataclass(frozen=True, kw_only=True)
class Cruise:
    """Parameters of straight flight to the goal."""

    position_gain: float = 6.0
    """The position gain kp, 1/s^2."""
    velocity_gain: float = 4.0
    """The velocity gain kd, 1/s."""
    speed_mps: float = 1.8
    """The cruise speed, m/s."""

    def __post_init__(self) -> None:
        """Raise ValueError if a parameter is invalid."""
        for name in ("position_gain", "velocity_gain"):
            check_number(name, getattr(self, name), above=0.0)
        check_number("speed_mps", self.speed_mps, above=0.0, at_most=SPEED_LIMIT, unit="m/s")


@dataclass(frozen=True, kw_only=True)
class Roundabout:
    """Parameters of the evasion where several paths intersect."""

    turn_rad: float = 0.889
    """The largest turn to the right, rad."""
    full: float = 1.96
    """The number of converging neighbors beyond the first at which the evasion is largest."""
    near_m: float = 0.644
    """The distance below which two straight paths intersect, m."""
    ahead_s: float = 1.51
    """The prediction horizon of the paths, s."""
    slower: float = 0.253
    """The largest reduction of the cruise speed, as a fraction."""
    climb_m: float = 0.46
    """The largest height above or below the straight path, which depends on the heading, m."""

    def __post_init__(self) -> None:
        """Raise ValueError if a parameter is invalid."""
        check_number("turn_rad", self.turn_rad, at_least=0.0, at_most=np.pi / 2, unit="rad")
        check_number("full", self.full, above=0.0)
        check_number("near_m", self.near_m, above=0.0, unit="m")
        check_number("ahead_s", self.ahead_s, above=0.0, unit="s")
        check_number("slower", self.slower, at_least=0.0, at_most=1.0)
        check_number("climb_m", self.climb_m, at_least=0.0)


class CruiseAgent(RowAgent):
    """Agent that flies straight to its goal at a cruise speed, based on its own state.

    Args:
        cruise: gains and speed; None for the defaults.
    """

    requires: Mapping[str, Any] = MappingProxyType(
        {"action": "acceleration", "observation": "flat", "decision_rate": 20}
    )
    most_crossing: int | None = 12
    """See `StraightLineAgent`. On a circle of up to seven drones all episodes succeed; of nine to
    twelve, 72 to 100 % with `fast-line` and 44 to 100 % with `orca`; of 13, 0 and 3 % (256
    episodes)."""

    avoids_obstacles = True

    def __init__(self, cruise: Cruise | None = None) -> None:
        self.cruise = cruise or Cruise()
        self._at: ObservationColumns

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Store the columns of the observations."""
        self._at = observation_columns({f.name: f.where for f in env.observation_layout})

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return actions (..., 3) for observation rows (..., row width) of any number of drones."""
        at, kd = self._at, self.cruise.velocity_gain
        velocity = SPEED_LIMIT * rows[..., at.velocity : at.velocity + 3]
        wanted = self.wanted(rows, rows[..., at.goal : at.goal + 3])
        return steer(kd * (self._around(rows, wanted) - velocity))

    def wanted(self, rows: Float32Array, offset: Float32Array) -> Float32Array:
        """Return desired velocities (..., 3), m/s, for displacements (..., 3) to the goals, m."""
        distance = np.sqrt(np.square(offset).sum(axis=-1, keepdims=True))
        slope = self.cruise.position_gain / self.cruise.velocity_gain
        wanted: Float32Array = offset * np.minimum(
            slope, self.cruise.speed_mps / np.maximum(distance, 1e-6)
        )
        return wanted

    def _around(self, rows: Float32Array, wanted: Float32Array) -> Float32Array:
        """Return velocities (..., 3), m/s, turned to the right where they lead into an obstacle.

        A turn to the side of the goal would stop a drone in front of a face that hides the goal.
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
    """Agent that steers to the right, slows down and changes its height where paths intersect.

    Args:
        cruise: gains and speed of straight flight; None for the defaults.
        rule: parameters of the evasion; None for the defaults.
    """

    requires: Mapping[str, Any] = MappingProxyType({**CruiseAgent.requires, "num_neighbors": 7})
    most_crossing = None

    def __init__(self, cruise: Cruise | None = None, rule: Roundabout | None = None) -> None:
        super().__init__(cruise)
        self.rule = rule or Roundabout()

    def wanted(self, rows: Float32Array, offset: Float32Array) -> Float32Array:
        """Return desired velocities (..., 3), m/s, with the evasion of converging neighbors."""
        rule, share = self.rule, self._crowding(rows, offset)
        wanted = super().wanted(rows, offset) * (1.0 - rule.slower * share)[..., None]
        turn = -rule.turn_rad * share
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, z = np.moveaxis(wanted, -1, 0)
        heading = np.arctan2(offset[..., 1], offset[..., 0])
        slope = self.cruise.position_gain / self.cruise.velocity_gain
        rise = slope * rule.climb_m * share * np.cos(heading)
        turned: Float32Array = np.stack([cos * x - sin * y, sin * x + cos * y, z + rise], axis=-1)
        return turned

    def _crowding(self, rows: Float32Array, offset: Float32Array) -> Float32Array:
        """Return the strength (...) of the evasion in [0, 1], by the number that converge."""
        at, rule = self._at, self.rule
        end = at.neighbors + at.num_neighbors * at.neighbor_width
        seen = rows[..., at.neighbors : end].reshape(*rows.shape[:-1], at.num_neighbors, -1)
        # Prediction: both fly straight to their goals at the cruise speed.
        mine = super().wanted(rows, offset)[..., None, :]
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
    """All parameters of an agent with its own safety filter."""

    cruise: Cruise = Cruise()
    """The parameters of straight flight."""
    safety: Safety = Safety()
    """The parameters of the filter."""
    roundabout: Roundabout | None = None
    """The parameters of the evasion where paths intersect; None for no evasion."""

    def __post_init__(self) -> None:
        """Raise ValueError if a parameter has the wrong type."""
        check_type("cruise", self.cruise, Cruise)
        check_type("safety", self.safety, Safety)
        check_type("roundabout", self.roundabout, Roundabout | None)

    def agent(self) -> SafetyFilter:
        """Return an agent with these parameters."""
        if self.roundabout is None:
            return SafetyFilter(CruiseAgent(self.cruise), self.safety)
        return SafetyFilter(RoundaboutAgent(self.cruise, self.roundabout), self.safety)


TUNED: Mapping[str, Avoidance] = MappingProxyType(
    {
        "fast-line": Avoidance(
            safety=Safety(
                margin_m=0.11,
                horizon_s=0.45,
                response_s=0.103,
                rate=9.48,
                share=0.759,
                downwash=1.67,
                aside_m=0.0419,
            ),
        ),
        "orca": Avoidance(
            cruise=Cruise(position_gain=7.13),
            safety=Safety(
                margin_m=0.12,
                horizon_s=1.72,
                response_s=0.0,
                rate=3.52,
                share=0.781,
                downwash=1.09,
                aside_m=0.03,
            ),
        ),
        "roundabout": Avoidance(
            cruise=Cruise(position_gain=8.4),
            safety=Safety(
                margin_m=0.134,
                horizon_s=0.394,
                response_s=0.126,
                rate=8.73,
                share=0.5,
                downwash=1.15,
                aside_m=0.0269,
            ),
            roundabout=Roundabout(),
        ),
    }
)
"""The parameters of the included agents, by name."""


fast_line, orca, roundabout = (numbers.agent for numbers in TUNED.values())
"""Functions without arguments that make the agents of these names."""
