"""Fly a task for an hour with random actions: `python -m tests.robustness.soak --task swap`.

It asserts that resident memory stays flat, that the two engines fly the same flight until
something touches, that no Bullet client is left behind by `close()` or by an exception, that no
number is NaN, and that episodes late in the run are drawn like early ones. Exit code 1 if not.
"""

from __future__ import annotations

import gc
import itertools
import os
import resource
import sys
import time
from collections import defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs.files import write_json
from swarm_envs.physics.bullet import import_bullet
from tests.robustness.lives import AGENTS, QUANTITIES, ROTA, Life, fail, fly_agent, live

DRIFT_M = 1e-9
"""Largest difference between the engines before a contact, m or m/s."""
GROWTH_MIB = 6.0
"""Growth of resident memory over what was measured after the warm-up, fitted by a line, MiB."""
LEAST_P = 1e-4
"""Stationarity is given up below this probability of what was seen, after Bonferroni."""
ENGINES = {"bullet": {"bullet": 3, "batch": 3}, "batch": {"batch": 32, "bullet": 1}}
"""Environments of the engine that is soaked, and of its twin."""
CLIENTS = 1024
"""Bullet numbers its clients up to this."""


@dataclass(frozen=True, kw_only=True)
class SoakOptions:
    """Fly a task for a long time with random actions, and see whether anything wears out."""

    task: str = "swap"
    """swap, ring or formation"""
    backend: str = "bullet"
    """bullet or batch; the other flies some of its environments beside it"""
    minutes: float = 60.0
    """how long"""
    steps: int = 200
    """decisions of a life; options change from life to life"""
    seed: int = 0
    """of everything that is drawn"""
    json: Path | None = None
    """write what was measured to this file"""


@dataclass
class Log:
    """What a soak has seen."""

    memory: list[tuple[float, float]] = field(default_factory=list)
    """(hours, MiB resident) after each round of the rota."""
    flights: dict[str, list[tuple[int, np.ndarray]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    """By options: number and sums of the episodes of each life."""
    drift: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """By options: the largest difference between the engines."""
    compared: int = 0
    """Decisions of environments at which the engines were compared."""
    agents: int = 0
    """Episodes of agents that ship."""

    def add(self, name: str, life: Life) -> None:
        """Note a life."""
        self.flights[name].append((life.episodes, life.sums))
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


def soak(options: SoakOptions) -> Log:
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


def trend(flights: dict[str, list[tuple[int, np.ndarray]]]) -> dict[str, float]:
    """Smallest p-value of a change from the first half of the lives to the second, by quantity.

    A life that ends within an episode sees its short ones more often: so do all lives alike.
    """
    from scipy.stats import ttest_ind_from_stats

    found: dict[str, list[float]] = defaultdict(list)
    for lives in flights.values():
        half = len(lives) // 2
        early, late = moments(lives[:half]), moments(lives[half:])
        for k, quantity in enumerate(QUANTITIES):
            one, two = ((mean[k], spread[k], count) for mean, spread, count in (early, late))
            if min(one[2], two[2]) >= 20 and one[1] + two[1] > 1e-9:
                test = ttest_ind_from_stats(*one, *two, equal_var=False)
                found[quantity].append(float(test.pvalue))
    return {name: min(1.0, min(values) * len(values)) for name, values in found.items()}


def moments(lives: list[tuple[int, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, int]:
    """Mean, standard deviation and number of all episodes of some lives."""
    count = sum(number for number, _ in lives)
    total, squares = sum((sums for _, sums in lives), np.zeros((2, len(QUANTITIES))))
    mean = total / max(count, 1)
    variance = (squares - total * mean) / max(count - 1, 1)
    return mean, np.sqrt(np.maximum(variance, 0.0)), count


def report(options: SoakOptions, log: Log) -> dict[str, Any]:
    """Everything that was measured, and what was wrong."""
    counted = sum(number for lives in log.flights.values() for number, _ in lives)
    content: dict[str, Any] = {
        **asdict(options),
        "json": None,
        "episodes": counted,
        "agent_episodes": log.agents,
        "lives": sum(map(len, log.flights.values())),
        "decisions_compared": log.compared,
        "drift": dict(log.drift),
        "memory": growth(log.memory),
        "p_stationary": trend(log.flights),
    }
    wrong = [f"drift {d:.2e} with {n}" for n, d in log.drift.items() if d > DRIFT_M]
    if content["memory"]["growth_mib"] > GROWTH_MIB:
        wrong.append(f"memory grew by {content['memory']['growth_mib']:.1f} MiB")
    low = {n: p for n, p in content["p_stationary"].items() if p < LEAST_P}
    wrong += [
        f"{name} changed between the halves of the run (p = {p:.1e})" for name, p in low.items()
    ]
    return {**content, "wrong": wrong}


def main() -> int:
    """Soak, print, and write what was asked for."""
    options = tyro.cli(SoakOptions)
    found = report(options, soak(options))
    if options.json is not None:
        write_json(options.json, found)
    for name, value in found.items():
        print(f"{name:20} {value}")
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
