"""Agents for the tasks that downwash decides, with and without a model of the force.

All fly from rest to rest to their goals, or follow the reference where goals move. They differ in
their controllers and in the choice of places. Their numbers were tuned on these tasks, with other
seeds than the benchmark's: `python -m examples.tune_agents`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief
from swarm_envs.control.config import ControllerConfig, Indi, PositionGains
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_bool, check_number
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference, rest_to_rest
from swarm_envs.vehicles import Team

__all__ = ["TUNED", "DownwashSettings", "place_heavy_on_top"]

_INTEGRAL_LIMIT = 3.0  # Holds the largest force of these tasks, m
_PEAK = 7.5132  # Largest acceleration from rest to rest over a distance of 1 m in 1 s, m/s^2


@dataclass(frozen=True, kw_only=True)
class DownwashSettings:
    """Every number of an agent of these tasks, and what it knows."""

    position: float
    """As of `PositionGains`, 1/s."""
    velocity: float
    """As of `PositionGains`, 1/s."""
    integral: float
    """As of `PositionGains`, 1/s."""
    attitude: float = 20.0
    """`attitude_tilt` of `ControllerConfig`, 1/s. Where it is softer, noise costs less thrust."""
    rate: float = 25.0
    """`rate_tilt` of `ControllerConfig`, 1/s."""
    cutoff_hz: float = 0.0
    """Of `Indi`, which estimates the force in flight; 0 for no estimate."""
    acceleration: float = 4.6
    """Largest acceleration on the way to a goal, m/s^2."""
    travel_s: float = 1.6
    """Time of the way to a place that any may take, s."""
    believes: bool = False
    """Whether it feeds `load_belief()` forward."""
    chooses: bool = False
    """Whether those with little thrust to spare go on top, where any may take any place."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for name in ("position", "velocity", "integral", "attitude", "rate", "acceleration"):
            check_number(name, getattr(self, name), above=0.0)
        check_number("cutoff_hz", self.cutoff_hz, at_least=0.0, at_most=20.0, unit="Hz")
        check_number("travel_s", self.travel_s, above=0.0, unit="s")
        for name in ("believes", "chooses"):
            check_bool(name, getattr(self, name))

    def controller(self) -> ControllerConfig:
        """The tracking loop with these numbers."""
        return ControllerConfig(
            gains=PositionGains(self.position, self.velocity, self.integral),
            feedforward=load_belief() if self.believes else None,
            adaptation=Indi(self.cutoff_hz) if self.cutoff_hz else None,
            attitude_tilt=self.attitude,
            rate_tilt=self.rate,
            velocity_integral_limit=_INTEGRAL_LIMIT,
        )

    def agent(self) -> RestToRestAgent:
        """An agent with these numbers."""
        return RestToRestAgent(self)


class RestToRestAgent(TrackingAgent):
    """Flies from rest to rest to its goals, or follows the reference where goals move.

    Args:
        numbers: of its controller and its ways, and what it knows.
    """

    def __init__(self, numbers: DownwashSettings) -> None:
        super().__init__(numbers.controller())
        self._numbers = numbers
        self._named = self._follows = True
        self._goals: FloatArray | None = None
        self._way = np.zeros((0, 3)), np.zeros((0, 3)), 1.0, 0.0

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Note what the task is like; nothing here is random."""
        super().reset(env, seed)
        task = env.core.task
        self._follows = not self.goals_rest(task)
        self._named, self._goals = getattr(task.success, "named", True), None

    def reference(self, view: View) -> Reference:
        """The way at this time, or the task's reference."""
        if self._follows:
            return super().reference(view)
        if self._goals is None or (self._named and not np.array_equal(view.goals, self._goals)):
            self._plan(view)
        start, places, duration, began = self._way
        return rest_to_rest(start, places, duration, view.time - began)

    def _plan(self, view: View) -> None:
        """The way from the set-points of this moment to the goals, or to better places."""
        places = self._goals = np.array(view.goals)
        if self._numbers.chooses and not self._named:
            places = place_heavy_on_top(places, view.team)
        start, duration = np.array(view.setpoint.position), self._numbers.travel_s
        if self._named:
            longest = float(np.linalg.norm(places - start, axis=1).max())
            duration = max(0.1, (_PEAK * longest / self._numbers.acceleration) ** 0.5)
        self._way = start, places, duration, view.time


_PRECISE = DownwashSettings(
    position=6.0, velocity=10.0, integral=1.5, attitude=16.0, rate=16.5, cutoff_hz=4.8
)
TUNED: Mapping[str, DownwashSettings] = MappingProxyType(
    {
        "pid": DownwashSettings(position=5.0, velocity=7.5, integral=2.5),
        "pid+adaptive": _PRECISE,
        "downwash-aware": replace(_PRECISE, believes=True, chooses=True),
        "heavy-on-top": DownwashSettings(
            position=0.87, velocity=4.6, integral=1.4, attitude=11.0, rate=4.8, cutoff_hz=2.9,
            believes=True, chooses=True,
        ),
    }
)  # fmt: skip
"""Numbers of the shipped agents, by name."""


pid, pid_adaptive, downwash_aware, heavy_on_top = (numbers.agent for numbers in TUNED.values())
"""Factories of the shipped agents."""


def place_heavy_on_top(places: FloatArray, team: Team) -> FloatArray:
    """(N, 3) the same places, changed within each column: who has little thrust to spare goes up.

    Args:
        places: (N, 3) of the drones, m.
        team: N vehicles.
    """
    # What counts is the force that is left, not its share of the weight: a large drone with a
    # payload has the same share as a small one without, and can hold twice the force.
    spare = np.array([v.mass * (v.thrust_to_weight - 1.0) for v in team])
    chosen = np.empty_like(places)
    columns = np.unique(places[:, :2].round(6), axis=0, return_inverse=True)[1].ravel()
    for column in range(columns.max() + 1):
        drones = np.flatnonzero(columns == column)
        down = drones[np.argsort(-places[drones, 2])]
        chosen[down[np.argsort(spare[down], kind="stable")]] = places[down]
    return chosen
