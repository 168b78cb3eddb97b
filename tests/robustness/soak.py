"""Fly a task for an hour with random actions: `python -m tests.robustness.soak --task swap`.

It asserts that resident memory stays flat, that the two engines fly the same flight until
something touches, that no Bullet client is left behind by `close()` or by an exception, and that no
number is NaN. Exit code 1 if not.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import resource
import sys
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.files import write_json
from swarm_envs.physics.bullet import import_bullet
from tests.robustness.lives import AGENTS, ROTA, Life, fail, fly_agent, live

DRIFT_M = 1e-9
"""Largest difference between the engines before a contact, m or m/s."""
GROWTH_MIB = 6.0
"""Growth of resident memory over what was measured after the warm-up, fitted by a line, MiB."""
ENGINES = {"bullet": {"bullet": 3, "batch": 3}, "batch": {"batch": 32, "bullet": 1}}
"""Environments of the engine that is soaked, and of its twin."""
CLIENTS = 1024
"""Bullet numbers its clients up to this."""


@dataclass
class Log:
    """What a soak has seen."""

    memory: list[tuple[float, float]] = field(default_factory=list)
    """(hours, MiB resident) after each round of the rota."""
    lives: int = 0
    """How many."""
    episodes: int = 0
    """How many ended."""
    drift: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """By options: the largest difference between the engines."""
    compared: int = 0
    """Decisions of environments at which the engines were compared."""
    agents: int = 0
    """Episodes of agents that ship."""

    def add(self, name: str, life: Life) -> None:
        """Note a life."""
        self.lives, self.episodes = self.lives + 1, self.episodes + life.episodes
        self.drift[name] = max(self.drift[name], life.drift)
        self.compared += life.compared


def resident_mib() -> float:
    """Memory that the process holds now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def open_clients() -> int:
    """Number of Bullet clients that are connected."""
    bullet = import_bullet()
    info = (bullet.getConnectionInfo(client) for client in range(CLIENTS))
    return sum(bool(entry["isConnected"]) for entry in info)


def soak(options: argparse.Namespace) -> Log:
    """Live, fly and fail until the time is up; whole rounds of the rota."""
    log, begun, before = Log(), time.monotonic(), open_clients()
    hours, agents = options.minutes / 60.0, itertools.cycle(AGENTS[options.task])
    task = f"{options.task}_v0"
    words = np.random.default_rng(options.seed)
    with tqdm(total=round(3600 * hours), unit="s", mininterval=1.0) as bar:
        while (passed := (time.monotonic() - begun) / 3600) < hours or len(log.memory) < 4:
            for entry in ROTA:
                seed = int(words.integers(2**31))
                life = live(task, entry, ENGINES[options.backend], seed, options.steps)
                log.add(" ".join([entry["action"], *sorted(set(entry) - {"action"})]), life)
            fly_agent(task, next(agents), options.backend, int(words.integers(2**31)))
            log.agents += 1
            fail(task, options.backend)
            log.memory.append((passed, resident_mib()))  # collects what `fail` left behind
            left = open_clients() - before
            assert left == 0, f"{left} Bullet clients were left connected"
            bar.update(round(3600 * min(passed, hours)) - bar.n)
            bar.set_postfix_str(f"{log.memory[-1][1]:.1f} MiB, drift {max(log.drift.values()):.1e}")
    return log


def growth(memory: list[tuple[float, float]]) -> dict[str, float]:
    """The line through resident memory after the first third, and its growth over that time."""
    hours, mib = np.array(memory[len(memory) // 3 :]).T
    slope = float(np.polyfit(hours, mib, 1)[0])
    return {
        "first_mib": memory[0][1],
        "after_warm_up_mib": float(mib[0]),
        "last_mib": float(mib[-1]),
        "slope_mib_per_hour": slope,
        "growth_mib": slope * float(hours[-1] - hours[0]),
    }


def report(options: argparse.Namespace, log: Log) -> dict[str, Any]:
    """Everything that was measured, and what was wrong."""
    memory = growth(log.memory)
    wrong = [f"drift {d:.2e} with {n}" for n, d in log.drift.items() if d > DRIFT_M]
    if memory["growth_mib"] > GROWTH_MIB:
        wrong.append(f"memory grew by {memory['growth_mib']:.1f} MiB")
    return {
        **{name: value for name, value in vars(options).items() if name != "json"},
        "episodes": log.episodes,
        "agent_episodes": log.agents,
        "lives": log.lives,
        "decisions_compared": log.compared,
        "drift": dict(log.drift),
        "memory": memory,
        "wrong": wrong,
    }


def main() -> int:
    """Soak, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--task", default="swap", choices=AGENTS)
    parser.add_argument("--backend", default="bullet", choices=ENGINES, help="the other is beside")
    parser.add_argument("--minutes", type=float, default=60.0, help="how long")
    parser.add_argument("--steps", type=int, default=200, help="decisions of a life")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is drawn")
    parser.add_argument("--json", type=Path, help="write what was measured to this file")
    options = parser.parse_args()
    found = report(options, soak(options))
    if options.json is not None:
        write_json(options.json, found)
    for name, value in found.items():
        print(f"{name:20} {value}")
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
