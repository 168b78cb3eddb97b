"""A plan flown by quadrotors in an environment whose force the planner does not know.

What the paper's simulation leaves out is in: attitude, rotor lag, thrust limits, and a force that
differs from what was believed when the plan was made. The tracking controller of Sec. VI follows
the plan, with compensation of the believed force or without.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import InteractionModel
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.reproduce.planning.plant import Track

DECISION_RATE = 48
"""Set-points a second, and samples of what is measured."""


def fly_plan(
    plan: SwarmPlan,
    controller: ControllerConfig,
    truth: str | InteractionModel = "learned",
    engine: str = "batch",
) -> tuple[Track, bool]:
    """Fly a plan from its beginning to its end.

    Args:
        plan: starts, goals and motions of the team.
        controller: of every drone; `feedforward` is what it believes.
        truth: the force that blows.
        engine: `bullet` or `batch`.

    Returns:
        What became of it, sampled after each decision, and whether it ended by a crash.
    """
    core = _make_core(plan, controller, truth, engine)
    try:
        straight = np.zeros((len(plan.team), 2))
        core.reset([0], options={"start": plan.starts, "goal": plan.goals})
        samples: list[tuple[Any, ...]] = []
        while core.running[0]:
            reference = plan.reference(float(core.time[0]))
            core.step(np.concatenate([*reference, straight], axis=1)[None])
            samples.append(_sample(core, plan))
        track = Track(*(np.array(column) for column in zip(*samples, strict=True)))
        return track, bool((core.world.drones["crashed"][0] > 0.0).any())
    finally:
        core.close()


def _make_core(
    plan: SwarmPlan, controller: ControllerConfig, truth: str | InteractionModel, engine: str
) -> SwarmCore:
    config = EnvConfig(
        physics=engine,
        interactions=truth,
        action="setpoint",
        decision_rate=DECISION_RATE,
        controller=controller,
        horizon_s=round(plan.duration * DECISION_RATE) / DECISION_RATE,
        end_on_success=False,
    )
    return SwarmCore(SwapTask(plan.team, "random"), config)


def _sample(core: SwarmCore, plan: SwarmPlan) -> tuple[Any, ...]:
    """Fields of a `Track` at this instant."""
    time, state = float(core.time[0]), core.physics.state
    planned = plan.reference(time).position
    flown = (state.position, state.velocity, core.physics.force)
    return time, planned, *(array[0].copy() for array in flown)
