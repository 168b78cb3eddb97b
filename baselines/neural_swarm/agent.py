"""The tracking controller of Neural-Swarm2 (Sec. VI) as an agent.

It emits the set-points of the task's reference; the loop that follows them is the environment's,
configured as the agent declares. `compensated()` adds the interaction force that a deep set
predicts, fitted to flights inside the environment, never the environment's own model; without
it the controller is the paper's baseline, identical in everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents import Actions, Observations
from swarm_envs.agents.detour import DetourAgent
from swarm_envs.arguments import typed
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.interactions import InteractionModel, load

BELIEFS: Mapping[str, str] = {"learned": "belief", "wake": "belief_wake"}
"""Files of the beliefs that ship, by the force model of the environment they were learned in."""


@typed
def load_belief(truth: str = "learned") -> InteractionModel:
    """The deep set that the compensated controller believes: fitted to simulated flights.

    See `weights/MODEL_CARD.md` beside the weights for the flights and the errors.

    Args:
        truth: name of the environment's force model: the belief was learned from flights in it.

    Raises:
        ValueError: no belief ships for that model.
    """
    if truth not in BELIEFS:
        raise ValueError(
            f"no belief ships for an environment with the force model {truth!r}, only for "
            f"{' and '.join(BELIEFS)}; learn one there, by `swarm-envs curriculum --interactions "
            f"{truth} --out DIR`, and name its weights"
        )
    return _read_shipped(BELIEFS[truth])


@cache
def _read_shipped(name: str) -> InteractionModel:
    weights = resources.files("swarm_envs.baselines.neural_swarm").joinpath("weights")
    with resources.as_file(weights.joinpath(f"{name}.safetensors")) as path:
        return load(Path(path))


@typed
class TrackingAgent:
    """Follows the task's reference with the tracking loop of Neural-Swarm2.

    Args:
        controller: configuration of the loop; None for the paper's baseline, uncompensated.
        decision_rate: set-points per second.
    """

    privileged = True

    def __init__(self, controller: ControllerConfig | None = None, decision_rate: int = 48) -> None:
        self.requires: Mapping[str, Any] = {
            "action": "setpoint",
            "decision_rate": decision_rate,
            "controller": controller or ControllerConfig(),
        }
        self._agents: list[str] = []

    @classmethod
    def compensated(
        cls, belief: InteractionModel | None = None, decision_rate: int = 48
    ) -> TrackingAgent:
        """The agent that feeds forward the force it believes; by default `load_belief()`."""
        believed = belief if belief is not None else load_belief()
        return cls(ControllerConfig(feedforward=believed), decision_rate)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Note the agents' names; nothing here is random."""
        self._agents = list(env.agents)

    def act(self, observations: Observations, view: View | None) -> Actions:
        """The reference's present position, velocity, acceleration and jerk; no yaw.

        Raises:
            ValueError: there is no view: the reference is part of it.
        """
        if view is None:
            raise ValueError("the tracking agent is privileged: pass env.view as the view")
        reference = view.reference(view.time)
        yaw = np.zeros((len(self._agents), 2))
        rows = np.concatenate([*reference, yaw], axis=1)
        return dict(zip(self._agents, rows, strict=True))


def compensated_detour() -> DetourAgent:
    """`DetourAgent` with the paper's controller beneath it, which feeds `load_belief()` forward."""
    return DetourAgent(ControllerConfig(feedforward=load_belief()))
