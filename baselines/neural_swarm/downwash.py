"""Agents for the tasks dominated by downwash, with and without a model of the force.

All fly from rest to rest to their goals, or follow the reference if goals move. They differ in
their controllers and in the assignment of goals. Their parameters were tuned on these tasks with
seeds other than the benchmark's, by `python -m examples.tune_agents`.
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

_INTEGRAL_LIMIT = 3.0  # Compensates the largest force of these tasks, m
_PEAK = 7.5132  # Largest acceleration from rest to rest over a distance of 1 m in 1 s, m/s^2


@dataclass(frozen=True, kw_only=True)
class DownwashSettings:
    """The parameters of an agent of these tasks."""

    position: float
    """The position gain of `PositionGains`, 1/s."""
    velocity: float
    """The velocity gain of `PositionGains`, 1/s."""
    integral: float
    """The integral gain of `PositionGains`, 1/s."""
    attitude: float = 20.0
    """The `attitude_tilt` of `ControllerConfig`, 1/s. With less, noise costs less thrust."""
    rate: float = 25.0
    """The `rate_tilt` of `ControllerConfig`, 1/s."""
    cutoff_hz: float = 0.0
    """The cutoff of `Indi`, which estimates the force in flight, Hz; 0 for no estimate."""
    acceleration: float = 4.6
    """The largest acceleration of a flight to an assigned goal, m/s^2."""
    travel_s: float = 1.6
    """The duration of a flight to a goal that any drone may take, s."""
    compensated: bool = False
    """True to feed `load_belief()` forward."""
    heavy_on_top: bool = False
    """True to place drones with little spare thrust on top, if any may take any goal."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("position", "velocity", "integral", "attitude", "rate", "acceleration"):
            check_number(name, getattr(self, name), above=0.0)
        check_number("cutoff_hz", self.cutoff_hz, at_least=0.0, at_most=20.0, unit="Hz")
        check_number("travel_s", self.travel_s, above=0.0, unit="s")
        for name in ("compensated", "heavy_on_top"):
            check_bool(name, getattr(self, name))

    def controller(self) -> ControllerConfig:
        """Return the configuration of the tracking loop."""
        return ControllerConfig(
            gains=PositionGains(self.position, self.velocity, self.integral),
            feedforward=load_belief() if self.compensated else None,
            adaptation=Indi(self.cutoff_hz) if self.cutoff_hz else None,
            attitude_tilt=self.attitude,
            rate_tilt=self.rate,
            velocity_integral_limit=_INTEGRAL_LIMIT,
        )

    def agent(self) -> RestToRestAgent:
        """Return an agent with these parameters."""
        return RestToRestAgent(self)


class RestToRestAgent(TrackingAgent):
    """Flies from rest to rest to its goals, or follows the reference if goals move.

    Args:
        numbers: The parameters of the agent.
    """

    def __init__(self, numbers: DownwashSettings) -> None:
        super().__init__(numbers.controller())
        self._numbers = numbers
        self._named = self._follows = True
        self._goals: FloatArray | None = None
        self._flight = np.zeros((0, 3)), np.zeros((0, 3)), 1.0, 0.0

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Begin an episode; the seed is not used."""
        super().reset(env, seed)
        task = env.core.task
        self._follows = not self.goals_rest(task)
        self._named, self._goals = getattr(task.success, "named", True), None

    def reference(self, view: View) -> Reference:
        """Return the point of the flight to the goals at this time, or the task's reference."""
        if self._follows:
            return super().reference(view)
        if self._goals is None or (self._named and not np.array_equal(view.goals, self._goals)):
            self._plan(view)
        start, goals, duration, began = self._flight
        return rest_to_rest(start, goals, duration, view.time - began)

    def _plan(self, view: View) -> None:
        """Plan the flight from the present setpoints to the goals, reassigned if allowed."""
        goals = self._goals = np.array(view.goals)
        if self._numbers.heavy_on_top and not self._named:
            goals = place_heavy_on_top(goals, view.team)
        start, duration = np.array(view.setpoint.position), self._numbers.travel_s
        if self._named:
            longest = float(np.linalg.norm(goals - start, axis=1).max())
            duration = max(0.1, (_PEAK * longest / self._numbers.acceleration) ** 0.5)
        self._flight = start, goals, duration, view.time


_PRECISE = DownwashSettings(
    position=6.0, velocity=10.0, integral=1.5, attitude=16.0, rate=16.5, cutoff_hz=4.8
)
TUNED: Mapping[str, DownwashSettings] = MappingProxyType(
    {
        "pid": DownwashSettings(position=5.0, velocity=7.5, integral=2.5),
        "pid+adaptive": _PRECISE,
        "downwash-aware": replace(_PRECISE, compensated=True, heavy_on_top=True),
        "heavy-on-top": DownwashSettings(
            position=0.87, velocity=4.6, integral=1.4, attitude=11.0, rate=4.8, cutoff_hz=2.9,
            compensated=True, heavy_on_top=True,
        ),
    }
)  # fmt: skip
"""The parameters of the shipped agents, by name."""


pid, pid_adaptive, downwash_aware, heavy_on_top = (numbers.agent for numbers in TUNED.values())
"""Factories of the shipped agents."""


def place_heavy_on_top(places: FloatArray, team: Team) -> FloatArray:
    """Return positions (N, 3), m, permuted in each column so that spare thrust falls with height.

    Args:
        places: The positions (N, 3) of the drones, m.
        team: The N vehicles.
    """
    # The spare force decides, not its ratio to the weight: a large drone with a payload has the
    # ratio of a small one without, but withstands twice the force.
    spare = np.array([v.mass * (v.thrust_to_weight - 1.0) for v in team])
    chosen = np.empty_like(places)
    columns = np.unique(places[:, :2].round(6), axis=0, return_inverse=True)[1].ravel()
    for column in range(columns.max() + 1):
        drones = np.flatnonzero(columns == column)
        down = drones[np.argsort(-places[drones, 2])]
        chosen[down[np.argsort(spare[down], kind="stable")]] = places[down]
    return chosen
