"""Options of environments that `fly`, `evaluate` and `train` share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

__all__ = ["MOST_DRONES", "MOST_OBSERVED", "WorldOptions"]

MOST_DRONES = 100_000
"""Largest number of drones of an environment."""
MOST_OBSERVED = 10_000
"""Largest K or M, the numbers of observed neighbors and obstacles."""


@dataclass(frozen=True, kw_only=True)
class WorldOptions:
    """Options of the world; by default those of the task."""

    world: Literal["ideal", "hall"] | None = None
    """`ideal`, or `hall` with random forces and a state estimate; default: the task's"""
    randomization: str | None = None
    """domain randomization, such as `mass=0.9:1.1,gust_acceleration=1`: fields of
    `swarm_envs.envs.randomization.Randomization`"""
    obstacles: str | None = None
    """obstacles, such as `buildings=2:2,column=1:1:0.15` (x, y, radius, m) or
    `box=0:0:0:1:1:2` (two corners, m)"""
    on_contact: Literal["end_team", "end_pair", "bounce"] | None = None
    """effect of a contact: it ends the episode of the team or of the pair, or drones bounce off;
    default: the task's"""

    observe_range_m: float | None = None
    """communication range, m: neighbors farther away are not observed"""
    observe_delay_s: float | None = None
    """communication delay, s: neighbors are observed as they were this long ago"""
    observe_loss: float | None = None
    """packet loss: probability that a neighbor is not observed in a decision"""

    def world_options(self) -> dict[str, Any]:
        """Return the options that were given, as values for JSON."""
        names = [field.name for field in fields(WorldOptions)]
        return {name: value for name in names if (value := getattr(self, name)) is not None}
