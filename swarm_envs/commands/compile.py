"""`swarm-envs compile`: compile the kernels before the first episode."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

from swarm_envs import TASKS, make
from swarm_envs.agents import fly_episode, load
from swarm_envs.agents.recommendation import benchmark_rows
from swarm_envs.commands.fly import find_task
from swarm_envs.physics import bullet_available

WORLDS = ("ideal", "hall")  # They use different kernels


@dataclass(frozen=True, kw_only=True)
class CompileOptions:
    """Compile all kernels into the cache, so that the first episode starts without a delay.

    The command simulates two steps of every task, in both worlds and with each installed physics
    engine, and 0.1 s of every included agent in one of its tasks.
    """

    progress: bool = True
    """Show a progress bar."""


def run_compile(options: CompileOptions) -> None:
    """Simulate every task for two decisions, and every agent for 0.1 s."""
    engines = ("batch", "bullet") if bullet_available() else ("batch",)
    runs = [*itertools.product(TASKS, WORLDS, engines)]
    agents = _flown_by_agents()
    with tqdm(total=len(runs) + len(agents), unit="setting", disable=not options.progress) as bar:
        for task, world, engine in runs:
            with closing(make(task, world=world, physics=engine)) as env:
                env.reset(seed=0)
                for _ in range(2):
                    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            bar.update()
        for name, row in agents.items():
            agent = load(name)
            given = {"num_drones": row["drones"], "physics": "batch", "horizon_s": 0.1}
            given |= {} if row["layout"] is None else {"layout": row["layout"]}
            with closing(make(find_task(row["task"]), **{**given, **agent.requires})) as env:
                fly_episode(env, agent, 0)
            bar.update()
    print(f"compiled the kernels of {len(TASKS)} tasks and {len(agents)} agents")


def _flown_by_agents() -> dict[str, Mapping[str, Any]]:
    """Return the smallest benchmark task of each included agent, by the agent's name."""
    rows = sorted(benchmark_rows(), key=lambda row: int(row["drones"]), reverse=True)
    return {name: row for row in rows for name in row["agents"]}
