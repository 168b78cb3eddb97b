"""The benchmark: every agent on every task, resumed where it was cut off.

`run` flies what is missing and writes `manifest.json`, `episodes.parquet`, `timing.parquet` and
`scores.json` into a folder. But for times, the results follow from the config alone, however often
the run was killed and whoever flew: `episodes.parquet` is the same to the byte.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.evaluation import Episode, frozen_seeds
from swarm_envs.files import write_json
from swarm_envs.training.scale_out.episodes import Entrant, Leg, fly_apart
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard import roster, scores
from swarm_envs.training.scoreboard.cells import Cell, Contender, enter, prepare
from swarm_envs.training.scoreboard.manifest import Manifest, command_line
from swarm_envs.training.scoreboard.metrics import Row, row_of
from swarm_envs.training.scoreboard.normalised import fastest_times
from swarm_envs.training.scoreboard.rows import Form, check_form, write_rows
from swarm_envs.training.scoreboard.tasks import COMMON, SEED, ScoredTask, digest

EPISODES, TIMING, SCORES = "episodes", "timing", "scores.json"
"""Names of what is written; the first two end as the form of the tables says."""
_QUICK = 16
"""A quick benchmark flies so many times fewer episodes."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is to be flown."""

    tasks: Sequence[ScoredTask]
    """Rows of the table of tasks."""
    agents: Sequence[str]
    """As of `swarm_envs.agents.load`."""
    seed: int = SEED
    """What the frozen seeds are drawn from; with another than the default, scores are of another
    benchmark."""
    episodes: int | None = None
    """Of every agent on every task; None for those that the tables give."""
    quick: bool = False
    """Whether to fly a sixteenth of those, and at least one: to see that all works."""

    def count(self, agent: str, task: ScoredTask) -> int:
        """How many episodes an agent flies of a task."""
        if self.episodes is not None:
            return self.episodes
        usual = roster.episodes_of(agent, task)
        return max(1, usual // _QUICK) if self.quick else usual

    def config(self, contenders: Sequence[Contender]) -> dict[str, Any]:
        """Everything that the results depend on, ready for JSON."""
        return {
            "version": __version__,
            "seed": self.seed,
            "episodes": self.episodes if self.episodes is not None else "as of the tables",
            "quick": self.quick,
            "setting": dict(COMMON),
            "tasks": {task.id: digest(task) for task in self.tasks},
            "agents": {c.name: c.digest or "cannot be made" for c in contenders},
        }


def run(plan: Plan, out: Path, scale: ScaleOptions, form: Form = "parquet") -> dict[str, Any]:
    """Fly what is missing, and write everything; give what `scores.json` holds.

    The folder must be claimed (`swarm_envs.files.claimed`).

    Args:
        plan: what is to be flown.
        out: the folder.
        scale: who shares the flights.
        form: of the tables of episodes.

    Raises:
        ImportError: Parquet or a cluster is asked for, and what it needs is not installed.
        ConnectionError: there is no such cluster.
        OSError: something cannot be written.
        OtherBenchmark: the folder holds the benchmark of another config.
        ValueError: a file in the folder is damaged.
    """
    check_form(form)
    contenders = [enter(name) for name in plan.agents]
    manifest = Manifest(out, plan.config(contenders))
    manifest.begin(command_line())
    pairs = [(task, contender) for task in plan.tasks for contender in contenders]
    cells = [
        prepare(task, contender, frozen_seeds(plan.seed, plan.count(contender.name, task)), out)
        for task, contender in tqdm(pairs, desc="cells", unit="cell", mininterval=0.5)
    ]
    _fly(cells, scale)
    rows = rows_of(cells)
    for name, table in ((EPISODES, [r for part in rows for r in part]), (TIMING, _times(cells))):
        write_rows(out / f"{name}.{form}", table)
    manifest.end()
    content = scores.content(manifest.content(), cells, rows)
    write_json(out / SCORES, content)
    return content


def _fly(cells: Sequence[Cell], scale: ScaleOptions) -> None:
    """Fly all that is missing, what costs most first, with one bar of expected CPU seconds."""
    costs: dict[int, float] = {}
    legs: list[Leg] = []
    for cell in cells:
        if cell.leg is not None:
            costs[id(cell.leg.entrant)] = roster.seconds_of(cell.contender.name, cell.task)
            legs.append(cell.leg)
    left = [leg for leg in legs if leg.missing]
    _tell_before(legs)
    if not left:
        return
    left.sort(key=lambda leg: -costs[id(leg.entrant)])
    total, done = sum(len(leg.missing) for leg in left), 0
    tasks = {id(cell.leg.entrant): cell.task.id for cell in cells if cell.leg is not None}
    work = sum(len(leg.missing) * costs[id(leg.entrant)] for leg in left)
    bar_format = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
    with scale.open() as workers, tqdm(total=work, bar_format=bar_format, mininterval=0.5) as bar:

        def watch(entrant: Entrant, episode: Episode) -> None:
            nonlocal done
            done += 1
            bar.set_description_str(f"{tasks[id(entrant)]} {entrant.name[-24:]}", refresh=False)
            bar.set_postfix_str(f"{done:,} of {total:,} episodes", refresh=False)
            bar.update(costs[id(entrant)])

        fly_apart(left, workers, watch)
        bar.total = bar.n  # agents that failed flew less
    failed = [leg.entrant for leg in left if leg.entrant.failure is not None]
    traces = {entrant.name: entrant.trace for entrant in failed if ":" in entrant.name}
    sys.stderr.write("".join(traces.values()))  # whoever wrote a file needs to see where it failed


def _tell_before(legs: Sequence[Leg]) -> None:
    wanted = sum(len(leg.seeds) for leg in legs)
    missing = sum(len(leg.missing) for leg in legs)
    if missing < wanted:
        sys.stderr.write(f"{wanted - missing:,} of {wanted:,} episodes were flown before\n")


def rows_of(cells: Sequence[Cell]) -> list[list[Row]]:
    """The rows of each cell's episodes, in order."""
    fastest: Mapping[str, Mapping[int, float]] = {
        task.id: fastest_times(task, _longest(cells, task))
        for task in {cell.task.id: cell.task for cell in cells}.values()
        if task.score == "time"
    }
    return [
        [
            row_of(cell.task, cell.contender.name, k, episode, _of_seed(fastest, cell, episode))
            for k, episode in enumerate(cell.episodes)
        ]
        for cell in cells
    ]


def _longest(cells: Sequence[Cell], task: ScoredTask) -> Sequence[int]:
    """The most seeds of which a task was flown: all others are the first of these."""
    return max((cell.seeds[: len(cell.episodes)] for cell in cells if cell.task is task), key=len)


def _of_seed(
    fastest: Mapping[str, Mapping[int, float]], cell: Cell, episode: Episode
) -> float | None:
    return fastest[cell.task.id][episode["seed"]] if cell.task.id in fastest else None


def _times(cells: Sequence[Cell]) -> list[Row]:
    """A row for each episode whose decisions were timed: no two runs measure the same."""
    return [
        {
            "task_id": cell.task.id,
            "agent": cell.contender.name,
            "seed": episode["seed"],
            "episode": k,
            "decisions": len(episode["act_us"]),
            "act_us_p50": float(np.percentile(episode["act_us"], 50.0)),
            "act_us_p99": float(np.percentile(episode["act_us"], 99.0)),
        }
        for cell in cells
        for k, episode in enumerate(cell.episodes)
        if episode["act_us"]
    ]
