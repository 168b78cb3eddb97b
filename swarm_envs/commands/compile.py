"""`swarm-envs compile`: the kernels, ahead of the first flight."""

from __future__ import annotations

import itertools
from contextlib import closing
from dataclasses import dataclass

from tqdm import tqdm

from swarm_envs import TASKS, make
from swarm_envs.physics import bullet_available

WORLDS = ("ideal", "hall")  # Each has kernels of its own


@dataclass(frozen=True, kw_only=True)
class CompileOptions:
    """Compile what flights need into the cache, so that the first flight begins at once.

    Every task flies for a moment, in both worlds and on each physics engine that is installed.
    """

    progress: bool = True
    """show a progress bar"""


def run_compile(options: CompileOptions) -> None:
    """Fly every task for two decisions."""
    engines = ("batch", "bullet") if bullet_available() else ("batch",)
    runs = [*itertools.product(TASKS, WORLDS, engines)]
    for task, world, engine in tqdm(runs, unit="setting", disable=not options.progress):
        with closing(make(task, world=world, physics=engine)) as env:
            env.reset(seed=0)
            for _ in range(2):
                env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    print(f"compiled the kernels of {len(TASKS)} tasks")
