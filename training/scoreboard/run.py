"""The loop of the benchmark: every agent on every task, resumed where it was interrupted."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents import Agent, load
from swarm_envs.agents.evaluation import TIMED, Episode, frozen_seeds, source_digest
from swarm_envs.agents.protocol import check_options_agree, flies_batches
from swarm_envs.baselines.neural_swarm.flights import versions
from swarm_envs.training.flights import Flight, fly_flights
from swarm_envs.training.scale_out import ScaleOptions
from swarm_envs.training.scoreboard.agents import episodes_of, seconds_of
from swarm_envs.training.scoreboard.metrics import EpisodeRow, fastest_times, row_of
from swarm_envs.training.scoreboard.results import (
    FILE,
    Cell,
    Results,
    need_parquet,
    read_rows,
    write_rows,
)
from swarm_envs.training.scoreboard.tasks import SEED, ScoredTask, digest, make_scored

__all__ = ["fly_benchmark"]

PARTS = "parts"  # Where finished cells are kept, in a benchmark's folder
_QUICK = 16  # A quick benchmark flies so many times fewer episodes


@dataclass(frozen=True)
class _Loaded:
    """An agent that was asked for."""

    name: str
    agent: Agent | None  # None if it could not be made
    digest: str
    error: str = ""  # Why it could not be made


@dataclass
class _Flying:
    """A cell that is flown now."""

    cell: Cell
    task: ScoredTask
    flight: Flight
    part: Path
    about: Mapping[str, Any]
    episodes: dict[int, Episode] = field(default_factory=dict)
    """By seed."""


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
    """Fly what a folder does not have yet, and write `episodes.parquet`.

    A finished cell (an agent on a task) is kept as a file in `parts/`. A later call uses it if the
    digests of agent and task, the version of the package and the seeds are the same. The folder
    must be claimed (`swarm_envs.files.claimed`).

    Args:
        tasks: rows of the table of tasks.
        agents: names as of `swarm_envs.agents.load`.
        out: the folder.
        scale: the workers; except for times of decisions, the results do not depend on them.
        seed: from which the seeds of the episodes are drawn; scores of other seeds do not compare.
        episodes: of every agent on every task; None for those of the tables.
        quick: fly a sixteenth of those, and at least one.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: pyarrow or Ray is needed and not installed.
        OSError: something cannot be written.
        ValueError: the folder has a cell of another agent, task, version or seed.
    """
    need_parquet()
    loaded = [_load(name) for name in agents]
    cells, flying = [], []
    pairs = [(task, agent) for task in tasks for agent in loaded]
    for task, agent in tqdm(pairs, desc="cells", unit="cell", mininterval=0.5):
        count = episodes if episodes is not None else episodes_of(agent.name, task)
        count = max(1, count // _QUICK) if quick else count
        cell, missing = _prepare(task, agent, seed, count, out / PARTS)
        cells.append(cell)
        flying += missing
    _fly(flying, scale)
    results = Results(_about(tasks, loaded, seed), cells)
    results.write(out / FILE)
    return results


def _load(name: str) -> _Loaded:
    try:
        agent = load(name)
        return _Loaded(name, agent, source_digest(agent))
    except (Exception, SystemExit) as error:
        return _Loaded(name, None, "", f"cannot be made: {type(error).__name__}: {error}")


def _prepare(
    task: ScoredTask, loaded: _Loaded, seed: int, count: int, parts: Path
) -> tuple[Cell, list[_Flying]]:
    """Return a cell, read from its part if there is one, and what is to be flown of it, if any."""
    cell, agent = Cell(task.id, loaded.name, failure=loaded.error), loaded.agent
    if agent is None:
        return cell, []
    about = {
        "task": digest(task),
        "agent": loaded.digest,
        "version": __version__,
        "seed": seed,
        "episodes": count,
    }
    short = re.sub(r"[^A-Za-z0-9]+", "-", loaded.name).strip("-")[-40:]
    key = hashlib.sha256(loaded.name.encode()).hexdigest()[:8]
    part = parts / f"{task.id}--{short}-{key}.parquet"
    if part.is_file():
        cell.rows = _read_part(part, about)
        return cell, []
    try:
        check_options_agree(agent, task.setting)
        env = make_scored(task.environment, {**task.setting, **agent.requires})
    except (ValueError, TypeError, ImportError) as error:
        cell.mismatch = str(error)
        return cell, []
    batched = flies_batches(env, agent)
    env.close()
    flight = Flight(
        agent=loaded.name,
        digest=loaded.digest,
        task=task.environment,
        setting=task.setting,
        seeds=frozen_seeds(seed, count),
        timed=TIMED,
        batched=batched,
        refusals=True,
    )
    return cell, [_Flying(cell, task, flight, part, about)]


def _read_part(part: Path, about: Mapping[str, Any]) -> list[EpisodeRow]:
    rows, found = read_rows(part)
    if found != about:
        names = [name for name in about if found.get(name) != about[name]]
        differ = ", ".join(f"{k} was {found.get(k)!r:.20} and is {about[k]!r:.20}" for k in names)
        raise ValueError(
            f"{str(part)!r} is of another benchmark: {differ}; choose another folder by --out, or "
            "delete this file"
        )
    return rows


def _fly(flying: list[_Flying], scale: ScaleOptions) -> None:
    """Fly cells, the most expensive first, and keep each when it is finished."""
    costs = {id(each): seconds_of(each.cell.agent, each.task) for each in flying}
    flying.sort(key=lambda each: -costs[id(each)])
    work = sum(len(each.flight.seeds) * costs[id(each)] for each in flying)
    fastest: dict[str, dict[int, float]] = {}
    form = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
    with tqdm(total=work, bar_format=form, mininterval=0.5, disable=not flying) as bar:

        def keep(k: int, episodes: list[Episode]) -> None:
            each = flying[k]
            each.episodes |= {episode["seed"]: episode for episode in episodes}
            bar.set_description_str(f"{each.task.id} {each.cell.agent[-24:]}", refresh=False)
            bar.update(len(episodes) * costs[id(each)])
            if len(each.episodes) == len(each.flight.seeds):
                each.cell.rows = _rows(each, fastest.setdefault(each.task.id, {}))
                write_rows(each.part, each.cell.rows, each.about)

        failed = fly_flights([each.flight for each in flying], scale, keep)
    traces = {}
    for k, flown in failed.items():
        flying[k].cell.failure = flown.error
        if ":" in flying[k].cell.agent:  # whoever wrote the file needs to see where it failed
            traces[flying[k].cell.agent] = flown.trace
    sys.stderr.write("".join(traces.values()))


def _rows(each: _Flying, fastest: dict[int, float]) -> list[EpisodeRow]:
    """Return a cell's rows; times by seed that are missing in `fastest` are added to it."""
    seeds = each.flight.seeds
    if each.task.score == "time":
        fastest |= fastest_times(each.task, [seed for seed in seeds if seed not in fastest])
    return [
        row_of(each.task, each.cell.agent, k, each.episodes[seed], fastest.get(seed))
        for k, seed in enumerate(seeds)
    ]


def _about(tasks: Sequence[ScoredTask], loaded: Sequence[_Loaded], seed: int) -> dict[str, Any]:
    """Return how results were made, ready for JSON."""
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
