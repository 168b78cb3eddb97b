"""Speed of training by PPO: agent-steps a second of CPU time, and what the environment takes of it.

    python -m tests.benchmarks.training --json training.json

The recipe for swaps, 10 decisions a second, learned forces at 48 Hz, over whole rollouts with their
updates, evaluations left out. All times are CPU's, of one thread, so that other work on the machine
changes little. `environment` is all between actions and features: flight, forces, rewards,
observations, features, ends of episodes and new ones. Parts are shares of the whole.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import torch

from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import completed
from tests.benchmarks.rows import Job, Row, run, spread

KINDS: dict[str, dict[str, Any]] = {
    "four drones": {},
    "four and eight": {"drones": (4, 8), "num_neighbors": 5},
    "four, as deep sets": {"encoder": "deep-set"},
}
"""Options of what is trained."""
ROLLOUTS = 4
"""Of a repetition."""
PARTS = ("environment", "features", "flight")
"""What is timed: the environment whole, and of it features and the flight between decisions."""


class Clocks:
    """CPU time of this thread in the parts of a learner."""

    def __init__(self, learner: PpoLearner) -> None:
        self.spent = dict.fromkeys(PARTS, 0.0)
        env = learner.env
        env.step_wait = self._timed("environment", env.step_wait)
        env.told = self._timed("features", env.told)  # type: ignore[method-assign]
        for core in env.cores:
            core.flight.fly = self._timed("flight", core.flight.fly)  # type: ignore[method-assign]

    def _timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **options: Any) -> Any:
            begin = time.thread_time()
            result = call(*arguments, **options)
            self.spent[part] += time.thread_time() - begin
            return result

        return timed


def measure(options: dict[str, Any], repetitions: int, rollouts: int = ROLLOUTS) -> list[Row]:
    """Agent-steps a second of CPU time, and the parts' shares in per cent.

    Args:
        options: of the training.
        repetitions: segments that are trained.
        rollouts: of each of them.
    """
    plain = TrainConfig(out=Path("never"), threads=1, checkpoint_rollouts=rollouts, **options)
    config = completed(plain, "swap_v0")
    learner = PpoLearner(config, "swap_v0")
    clocks, speed = Clocks(learner), []
    shares: dict[str, list[float]] = {part: [] for part in PARTS}
    for number in range(repetitions + 1):
        before, begin = dict(clocks.spent), time.thread_time()
        learner.fly(range(number * rollouts, (number + 1) * rollouts))
        spent = time.thread_time() - begin
        if number:  # the first compiles and warms up
            speed.append(rollouts * config.rollout_steps / spent)
            for part in PARTS:
                shares[part].append(100.0 * (clocks.spent[part] - before[part]) / spent)
    learner.close()
    drones = sum(config.team_sizes)
    rows = [{"what": "training", "unit": "agent-steps per CPU s", **spread(speed)}]
    rows += [{"what": f"  {part}", "unit": "% of it", **spread(shares[part])} for part in PARTS]
    return [{**row, "environments": config.environments, "drones": drones} for row in rows]


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """Every row of every kind; one training gives all rows of a kind."""
    torch.set_num_threads(1)
    for name, given in KINDS.items():
        measured: list[Row] = []

        def fetch(
            k: int, name: str = name, given: dict[str, Any] = given, rows: list[Row] = measured
        ) -> Row:
            if not rows:
                rows += measure(given, options.repetitions)
            return {**rows[k], "what": f"{rows[k]['what']}, {name}"}

        for k in range(len(PARTS) + 1):
            yield partial(fetch, k)


if __name__ == "__main__":
    run(__doc__, jobs, repetitions=5)
