"""Agents that teach and do not ship: `--dagger.teacher swarm_envs/training/rl/teachers.py:NAME`."""

from __future__ import annotations

from dataclasses import replace

from swarm_envs.agents import Safety, SafetyFilter
from swarm_envs.agents.avoiding import TUNED


def wide_roundabout() -> SafetyFilter:
    """The shipped `roundabout`, faster and with a wider margin.

    An imitation errs by some of the margin, and is somewhat slower than its teacher.
    """
    shipped = TUNED["roundabout"]
    cruise = replace(shipped.cruise, position_gain=16.0, velocity_gain=6.0, speed_mps=1.9)
    safety = Safety(margin_m=0.2, horizon_s=0.5, response_s=0.126, rate=8.73, downwash=1.15)
    return replace(shipped, cruise=cruise, safety=safety).agent()
