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
    """Options of the world. An option that is None has the task's default."""

    world: Literal["ideal", "hall"] | None = None
    """World: `ideal`, or `hall`, a motion-capture hall with random forces and state estimation
    errors. If None, the task's default."""
    randomization: str | None = None
    """Domain randomization, such as `mass=0.9:1.1,gust_acceleration=1`; the names are fields of
    `swarm_envs.envs.randomization.Randomization`. If None, the task's default."""
    obstacles: str | None = None
    """Obstacles, such as `buildings=2:2,column=1:1:0.15` (x, y and radius, m) or
    `box=0:0:0:1:1:2` (two corners, m). If None, the task's default."""
    on_contact: Literal["end_team", "end_pair", "bounce"] | None = None
    """Effect of a contact: `end_team` ends the episode of the whole team, `end_pair` that of the
    drones in contact; with `bounce`, they bounce off and continue. If None, the task's default."""

    observe_range_m: float | None = None
    """Communication range, m; neighbors farther away are not observed. If None, unlimited."""
    observe_delay_s: float | None = None
    """Communication delay of observed neighbors, s, rounded up to decisions. If None, 0."""
    observe_loss: float | None = None
    """Packet loss: probability that a neighbor is not observed in a decision. If None, 0."""

    def world_options(self) -> dict[str, Any]:
        """Return the options that were given, as values for JSON."""
        names = [field.name for field in fields(WorldOptions)]
        return {name: value for name in names if (value := getattr(self, name)) is not None}
