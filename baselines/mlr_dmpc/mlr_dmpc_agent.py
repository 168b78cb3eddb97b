"""MLR-DMPC as an agent: each decision is a round, and the tracking loop follows its references.

The agent simulates compute units, drones and radio; the environment simulates the flight. A
reference has constant jerk within a round, so that five setpoints a second describe it fully.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Literal

import numpy as np

from swarm_envs.agents.scripted import SetpointAgent
from swarm_envs.baselines.mlr_dmpc.avoidance_planes import obstacle_planes
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import Deaf, MlrDmpcSwarm, Unreachable
from swarm_envs.baselines.mlr_dmpc.unit_planner import Obstacles
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer, check_name
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.motion import REST
from swarm_envs.tasks.obstacles import obstacle_rows
from swarm_envs.trajectories import Reference

_TRACKING_M = 0.05  # The clearance of references from walls beyond the drone's radius, m
_ROOM = 1.2
"""The least distance of starts and goals over that of references, so that drones can pass."""


class MlrDmpcAgent(SetpointAgent):
    """Flies to goals at rest by distributed MPC over a radio that may lose messages.

    Args:
        compute_units: The number of compute units; None for three, or one per drone if fewer.
        loss: The rate or model of message loss.
        recovery: The recovery from message loss, as for `MlrDmpcSwarm`.
        controller: The configuration of the tracking loop; None for its default, which assumes no
            interaction force, as in the paper.
        config: The parameters; box and scaling are fitted to the episode.

    The scaling of heights (Theta) is the configured one, the paper's 6, or less if starts or goals
    of the episode are closer above each other; `config.scaling` has the value of the episode.
    """

    def __init__(
        self,
        compute_units: int | None = None,
        loss: float | LossModel = 0.0,
        recovery: bool | Literal["paper"] = True,
        controller: ControllerConfig | None = None,
        config: MlrDmpcConfig | None = None,
    ) -> None:
        if compute_units is not None:
            check_integer("compute_units", compute_units)
        check_name("recovery", str(recovery), ("True", "False", "paper"))
        self._given = MlrDmpcConfig() if config is None else config
        super().__init__(
            {
                "action": "setpoint",
                "decision_rate": round(1.0 / self._given.round_s),
                "controller": controller or ControllerConfig(),
            }
        )
        self._compute_units = compute_units
        self._loss, self._recovery = loss, recovery
        self.config = self._given
        """The parameters of the episode."""
        self.swarm: MlrDmpcSwarm | None = None
        """Compute units, drones and radio of the episode; None before the first."""
        self.faults: dict[int, str] = {}
        """The reason, by drone, that it cannot reach its goal in this episode: it receives nothing,
        or another rests on the goal. A `RuntimeWarning` reports each when it is found."""

    @classmethod
    def compensated(cls) -> MlrDmpcAgent:
        """Return the agent over Neural-Swarm2's controller with `load_belief()`."""
        return cls(controller=ControllerConfig(feedforward=load_belief()))

    def check(self, task: Task) -> None:
        """Raise ValueError for a task whose goals move."""
        self.check_rest(task)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Begin an episode with all drones hovering; the seed determines message losses.

        Raises:
            ValueError: Goals move, or starts or goals are too close to each other for any scaling.
        """
        task, start = env.core.task, env.view.state.position
        super().reset(env, seed)
        goals = env.core.world.goals[0]
        if task.motion.kind == REST and not task.motion.stage_s:
            goals = goals.reshape(1, -1, 3)  # Any two of the sites may be goals at the same time
        self.faults = {}
        self.config = replace(
            self._given,
            box=_box(task, start, goals),
            scaling=_scaling(self._given, start[None], goals),
        )
        units = min(3, len(start)) if self._compute_units is None else self._compute_units
        self.swarm = MlrDmpcSwarm(
            np.array(start),
            np.array(env.view.goals),
            config=self.config,
            compute_units=units,
            loss=self._loss,
            recovery=self._recovery,
            seed=seed,
            obstacles=_obstacles(task, self.config),
        )

    def reference(self, view: View) -> Reference:
        """Run the round that begins, and return its reference."""
        assert self.swarm is not None, "reset the agent before it acts"
        flown = self.swarm.reference(np.zeros(1))[:, 0]
        measured = np.stack([view.state.position, view.state.velocity], axis=1)
        self.swarm.run_round(targets=np.array(view.goals), measured=measured)
        found: list[Deaf | Unreachable] = [*self.swarm.deaf, *self.swarm.unreachable]
        for fault in found:
            if fault.drone not in self.faults:
                self.faults[fault.drone] = str(fault)
                warnings.warn(str(fault), RuntimeWarning, stacklevel=3)
        return Reference(*flown.swapaxes(0, 1))


def _box(
    task: Task, start: FloatArray, goals: FloatArray
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the arena less a margin, enlarged to contain starts (N, 3) and goals (S, N, 3)."""
    margin = float(task.radius.max()) + _TRACKING_M
    points = np.concatenate([start, goals.reshape(-1, 3)])
    low = np.minimum(task.arena[0] + margin, points.min(axis=0))
    high = np.maximum(task.arena[1] - margin, points.max(axis=0))
    return (
        (float(low[0]), float(low[1]), float(low[2])),
        (float(high[0]), float(high[1]), float(high[2])),
    )


def _obstacles(task: Task, config: MlrDmpcConfig) -> Obstacles | None:
    if not task.obstacles:
        return None
    rows = obstacle_rows(task.obstacles)
    margin = float(task.radius.max()) + _TRACKING_M
    return lambda own, start_round: obstacle_planes(own, start_round, rows, margin, config)


def _scaling(config: MlrDmpcConfig, *places: FloatArray) -> tuple[float, float, float]:
    """Return the scaling with the largest height, at most the configured, that (20) allows.

    `places` are positions (S, N, 3), m, of stages, each of which drones must be able to hold.
    """
    configured = config.scaling
    largest = configured[2]
    pairs = []  # Distances of all pairs of a stage, by axis, m
    for one in places:
        first, second = np.triu_indices(one.shape[1], 1)
        pairs.append(np.abs(one[:, first] - one[:, second]).reshape(-1, 3))
    apart = np.concatenate(pairs)
    level = np.hypot(apart[:, 0] / configured[0], apart[:, 1] / configured[1])
    needed = np.sqrt(np.maximum((_ROOM * config.distance_m) ** 2 - level**2, 0.0))
    close = needed > 0.0
    if close.any():
        largest = min(largest, float((apart[close, 2] / needed[close]).min()))
    if largest < 1.0:
        raise ValueError(
            f"two starts or goals of this episode are closer than {_ROOM * config.distance_m:.3g} "
            "m, which drones need; spread them, or pass a config with a smaller distance_m"
        )
    return (configured[0], configured[1], largest)
