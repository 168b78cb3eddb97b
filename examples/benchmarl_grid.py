"""Run BenchMARL's grid of algorithms, tasks and seeds on tasks of swarm-envs.

pip install 'swarm-envs[train]' benchmarl
python examples/benchmarl_grid.py --algorithms ippo mappo masac qmix --tasks swap_v1 --seeds 0 1

Algorithms that need discrete actions (`qmix`, `vdn`, `iql`) choose one of seven accelerations:
zero, or the largest along an axis. The table shows mean returns of evaluation episodes; marl-eval
plots the JSON files in --out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.benchmark import Benchmark
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper
from torchrl.envs import PettingZooWrapper

import swarm_envs

RATE = 10
OPTIONS: dict[str, Any] = {
    **{"physics": "batch", "action": "acceleration", "decision_rate": RATE, "num_drones": 4},
    **{"horizon_s": 3.5, "force_rate": 48},
}


class Directions(BaseParallelWrapper):
    """Seven actions: zero, and the largest along every axis."""

    table = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)]).astype(np.float32)

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the space of row numbers of `table`."""
        return spaces.Discrete(len(self.table))

    def step(self, actions: dict[str, int]) -> Any:
        """Execute one decision of all drones."""
        return super().step({agent: self.table[int(a)] for agent, a in actions.items()})


class SwarmClass(PettingZooClass):
    """A task of swarm-envs for BenchMARL, by name and options."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], PettingZooWrapper]:
        """Return a function that makes an environment."""

        def make() -> PettingZooWrapper:
            env = swarm_envs.make(self.name, **self.config)
            return PettingZooWrapper(
                env=env if continuous_actions else Directions(env),
                return_state=True,
                categorical_actions=True,
                use_mask=True,
                done_on_any=False,
                seed=seed,
                device=device,
            )

        return make

    def supports_continuous_actions(self) -> bool:
        """Return True: the action mode of `OPTIONS` is continuous."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Return True: `Directions` has discrete actions."""
        return True

    def has_state(self) -> bool:
        """Return True: centralized critics observe the whole team."""
        return True

    def has_render(self, env: Any) -> bool:
        """Return False: `swarm-envs fly` makes films."""
        return False

    def max_steps(self, env: Any) -> int:
        """Return the number of decisions of an episode."""
        return round(self.config["horizon_s"] * self.config["decision_rate"])


def experiment_config(steps: int, envs: int, out: Path) -> ExperimentConfig:
    """Return BenchMARL's defaults with batches of four rollouts of 3.5 s and few updates."""
    config = ExperimentConfig.get_from_yaml()
    batch = min(steps, 4 * 35 * envs)
    config.max_n_iters, config.max_n_frames = None, steps
    config.on_policy_collected_frames_per_batch = batch
    config.off_policy_collected_frames_per_batch = batch
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = envs
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 10, batch // 4
    config.off_policy_n_optimizer_steps = max(1, batch // 16)
    config.evaluation_interval = batch * max(1, steps // batch // 4)
    config.gamma, config.loggers, config.render = 0.98, ["csv"], False
    out.mkdir(parents=True, exist_ok=True)
    config.save_folder = str(out)
    return config


def returns_of(out: Path) -> dict[tuple[str, str], list[float]]:
    """Return the mean return of the last evaluation of each seed, by task and algorithm."""
    found: dict[tuple[str, str], list[float]] = {}
    for file in sorted(out.rglob("*.json")):
        for task, algorithms in json.loads(file.read_text())["pettingzoo"].items():
            for algorithm, seeds in algorithms.items():
                for steps in seeds.values():
                    last = [steps[k] for k in steps if k.startswith("step_")][-1]
                    found.setdefault((task, algorithm), []).append(float(np.mean(last["return"])))
    return found


def main(arguments: list[str] | None = None) -> dict[tuple[str, str], list[float]]:
    """Run the grid, print its table, and return it."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = sorted(algorithm_config_registry)
    parser.add_argument("--algorithms", nargs="+", choices=names, default=["ippo", "mappo"])
    parser.add_argument("--tasks", nargs="+", default=["swap_v1"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--steps", type=int, default=100_000, help="number of team decisions")
    parser.add_argument("--envs", type=int, default=8, help="number of teams in the batch")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarl"))
    given = parser.parse_args(arguments)
    Benchmark(
        algorithm_configs=[algorithm_config_registry[n].get_from_yaml() for n in given.algorithms],
        tasks=[SwarmClass(task, dict(OPTIONS)) for task in given.tasks],
        seeds=set(given.seeds),
        experiment_config=experiment_config(given.steps, given.envs, given.out),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
    ).run_sequential()
    found = returns_of(given.out)
    for (task, algorithm), returns in found.items():
        spread = f"{min(returns):.2f} to {max(returns):.2f}"
        print(f"{task} {algorithm}: return {np.mean(returns):.2f} ({spread})")
    return found


if __name__ == "__main__":
    main()
