"""Agents for the tasks in which the air decides: one that ignores it, and one that knows it.

Both follow the task's reference, with gains that were tuned on these tasks in the world `"hall"`.
The second also decides which drone flies on top.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.agents import Actions, Observations
from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief
from swarm_envs.control.config import ControllerConfig, Indi, PositionGains
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import rest_to_rest
from swarm_envs.vehicles import Team

__all__: list[str] = []

_INTEGRAL_LIMIT = 3.0
"""Holds the largest force of these tasks, m."""
TRAVEL_S = 2.5
"""Time in which drones fly to the places that they choose, s."""


def air_blind() -> TrackingAgent:
    """Follows the reference with stiff gains and an integrator, and knows of no air."""
    gains = PositionGains(5.0, 7.5, 2.5)
    return TrackingAgent(ControllerConfig(gains, velocity_integral_limit=_INTEGRAL_LIMIT))


def air_blind_adaptive() -> TrackingAgent:
    """The same, but estimates the force in flight, by `Indi`, which suits softer gains."""
    return TrackingAgent(_controller(knows=False))


def _controller(knows: bool) -> ControllerConfig:
    return ControllerConfig(
        gains=PositionGains(4.5, 7.0, 2.0),
        feedforward=load_belief() if knows else None,
        adaptation=Indi(3.5),
        velocity_integral_limit=_INTEGRAL_LIMIT,
    )


class AirAwareAgent(TrackingAgent):
    """Feeds `load_belief()` forward; where any drone may take any place, the heavy go on top."""

    def __init__(self) -> None:
        super().__init__(_controller(knows=True))
        self._places: FloatArray | None = None
        self._start: FloatArray = np.zeros((0, 3))

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Choose places, if there is a choice; nothing here is random."""
        super().reset(env, seed)
        view, success = env.view, getattr(env.core.task, "success", None)
        self._start, self._places = np.array(view.state.position), None
        if not getattr(success, "named", True):
            self._places = heavy_on_top(np.array(view.goals), view.team)

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Position, velocity, acceleration and jerk on the way; no yaw."""
        if self._places is None or view is None:
            return super().act(observations, view)
        way = rest_to_rest(self._start, self._places, TRAVEL_S, view.time)
        rows = np.concatenate([*way, np.zeros((len(self._start), 2))], axis=1)
        return dict(zip(self._agents, rows, strict=True))


def heavy_on_top(places: FloatArray, team: Team) -> FloatArray:
    """The same places (N, 3), changed in each column: who has little thrust to spare goes up."""
    spare, chosen = np.array([v.thrust_to_weight for v in team]), np.empty_like(places)
    columns = np.unique(places[:, :2].round(6), axis=0, return_inverse=True)[1].ravel()
    for column in range(columns.max() + 1):
        drones = np.flatnonzero(columns == column)
        down = drones[np.argsort(-places[drones, 2])]
        chosen[down[np.argsort(spare[down], kind="stable")]] = places[down]
    return chosen
