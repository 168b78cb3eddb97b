"""Results that anyone sends: a check of a `scores.json`, and one page of several.

A file says what it flew (digests of tasks and agents), and every episode's success and score. What
follows from these is computed again, and a few episodes of each agent that ships are flown again;
which ones, follows from the content of the file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds, source_digest
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.training.scoreboard.board import FILE, Board
from swarm_envs.training.scoreboard.metrics import METRICS, fastest_times, row_of, value_of_metric
from swarm_envs.training.scoreboard.roster import episodes_of
from swarm_envs.training.scoreboard.standings import RESULTS, Reached, families_of
from swarm_envs.training.scoreboard.tasks import SEED, TASKS, digest, make_scored

__all__ = ["join_results", "verify_results"]

Content = dict[str, Any]  # What a `scores.json` holds
_CLOSE = 1e-6  # By how much a number may differ that is computed again
_AGAIN = 2  # Episodes of every agent that ships and every task that are flown again


def read_results(path: Path) -> Content:
    """A results file, or that of a benchmark's folder."""
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise FileNotFoundError(f"there is no results file {str(file)!r}")
    try:
        # int refuses NaN and Infinity, which no result is
        content: Content = json.loads(file.read_text(encoding="utf-8"), parse_constant=int)
        Board(content)
        _reached_in(content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{str(file)!r} is no results file: {error!r}") from error
    return content


def verify_results(path: Path) -> Iterator[str]:
    """What is wrong with a results file, a sentence each; nothing, if it can be trusted.

    The path is of the file, or of the folder that holds it.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no results file.
    """
    content = read_results(path)
    if content["manifest"].get("seed") != SEED:
        yield f"its seed is {content['manifest'].get('seed')}, but the benchmark's is {SEED}"
        return
    for task in content["tasks"]:
        known = TASKS.get(task["id"])
        if known is None or task.get("digest") != digest(known):
            yield f"{task['id']} is another task here; use the same version of swarm-envs"
            return
    agents = {agent["name"]: agent for agent in content["agents"]}
    rng = np.random.default_rng(list(hashlib.sha256(json.dumps(content).encode()).digest()))
    for cell in tqdm(content["cells"], desc="verify", unit="cell"):
        if cell["status"] == "flown":
            where = f"{cell['agent']} on {cell['task']}: "
            wrong = [*_inside(cell)] or [*_flown_again(cell, agents[cell["agent"]], rng)]
            yield from (where + each for each in wrong)
    standings, _ = families_of(_reached_in(content))
    if not _same(standings, content["aggregates"]):
        yield "the leaderboards do not follow from the episodes"


def _reached_in(content: Content) -> list[Reached]:
    found = []
    for cell in content["cells"]:
        flown = cell["status"] == "flown"
        scores = [row["score"] for row in _rows(cell["results"])] if flown else []
        found.append(Reached(TASKS[cell["task"]], cell["agent"], cell["status"], scores))
    return found


def _rows(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The episodes of a cell; ValueError if columns are unlike, or hold what cannot be."""
    columns = (results[name] for name in RESULTS)
    rows = [dict(zip(RESULTS, row, strict=True)) for row in zip(*columns, strict=True)]
    for row in rows:
        timed = type(row["makespan_s"]) in (float, type(None))
        if type(row["success"]) is not bool or type(row["score"]) is not float or not timed:
            raise ValueError(f"an episode is {row}, but must have success, score and time")
    return rows


def _inside(cell: Mapping[str, Any]) -> Iterator[str]:
    """Where a cell contradicts itself, the tables, or what can be reached at all."""
    task, rows = TASKS[cell["task"]], _rows(cell["results"])
    partly = task.score in ("shapes", "own")  # where an episode may score without success
    wanted = episodes_of(cell["agent"], task)
    if len(rows) < wanted:
        yield f"{len(rows)} episodes, but the benchmark flies {wanted}"
    fastest = fastest_times(task, frozen_seeds(SEED, len(rows))) if task.score == "time" else {}
    best_times: list[Any] = [*fastest.values()] or [None] * len(rows)
    for k, (row, best) in enumerate(zip(rows, best_times, strict=True)):
        if not 0.0 <= row["score"] <= 1.0 or (row["score"] > 0.0) > (row["success"] or partly):
            yield f"episode {k} cannot score {row['score']}"
        timed = best is not None and row["success"]
        told = best / max(best, row["makespan_s"] or 0.0) if timed else row["score"]
        if abs(row["score"] - told) > _CLOSE:
            yield f"episode {k} scores {row['score']}, but its time gives {told}"
    for metric in METRICS[:2]:  # success and score
        if not _same(value_of_metric(metric, rows, []), cell["values"][metric.name]):
            yield f"its {metric.name} does not follow from its episodes"


def _flown_again(
    cell: Mapping[str, Any], about: Mapping[str, Any], rng: np.random.Generator
) -> Iterator[str]:
    """Episodes of an agent that ships which come out otherwise here."""
    name, task, rows = cell["agent"], TASKS[cell["task"]], _rows(cell["results"])
    if name.removesuffix(FILTER) not in SHIPPED:
        return
    agent = load(name)
    if about.get("digest") != source_digest(agent):
        yield "the agent is another one here; use the same version of swarm-envs"
        return
    env = make_scored(task.environment, {**task.setting, **agent.requires})
    seeds = frozen_seeds(SEED, len(rows))
    chosen = rng.choice(len(rows), min(_AGAIN, len(rows)), replace=False).tolist()
    flown = evaluate_agent(env, agent, [seeds[k] for k in chosen], refusals=True)
    for k, episode in zip(chosen, flown, strict=True):
        best = fastest_times(task, [seeds[k]])[seeds[k]] if task.score == "time" else None
        row = row_of(task, name, k, episode, best)
        if not _same({key: row[key] for key in RESULTS}, rows[k]):
            yield f"episode {k} comes out otherwise: {row['success']}, {row['score']:.4f} here"
    env.close()


def _same(one: Any, other: Any) -> bool:
    """Whether two contents are the same, numbers up to rounding."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, int | float):
        return abs(one - other) <= _CLOSE
    return bool(one == other)


def join_results(paths: Sequence[Path]) -> Content:
    """One results file of several: of what two have of the same agent, the first's.

    Args:
        paths: of the files; another agent of the same name is called by its file too.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: one is no results file, or they flew other tasks by the same id, or other seeds.
    """
    contents = {str(path): read_results(path) for path in paths}
    tasks: dict[str, Any] = {}
    agents: dict[str, Any] = {}
    cells: dict[tuple[str, str], Any] = {}
    for source, content in contents.items():
        renamed = {}
        for agent in content["agents"]:
            name, told = agent["name"], agent
            if name in agents and agents[name].get("digest") != agent.get("digest"):
                name = f"{name} ({source})"
                told = {**agent, "name": name, "label": name}
            renamed[agent["name"]] = name
            agents.setdefault(name, told)
        for task in content["tasks"]:
            if tasks.setdefault(task["id"], task).get("digest") != task.get("digest"):
                raise ValueError(f"{source!r} flew another {task['id']}; join files of one version")
        for cell in content["cells"]:
            name = renamed[cell["agent"]]
            cells.setdefault((cell["task"], name), {**cell, "agent": name, "replay": None})
    manifests = {name: content["manifest"] for name, content in contents.items()}
    if len({manifest.get("seed") for manifest in manifests.values()}) != 1:
        raise ValueError("the files are of other seeds, and do not compare")
    first = next(iter(contents.values()))
    spent = {k: sum(m.get(k) or 0.0 for m in manifests.values()) for k in ("wall_s", "cpu_s")}
    joined = {**first, "manifest": {**first["manifest"], **spent, "joined": manifests}}
    joined |= {"tasks": [*tasks.values()], "agents": [*agents.values()], "cells": [*cells.values()]}
    joined["aggregates"], joined["profiles"] = families_of(_reached_in(joined))
    return joined
