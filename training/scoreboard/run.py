"""The loop of the benchmark over every agent and task, which resumes after an interruption."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents import Agent, load
from swarm_envs.agents.evaluation import TIMED, EpisodeFile, frozen_seeds, source_digest
from swarm_envs.agents.protocol import check_options_agree, flies_batches
from swarm_envs.baselines.neural_swarm.flights import versions
from swarm_envs.training.flights import Flight, fly_flights
from swarm_envs.training.scale_out import ScaleOptions
from swarm_envs.training.scoreboard.agents import episodes_of
from swarm_envs.training.scoreboard.metrics import fastest_times, row_of
from swarm_envs.training.scoreboard.results import FILE, Cell, Results, need_parquet
from swarm_envs.training.scoreboard.tasks import SEED, ScoredTask, digest, make_scored

__all__ = ["fly_benchmark"]

PARTS = "parts"  # Folder of stored episodes in a benchmark's folder
_QUICK = 16  # Divisor of the number of episodes with --quick


@dataclass(frozen=True)
class _Loaded:
    """A requested agent."""

    name: str
    agent: Agent | None  # None if it cannot be loaded
    digest: str
    error: str = ""  # The reason that it cannot be loaded


@dataclass(frozen=True)
class _Flying:
    """A cell that is evaluated, with the file of its episodes."""

    cell: Cell
    task: ScoredTask
    flight: Flight
    file: EpisodeFile


def fly_benchmark(
    tasks: Sequence[ScoredTask],
    agents: Sequence[str],
    out: Path,
    scale: ScaleOptions,
    *,
    seed: int = SEED,
    episodes: int | None = None,
    quick: bool = False,
) -> Results:
    """Simulate the episodes that are missing in a folder, and write `episodes.parquet`.

    Episodes are stored in `parts/`, in a file for each agent, task, their digests, and the version
    of the package. The folder must be claimed (`swarm_envs.files.claimed`).

    Args:
        tasks: rows of the table of tasks.
        agents: names for `swarm_envs.agents.load`.
        out: the folder.
        scale: the workers; except for times of decisions, the results do not depend on them.
        seed: the seed from which those of the episodes are drawn; scores of different seeds are not
            comparable.
        episodes: the number of episodes of every agent on every task; None for that of the tables.
        quick: simulate a sixteenth of the episodes, and at least one.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: pyarrow, or Ray if it is requested, is not installed.
        OSError: a file cannot be written.
        ValueError: a file of episodes is damaged.
    """
    need_parquet()
    loaded = [_load(name) for name in agents]
    cells, flying = [], []
    pairs = [(task, agent) for task in tasks for agent in loaded]
    for task, agent in tqdm(pairs, desc="cells", unit="cell", mininterval=0.5):
        count = episodes if episodes is not None else episodes_of(agent.name, task)
        count = max(1, count // _QUICK) if quick else count
        cell = Cell(task.id, agent.name, failure=agent.error)
        cells.append(cell)
        if agent.agent is None:
            continue
        try:
            flight = _flight(task, agent.name, agent.agent, frozen_seeds(seed, count))
        except (ValueError, TypeError, ImportError) as error:
            cell.mismatch = str(error)
            continue
        flying.append(_Flying(cell, task, flight, _file(out / PARTS, task, flight)))
    _fly(flying, scale)
    results = Results(_about(tasks, loaded, seed), cells)
    results.write(out / FILE)
    return results


def _load(name: str) -> _Loaded:
    try:
        agent = load(name)
        return _Loaded(name, agent, source_digest(agent, name))
    except (Exception, SystemExit) as error:
        return _Loaded(name, None, "", f"cannot be loaded: {type(error).__name__}: {error}")


def _flight(task: ScoredTask, name: str, agent: Agent, seeds: Sequence[int]) -> Flight:
    """Return the episodes of an agent on a task; raise an exception if it does not support it."""
    check_options_agree(agent, task.setting)
    with closing(make_scored(task.environment, {**task.setting, **agent.requires})) as env:
        batched = flies_batches(env, agent)
    return Flight(
        agent=name,
        digest=source_digest(agent, name),
        task=task.environment,
        setting=task.setting,
        seeds=seeds,
        timed=TIMED,
        batched=batched,
        refusals=True,
    )


def _file(parts: Path, task: ScoredTask, flight: Flight) -> EpisodeFile:
    depends = {"task": digest(task), "agent": flight.digest, "version": __version__}
    return EpisodeFile(parts, f"{task.id} {flight.agent}", {**depends, "name": flight.agent})


def _fly(flying: Sequence[_Flying], scale: ScaleOptions) -> None:
    """Simulate the episodes, and fill the cells."""
    flown = fly_flights([(each.flight, each.file) for each in flying], scale)
    fastest: dict[str, dict[int, float]] = {}
    traces = {}  # of agents in users' files
    for each, (episodes, error, trace) in zip(flying, flown, strict=True):
        cell, task = each.cell, each.task
        cell.failure = error
        if error:
            traces[cell.agent] = trace
            continue
        times = fastest.setdefault(task.id, {})
        if task.score == "time":
            times |= fastest_times(task, [k for k in each.flight.seeds if k not in times])
        cell.rows = [
            row_of(task, cell.agent, k, episode, times.get(episode["seed"]))
            for k, episode in enumerate(episodes)
        ]
    sys.stderr.write("".join(traces.values()))


def _about(tasks: Sequence[ScoredTask], loaded: Sequence[_Loaded], seed: int) -> dict[str, Any]:
    """Return the metadata of results, ready for JSON."""
    found = versions()
    for package in ("torch", "pyarrow", "ray"):
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return {
        "command": shlex.join(["swarm-envs", *sys.argv[1:]]),
        "seed": seed,
        "versions": found,
        "machine": {"cpu": _processor(), "cores": os.cpu_count(), "system": platform.platform()},
        "tasks": {task.id: {"family": task.family, "digest": digest(task)} for task in tasks},
        "agents": {
            each.name: {
                "digest": each.digest,
                "privileged": each.agent is not None and each.agent.privileged,
            }
            for each in loaded
        },
    }


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
