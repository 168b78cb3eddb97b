"""Tune the scripted agents that avoid each other, on seeds that no benchmark flies.

    python -m examples.tune_agents --agent roundabout --trials 60 --out tune.jsonl

Each trial changes some numbers of the best candidate so far and flies it through random and
circular swaps of 4 to 32 drones, every candidate on the same seeds; the better one stays. A trial
is a line of the file. Killed, the same command resumes, with the same result. What is found is
printed; to use it in the shipped agent, write it into `swarm_envs.agents.avoiding.TUNED`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs import make
from swarm_envs.agents.avoiding import TUNED, Avoidance
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.protocol import AT_ONCE, fly_batch
from swarm_envs.arguments import Count, Seed
from swarm_envs.envs.core import SwarmCore

CASES = (("random", 4), ("random", 8), ("random", 16), ("random", 32), ("circle", 4),
         ("circle", 8), ("circle", 12), ("circle", 16))  # fmt: skip
"""Layout and number of drones of what a candidate flies."""
_SPREAD = 0.2
"""Standard deviation of the logarithm of what a number is multiplied by."""
_CLOCK_S = 12.0
_OF_TIME, _OF_NEAR_MISSES = 0.02, 0.2
"""What a second and a share of near misses cost, as shares of success."""


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """Tune an agent's numbers by trying others near the best that is known."""

    agent: str
    """one of `fast-line`, `orca`, `roundabout`"""
    out: Path
    """file of the trials, a line of JSON each"""
    trials: Count = 60
    """candidates, the shipped one first"""
    episodes: Count = 64
    """of each case: random and circular swaps of 4 to 32 drones"""
    seed: Seed = 515
    """of the episodes and the candidates; the benchmark's is another"""


def value_of(candidate: Avoidance, seeds: Sequence[int], cases: Sequence[tuple[str, int]]) -> float:
    """Mean over cases: success, less near misses and the time that successes take."""
    return float(np.mean([_value(candidate, seeds, *case) for case in cases]))


def _value(candidate: Avoidance, seeds: Sequence[int], layout: str, drones: int) -> float:
    agent = candidate.agent()
    setting = {"layout": layout, "num_drones": drones, "physics": "batch", "horizon_s": _CLOCK_S}
    env = make("swap_v1", **{**setting, **agent.requires})
    env.reset(seed=seeds[0])
    try:
        agent.reset(env, seeds[0])
    except ValueError:  # it refuses, so it has none
        return -_OF_TIME * _CLOCK_S
    core = SwarmCore(env.core.task, env.core.config, min(AT_ONCE, len(seeds)))
    flown = fly_batch(core, agent.act_batch, seeds)
    env.close()
    won = [m["time_to_goal_s"] for m in flown if m["success"]]
    near = sum(m["near_misses"] > 0 for m in flown)
    took = float(np.mean(won)) if won else _CLOCK_S
    return (len(won) - _OF_NEAR_MISSES * near) / len(flown) - _OF_TIME * took


def numbers_of(candidate: Avoidance) -> dict[str, dict[str, float]]:
    """All numbers of a candidate by part and name; switches and counts are left alone."""
    parts = {name: getattr(candidate, name) for name in ("cruise", "safety", "roundabout")}
    return {
        name: {k: v for k, v in dataclasses.asdict(part).items() if isinstance(v, float)}
        for name, part in parts.items()
        if part is not None
    }


def with_numbers(candidate: Avoidance, numbers: Mapping[str, Mapping[str, float]]) -> Avoidance:
    """A candidate with other numbers.

    Raises:
        ValueError: a number is out of its range.
    """
    changed: dict[str, Any] = {
        name: dataclasses.replace(getattr(candidate, name), **values)
        for name, values in numbers.items()
    }
    return dataclasses.replace(candidate, **changed)


def neighbor_of(candidate: Avoidance, rng: np.random.Generator) -> Avoidance:
    """A candidate some of whose numbers are others."""
    while True:
        numbers = {
            name: {
                k: float(f"{v * np.exp(_SPREAD * rng.normal()):.3g}") if rng.random() < 0.4 else v
                for k, v in values.items()
            }
            for name, values in numbers_of(candidate).items()
        }
        try:
            return with_numbers(candidate, numbers)
        except ValueError:
            continue  # out of range: draw again


def tune_agent(
    options: TuneOptions, cases: Sequence[tuple[str, int]] = CASES
) -> tuple[Avoidance, float]:
    """Try candidates and give the best one, with its value; lines of the file are not flown again.

    Raises:
        KeyError: no such agent is tuned.
        ValueError: the file holds what no run of this function wrote.
    """
    best, highest = TUNED[options.agent], -np.inf
    seeds = frozen_seeds(options.seed, options.episodes)
    about = {"agent": options.agent, "episodes": options.episodes, "seed": options.seed}
    known = _known(options.out)
    for k in tqdm(range(options.trials), desc=options.agent, unit="trial"):
        rng = np.random.default_rng([options.seed, k])
        candidate = neighbor_of(best, rng) if k else best
        trial = {**about, "trial": k, "cases": [list(c) for c in cases]}
        trial["numbers"] = numbers_of(candidate)
        if k < len(known):
            if {name: known[k].get(name) for name in trial} != trial:
                raise ValueError(f"{str(options.out)!r} is of another tuning; name another file")
            value = known[k]["value"]
        else:
            value = value_of(candidate, seeds, cases)
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps({**trial, "value": value}) + "\n")
        if value > highest:
            best, highest = candidate, value
    return best, highest


def _known(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a file; what was being written when a run was killed is cut off."""
    if not path.is_file():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return [json.loads(line) for line in whole.splitlines()]


if __name__ == "__main__":
    found, worth = tune_agent(tyro.cli(TuneOptions))
    sys.stdout.write(f"{worth:.4f} {json.dumps(numbers_of(found))}\n")
