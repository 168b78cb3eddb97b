"""What adaptation is worth: a small drone below a large one, in air and masses that it knows not.

`python -m benchmarks.adaptation` prints the table of docs/adaptation.md: the worst height
error of the small drone in the swaps of `swap_test("L2S")`, its median over the swaps with a 95 %
interval (2,000 resamples), and how many swaps ended in a crash. The last three are in `wake`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import swap_test
from swarm_envs.control.config import ControllerConfig, Indi, MomentumObserver, NeuralFly
from swarm_envs.envs.randomization import Randomization
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.imperfect_flights import NOTHING, Imperfection, fly_imperfectly

WRONG = 0.05 * np.sqrt(3.0)  # half width of an even distribution with a standard deviation of 5 %
WORLDS = {
    "`learned`": ("learned", None, NOTHING),
    "`wake`": ("wake", None, NOTHING),
    "mass wrong by 5 %": ("wake", Randomization(mass=(1.0 - WRONG, 1.0 + WRONG)), NOTHING),
    "velocity noise 1 cm/s": ("wake", None, Imperfection(velocity_noise=0.01)),
    "2 cm/s": ("wake", None, Imperfection(velocity_noise=0.02)),
}
"""The air, and what else is wrong."""
ADAPTATIONS = {
    "nothing": None,
    "momentum observer": MomentumObserver(),
    "INDI": Indi(),
    "Neural-Fly": NeuralFly(),
}
"""What is added to the controller."""


def interval(values: FloatArray) -> tuple[float, float]:
    """95 % interval of the median, by resampling."""
    drawn = np.random.default_rng(0).choice(values, (2000, len(values)))
    low, high = np.percentile(np.median(drawn, axis=1), [2.5, 97.5])
    return float(low), float(high)


def cell(world: str, compensated: bool, adaptation: str, episodes: int) -> str:
    """One cell of the table: cm."""
    truth, wrong, imperfection = WORLDS[world]
    test = replace(swap_test("L2S", truth=truth), randomization=wrong)
    belief = load_belief() if compensated else None
    controller = ControllerConfig(feedforward=belief, adaptation=ADAPTATIONS[adaptation])
    found = fly_imperfectly(test, controller, range(episodes), imperfection)
    worst = 100.0 * found.height_error[:, -1]
    low, high = interval(worst)
    crashed = f", {found.crashed.sum()} crash" if found.crashed.any() else ""
    return f"{np.median(worst):.2f} [{low:.2f}, {high:.2f}]{crashed}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=20, help="swaps of each cell")
    episodes = parser.parse_args().episodes
    print("| adaptation | belief |", " | ".join(WORLDS), "|")
    print("|" + "---|" * (2 + len(WORLDS)))
    for adaptation in ADAPTATIONS:
        for compensated in (False, True):
            cells = [cell(world, compensated, adaptation, episodes) for world in WORLDS]
            said = "yes" if compensated else "no"
            print(f"| {adaptation} | {said} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()
