"""How much of the true force a model explains on swaps that nobody has seen.

The truth, an environment's own model, is asked here alone: for the report, never for a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.belief.judge import SwapTrial, fly_swaps
from swarm_envs.training.force_model.explained import explained_variance
from swarm_envs.vehicles import GRAM_FORCE, parse_team

GOALS = {2: 0.85, 3: 0.85, 5: 0.70}
"""Share of the variance of f_a,z that a model is to explain, by number of drones."""
FIRST_SEED = 50_000
"""Of the episodes."""


class SwapStates(NamedTuple):
    """States of the drones of a team along its swaps, T of them, SI units, world frame."""

    team: str
    """Who flew."""
    position: FloatArray
    """(T, N, 3)."""
    velocity: FloatArray
    """(T, N, 3)."""
    crashed: int
    """Episodes that ended in a collision."""


@dataclass(frozen=True)
class Unseen:
    """How well the models of the rounds explain the true force on the swaps of a team."""

    team: str
    """Who flew."""
    drones: int
    """Drones of the team."""
    episodes: int
    """Swaps that were flown."""
    crashed: int
    """Of them ended in a collision, flown with the last model as feed-forward."""
    rms_force_g: float
    """Of the true vertical force."""
    rms_error_g: float
    """Of the last model."""
    explained: list[float]
    """Share of the variance of f_a,z, by round."""
    explained_horizontal: list[float]
    """The same of f_a,x and f_a,y, where the models have linear drag alone."""


def swap_states(
    team: str, model: InteractionModel, truth: InteractionModel, episodes: int
) -> SwapStates:
    """Fly swaps of the stacked layout with a model as feed-forward, and note the states."""
    trial = SwapTrial(team, StackedLayout(), episodes)
    controller = ControllerConfig(feedforward=model)
    flights = fly_swaps(trial, controller, truth, FIRST_SEED)
    flying = np.arange(1, len(flights.time)) < flights.samples[:, None] - 1
    position, velocity = flights.position[:, 1:][flying], flights.velocity[:, 1:][flying]
    return SwapStates(team, position, velocity, int(flights.crashed.sum()))


def judge_unseen(
    models: Sequence[InteractionModel], truth: InteractionModel, team: str, episodes: int
) -> Unseen:
    """Judge the models of the rounds on the same states, flown with the last of them."""
    states = swap_states(team, models[-1], truth, episodes)
    _, position, velocity, crashed = states
    true = truth.forces(position, velocity, team) / GRAM_FORCE
    found = [model.forces(position, velocity, team) / GRAM_FORCE for model in models]
    return Unseen(
        team=team,
        drones=len(parse_team(team)),
        episodes=episodes,
        crashed=crashed,
        rms_force_g=round(float(np.sqrt(np.mean(true[..., 2] ** 2))), 3),
        rms_error_g=round(float(np.sqrt(np.mean((found[-1] - true)[..., 2] ** 2))), 3),
        explained=[
            round(explained_variance(model, truth, position, velocity, team), 4) for model in models
        ],
        explained_horizontal=[round(share(force, true), 4) for force in found],
    )


def share(found: FloatArray, true: FloatArray) -> float:
    """Share of the variance of the true horizontal force (T, N, 3) that another explains."""
    error = (found - true)[..., :2]
    variance = float(true[..., :2].var(axis=(0, 1)).sum())
    return 1.0 - float(np.mean(error**2, axis=(0, 1)).sum()) / variance if variance > 0 else 0.0


def by_size(unseen: Sequence[Unseen]) -> dict[int, tuple[float, float]]:
    """Mean and least share of the last model over the teams of each number of drones."""
    return {
        size: (float(np.mean(shares)), min(shares))
        for size in GOALS
        if (shares := [u.explained[-1] for u in unseen if u.drones == size])
    }
