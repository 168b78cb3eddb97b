"""Speed of training by PPO: agent-steps a second, and what the environment takes of it.

    python -m tests.benchmarks.training --json training.json

The recipe for swaps, 10 decisions a second, learned forces at 48 Hz, over whole rollouts with their
updates, evaluations left out. Times of one thread are CPU's, so that other work on the machine
changes little; those of two are the wall's, and say something only where two cores are free.
`environment` is all between actions and features: flight, forces, rewards,
observations, features, ends of episodes and new ones. Parts are shares of the whole.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import with_recipe
from swarm_envs.training.rl.rl_config import RlConfig
from tests.benchmarks.rows import Row, run, spread

KINDS: dict[str, dict[str, Any]] = {
    "four drones": {},
    "four and eight": {"drones": (4, 8), "num_neighbors": 5},
    "four, as deep sets": {"encoder": "deep-set"},
    "four drones, two threads": {"threads": 2},
}
"""Options of what is trained."""
ROLLOUTS = 4
"""Of a repetition."""
PARTS = ("environment", "features", "flight")
"""What is timed: the environment whole, and of it features and the flight between decisions."""


class Clocks:
    """Time in the parts of a learner.

    Args:
        learner: whose methods are timed.
        now: the clock, s.
    """

    def __init__(self, learner: PpoLearner, now: Callable[[], float]) -> None:
        self.spent, self._now = dict.fromkeys(PARTS, 0.0), now
        env = learner.env
        env.step_wait = self._timed("environment", env.step_wait)  # type: ignore[method-assign]
        env.observe = self._timed("features", env.observe)  # type: ignore[method-assign]
        for core in env.cores:
            fly = self._timed("flight", core.physics.fly)
            core.physics.fly = fly  # type: ignore[method-assign]

    def _timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **options: Any) -> Any:
            begin = self._now()
            result = call(*arguments, **options)
            self.spent[part] += self._now() - begin
            return result

        return timed


def measure(options: dict[str, Any], repetitions: int, rollouts: int = ROLLOUTS) -> list[Row]:
    """Agent-steps a second, and the parts' shares in per cent.

    Args:
        options: of the training; one thread unless they say otherwise, and then in wall time.
        repetitions: segments that are trained.
        rollouts: of each of them.
    """
    given: dict[str, Any] = {"threads": 1, "checkpoint_rollouts": rollouts, **options}
    config = with_recipe(RlConfig(out=Path("never"), **given), "swap_v0")
    now, unit = (time.thread_time, "CPU s") if config.threads == 1 else (time.perf_counter, "s")
    learner = PpoLearner(config, "swap_v0")
    clocks, speed = Clocks(learner, now), []
    shares: dict[str, list[float]] = {part: [] for part in PARTS}
    for number in range(repetitions + 1):
        before, begin = dict(clocks.spent), now()
        learner.fly(range(number * rollouts, (number + 1) * rollouts))
        spent = now() - begin
        if number:  # the first compiles and warms up
            speed.append(rollouts * config.rollout_steps / spent)
            for part in PARTS:
                shares[part].append(100.0 * (clocks.spent[part] - before[part]) / spent)
    learner.close()
    drones = sum(config.team_sizes)
    rows = [{"what": "training", "unit": f"agent-steps per {unit}", **spread(speed)}]
    rows += [{"what": f"  {part}", "unit": "% of it", **spread(shares[part])} for part in PARTS]
    return [{**row, "environments": config.environments, "drones": drones} for row in rows]


def rows(options: argparse.Namespace) -> Iterator[Row]:
    """Every row of every kind; one training gives all rows of a kind."""
    torch.set_num_threads(1)
    for name, given in KINDS.items():
        for row in measure(given, options.repetitions):
            yield row | {"what": f"{row['what']}, {name}"}


if __name__ == "__main__":
    run(__doc__, rows, repetitions=5)
