"""Adaptive control and compensation compared: the table of docs/adaptation.md.

A small drone passes below a large one (L2S) with the forces `learned`, to which its force model was
fitted, with those of `wake`, and with those of `wake` and a wrong mass or noisy velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from examples.papers.common import markdown, write_json
from swarm_envs.agents.evaluation import bootstrap_interval
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.flights import FlightTest, swap_test
from swarm_envs.control.config import ControllerConfig, Indi, MomentumObserver, NeuralFly
from swarm_envs.control.tracking import TrackingController
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import load
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import BoolArray, FloatArray, Setpoint
from swarm_envs.tasks.motion import reference_of


class Disturbance(NamedTuple):
    """Forces of the environment, and what else is wrong."""

    truth: str
    randomization: Randomization | None = None
    velocity_noise: float = 0.0  # standard deviation of measured velocities, white, m/s


WRONG = 0.05 * np.sqrt(3.0)  # half width of an even distribution with a standard deviation of 5 %
DISTURBANCES = {
    "`learned`": Disturbance("learned"),
    "`wake`": Disturbance("wake"),
    "mass wrong by 5 %": Disturbance("wake", Randomization(mass=(1.0 - WRONG, 1.0 + WRONG))),
    "velocity noise 1 cm/s": Disturbance("wake", velocity_noise=0.01),
    "2 cm/s": Disturbance("wake", velocity_noise=0.02),
}
ADAPTATIONS = {
    "nothing": None,
    "momentum observer": MomentumObserver(),
    "INDI": Indi(),
    "Neural-Fly": NeuralFly(),
}


def adaptation(out: Path = Path("neural_swarm2"), episodes: int = 20) -> None:
    """Fly a swap with adaptive controllers, with and without a force model (docs/adaptation.md).

    Writes `adaptation.json` (`rows`: median error with its 95 % interval by adaptation, force model
    and disturbance), and prints the table as Markdown.

    Args:
        out: folder, made if missing.
        episodes: swaps of each cell, with the seeds 0, 1, ...
    """
    jobs = [(a, c, d) for a in ADAPTATIONS for c in (False, True) for d in DISTURBANCES]
    rows = [measure(a, c, d, episodes) for a, c, d in tqdm(jobs, "adaptation", unit="cell")]
    write_json(out / "adaptation.json", {"episodes": episodes, "rows": rows})
    lines = []
    for first in range(0, len(rows), len(DISTURBANCES)):
        own = rows[first : first + len(DISTURBANCES)]
        line = {"adaptation": own[0]["adaptation"]}
        line["belief"] = "yes" if own[0]["compensated"] else "no"
        lines.append(line | {row["disturbance"]: describe(row) for row in own})
    print(markdown(lines, list(lines[0])))


def measure(name: str, compensated: bool, disturbance: str, episodes: int) -> dict[str, Any]:
    """Fly a cell: the median of the worst height errors, and its interval by resampling, cm."""
    truth, randomization, velocity_noise = DISTURBANCES[disturbance]
    test = replace(swap_test("L2S", truth=truth), randomization=randomization)
    belief = load_belief() if compensated else None
    controller = ControllerConfig(feedforward=belief, adaptation=ADAPTATIONS[name])
    height_error, crashed = fly_noisily(test, controller, range(episodes), velocity_noise)
    worst = 100.0 * height_error[:, -1]
    low, high = bootstrap_interval(worst, np.median)
    return {
        "adaptation": name,
        "compensated": compensated,
        "disturbance": disturbance,
        "median_cm": float(np.median(worst)),
        "low_cm": low,
        "high_cm": high,
        "crashed": int(crashed.sum()),
    }


def fly_noisily(
    test: FlightTest, controller: ControllerConfig, seeds: Sequence[int], velocity_noise: float
) -> tuple[FloatArray, BoolArray]:
    """Fly an episode for each seed, with noise in the velocities that the controller measures.

    The tracking loop of the environment has the exact state. Here `TrackingController`, which is
    equal to it, commands the rotors at 240 Hz from outside of the environment.

    Returns:
        Largest vertical distances to the reference (E, N), m, and whether flights crashed (E,).
    """
    core = test.core(len(seeds), action="rotors", decision_rate=PHYSICS_RATE)
    try:
        core.reset(list(seeds))
        plain = replace(controller, feedforward=None)
        loop = TrackingController(test.task.team, len(seeds), plain)
        model = None if controller.feedforward is None else load(controller.feedforward)
        drones = core.world.drones
        most = drones["nominal_max_rotor_thrust"][..., None]
        straight = np.zeros((core.num_envs, core.num_drones))
        rng = np.random.default_rng(list(seeds))
        while core.running.any():
            state = core.physics.state
            noise = velocity_noise * rng.standard_normal(state.velocity.shape)
            state = state._replace(velocity=state.velocity + noise)
            force = None
            if model is not None:
                force = model.forces(state.position, state.velocity, test.task.team)
            setpoint = Setpoint(*reference_of(drones), straight, straight)
            core.step(2.0 * loop.commands(state, setpoint, force) / most - 1.0)
        crashed = np.asarray((drones["crashed"] > 0.0).any(axis=1))
        return drones["worst_height_error"].copy(), crashed
    finally:
        core.close()


def describe(row: dict[str, Any]) -> str:
    """Return a cell of the table."""
    crashed = f", {row['crashed']} crash" if row["crashed"] else ""
    return f"{row['median_cm']:.2f} [{row['low_cm']:.2f}, {row['high_cm']:.2f}]{crashed}"
