"""Tune scripted agents on seeds that no benchmark flies.

    python -m examples.tune_agents --agent roundabout --trials 60 --out tune.jsonl
    python -m examples.tune_agents --agent downwash-aware --task air-sprint-8-v3 --out sprint.jsonl

Each trial changes some numbers of the best candidate so far and flies it, every candidate on the
same seeds; the better one stays. `fast-line`, `orca` and `roundabout` fly random and circular swaps
of 4 to 32 drones, the others the benchmark's family *air*. A trial is a line of the file. Killed,
the same command resumes, with the same result. What is found is printed; to use it in the shipped
agent, write it into `TUNED` of `swarm_envs.agents.avoiding`, or of the module `downwash` beside the
tracking agents.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs.agents import avoiding
from swarm_envs.agents.evaluation import AgentRefused, evaluate_agent, frozen_seeds
from swarm_envs.baselines.neural_swarm import downwash
from swarm_envs.errors import check_integer
from swarm_envs.training.scoreboard.tasks import choose_tasks, make_scored

Candidate = avoiding.Avoidance | downwash.DownwashSettings
TUNED: Mapping[str, Candidate] = {**avoiding.TUNED, **downwash.TUNED}
"""What can be tuned, by the agent's name."""


class Case(NamedTuple):
    """What a candidate flies."""

    name: str
    """Of the case."""
    environment: str
    """First argument of `swarm_envs.make`."""
    setting: Mapping[str, Any]
    """Options of the environment."""


_CLOCK_S = 12.0
_SWAPS = (("random", 4), ("random", 8), ("random", 16), ("random", 32), ("circle", 4),
          ("circle", 8), ("circle", 12), ("circle", 16))  # fmt: skip
_SPREAD = 0.2
"""Standard deviation of the logarithm of what a number is multiplied by."""
_OF_TIME, _OF_NEAR_MISSES = 0.02, 0.2
"""What a second and a share of near misses cost, as shares of success."""


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """Tune an agent's numbers by trying others near the best that is known."""

    agent: str
    """one of `fast-line`, `orca`, `roundabout`, `pid`, `pid+adaptive`, `downwash-aware`,
    `heavy-on-top`"""
    out: Path
    """file of the trials, a line of JSON each"""
    task: list[str] = field(default_factory=list)
    """tasks of the benchmark, ids or quoted patterns, to be flown in place of the usual cases"""
    trials: int = 60
    """candidates, the shipped one first"""
    episodes: int = 64
    """of each case"""
    seed: int = 515
    """of the episodes and the candidates; the benchmark's is another"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_integer("--trials", self.trials, at_least=1)
        check_integer("--episodes", self.episodes, at_least=1)
        check_integer("--seed", self.seed, at_least=0)


def cases_of(agent: str, tasks: Sequence[str] = ()) -> list[Case]:
    """What an agent is tuned on: tasks of the benchmark, or swaps of 4 to 32 drones."""
    if agent in downwash.TUNED or tasks:
        usual = ["air-stack-*"] if agent == "heavy-on-top" else ["air-sprint-*", "air-delivery-*"]
        chosen = choose_tasks(tasks or usual)
        return [Case(task.id, task.environment, task.setting) for task in chosen]
    common = {"physics": "batch", "horizon_s": _CLOCK_S}
    return [
        Case(f"{layout}-{n}", "swap_v1", {"layout": layout, "num_drones": n, **common})
        for layout, n in _SWAPS
    ]


def value_of(candidate: Candidate, seeds: Sequence[int], cases: Sequence[Case]) -> float:
    """Mean over cases: success, less near misses and the time that successes take."""
    return float(np.mean([_value(candidate, seeds, case) for case in cases]))


def _value(candidate: Candidate, seeds: Sequence[int], case: Case) -> float:
    agent = candidate.agent()
    env = make_scored(case.environment, {**case.setting, **agent.requires})
    try:
        flown = [each["metrics"] for each in evaluate_agent(env, agent, seeds, timed=0)]
    except AgentRefused:
        return -_OF_TIME * env.view.horizon_s
    finally:
        env.close()
    won = [m["time_to_goal_s"] or m["length_s"] for m in flown if m["success"]]
    near = sum(m["near_misses"] > 0 for m in flown)
    took = float(np.mean(won)) if won else env.view.horizon_s
    return (len(won) - _OF_NEAR_MISSES * near) / len(flown) - _OF_TIME * took


def numbers_of(candidate: Any) -> dict[str, Any]:
    """All numbers of a candidate by name, and by part; switches and counts are left alone."""
    values = {f.name: getattr(candidate, f.name) for f in dataclasses.fields(candidate)}
    return {
        name: numbers_of(value) if dataclasses.is_dataclass(value) else value
        for name, value in values.items()
        if dataclasses.is_dataclass(value) or isinstance(value, float)
    }


def with_numbers(candidate: Any, numbers: Mapping[str, Any]) -> Any:
    """A candidate with other numbers.

    Raises:
        ValueError: a number is out of its range.
    """
    changed = {
        name: with_numbers(getattr(candidate, name), value) if isinstance(value, Mapping) else value
        for name, value in numbers.items()
    }
    return dataclasses.replace(candidate, **changed)


def neighbor_of(candidate: Candidate, rng: np.random.Generator) -> Candidate:
    """A candidate some of whose numbers are others."""

    def changed(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: changed(part) for name, part in value.items()}
        return (
            float(f"{value * np.exp(_SPREAD * rng.normal()):.3g}") if rng.random() < 0.4 else value
        )

    while True:
        try:
            other: Candidate = with_numbers(candidate, changed(numbers_of(candidate)))
            return other
        except ValueError:
            continue  # out of range: draw again


def tune_agent(options: TuneOptions) -> tuple[Candidate, float]:
    """Try candidates and give the best one, with its value; lines of the file are not flown again.

    Raises:
        KeyError: no such agent is tuned.
        ValueError: the file holds what no run of this function wrote.
    """
    best, highest = TUNED[options.agent], -np.inf
    seeds, cases = (
        frozen_seeds(options.seed, options.episodes),
        cases_of(options.agent, options.task),
    )
    about = {"agent": options.agent, "episodes": options.episodes, "seed": options.seed}
    known = _known(options.out)
    for k in tqdm(range(options.trials), desc=options.agent, unit="trial"):
        rng = np.random.default_rng([options.seed, k])
        candidate = neighbor_of(best, rng) if k else best
        trial = {**about, "trial": k, "cases": [case.name for case in cases]}
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
