"""Options of an environment that `fly`, `evaluate` and `train` share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

__all__ = ["MOST_DRONES", "MOST_OBSERVED", "WorldOptions"]

MOST_DRONES = 100_000
"""The largest number of drones: a batch of environments shares the memory."""
MOST_OBSERVED = 10_000
"""The most for K or M: an observation has room for all of them in every episode."""


@dataclass(frozen=True, kw_only=True)
class WorldOptions:
    """Options of the world; those that are not given are the task's."""

    world: Literal["ideal", "hall"] | None = None
    """`ideal`, or `hall`: with random forces and a state estimate"""
    randomization: str | None = None
    """domain randomization, such as `mass=0.9:1.1,gust_acceleration=1`: fields of
    `swarm_envs.envs.randomization.Randomization`"""
    obstacles: str | None = None
    """obstacles, such as `buildings=2:2,column=1:1:0.15` (x, y, radius, m) or
    `box=0:0:0:1:1:2` (two corners, m)"""
    on_contact: Literal["end_team", "end_pair", "bounce"] | None = None
    """effect of a contact: ends the episode of the team or of the pair, or drones bounce off"""

    observe_range_m: float | None = None
    """communication range, m: neighbors farther away are not observed"""
    observe_delay_s: float | None = None
    """communication delay, s: neighbors are observed as they were this long ago"""
    observe_loss: float | None = None
    """packet loss: probability that a neighbor is not observed in a decision"""

    def world_options(self) -> dict[str, Any]:
        """Those options of the environment that were given, ready for JSON."""
        names = [field.name for field in fields(WorldOptions)]
        return {name: value for name in names if (value := getattr(self, name)) is not None}
