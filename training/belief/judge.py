"""Is a belief worth following? Stacked swaps with and without it, as the demonstration flies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import PAPER_SWAP, Flights, fly, swap_test
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.tasks.swap import StackedLayout


@dataclass(frozen=True)
class SwapTrial:
    """Randomised stacked swaps of one team."""

    team: str
    """The vehicles, the lowest last."""
    layout: StackedLayout
    """From what swaps are drawn."""
    episodes: int
    """Swaps that are flown."""


TRIALS = (
    *(SwapTrial(team, PAPER_SWAP, 30) for team in ("S2S", "L2S", "SS2S")),
    *(SwapTrial(team, StackedLayout(), 30) for team in ("S2S", "L2S", "SS2S")),
    *(SwapTrial(team, StackedLayout(), 12) for team in ("S2L", "L2L", "SL2S", "LL2S", "SS2L")),
)
"""What a shipped belief is judged by; seeds count from 0."""


@dataclass(frozen=True)
class SwapJudgement:
    """Worst height error of the lowest drone over the episodes of a trial, cm."""

    team: str
    """The vehicles, the lowest last."""
    layout: StackedLayout
    """From what swaps were drawn."""
    episodes: int
    """Swaps that were flown."""
    uncompensated_median_cm: float
    """Median of the worst height errors without compensation, cm."""
    compensated_median_cm: float
    """The same with the belief fed forward, cm."""
    largest_ratio: float
    """Largest of an episode's compensated over its uncompensated error."""
    worse: int
    """Episodes that compensation made worse."""
    upper_largest_growth_cm: float
    """Largest growth of another drone's worst height error by compensation."""


def judge(
    trial: SwapTrial, belief: InteractionModel, environment: str | InteractionModel = "learned"
) -> SwapJudgement:
    """Fly a trial twice, on the same seeds, references and gains: without and with the belief."""
    without = worst_height_errors(trial, ControllerConfig(), environment)
    believing = ControllerConfig(feedforward=belief)
    compensated = worst_height_errors(trial, believing, environment)
    lowest, lowest_without = compensated[:, -1], without[:, -1]
    return SwapJudgement(
        team=trial.team,
        layout=trial.layout,
        episodes=trial.episodes,
        uncompensated_median_cm=round(100 * float(np.median(lowest_without)), 2),
        compensated_median_cm=round(100 * float(np.median(lowest)), 2),
        largest_ratio=round(float((lowest / lowest_without).max()), 3),
        worse=int((lowest > lowest_without).sum()),
        upper_largest_growth_cm=round(100 * float((compensated - without)[:, :-1].max()), 2),
    )


def worst_height_errors(
    trial: SwapTrial, controller: ControllerConfig, environment: str | InteractionModel
) -> FloatArray:
    """Largest vertical distance of each drone to its reference, (episodes, N), m.

    Raises:
        RuntimeError: drones collided.
    """
    flights = fly_swaps(trial, controller, environment)
    if flights.crashed.any():
        raise RuntimeError(f"swap of {trial.team}: drones collided in a trial with {controller}")
    return flights.worst_height_error


def fly_swaps(
    trial: SwapTrial,
    controller: ControllerConfig,
    environment: str | InteractionModel,
    first_seed: int = 0,
) -> Flights:
    """Fly the episodes of a trial on their references.

    Args:
        trial: what to fly.
        controller: of every drone.
        environment: the force model that blows.
        first_seed: of the first episode; the others follow.
    """
    test = swap_test(trial.team, trial.layout, environment)
    return fly(test, controller, range(first_seed, first_seed + trial.episodes))
