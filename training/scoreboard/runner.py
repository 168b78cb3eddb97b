"""The benchmark: every agent on every task, resumed where it was cut off.

`fly_benchmark` flies what is missing and writes `manifest.json`, `episodes.parquet`,
`timing.parquet` and `scores.json` into a folder. But for times, the results follow from the config
alone, however often the run was killed, and on any workers: `episodes.parquet` is the same to the
byte.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents import Agent, load
from swarm_envs.agents.evaluation import Episode, EpisodeFile, frozen_seeds, source_digest
from swarm_envs.agents.protocol import check_options_agree, flies_batches
from swarm_envs.files import write_json
from swarm_envs.training.scale_out.episodes import (
    AgentEpisodes,
    EvaluationSpec,
    evaluate_distributed,
)
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard import roster, standings
from swarm_envs.training.scoreboard.board import FILE
from swarm_envs.training.scoreboard.manifest import Manifest
from swarm_envs.training.scoreboard.metrics import (
    EpisodeRow,
    TableForm,
    check_table_form,
    fastest_times,
    row_of,
    write_rows,
)
from swarm_envs.training.scoreboard.tasks import COMMON, SEED, ScoredTask, digest, make_scored

__all__ = ["BenchmarkPlan", "fly_benchmark"]

FOLDER = "episodes"  # Where episodes are kept, in a benchmark's folder
_QUICK = 16  # A quick benchmark flies so many times fewer episodes


@dataclass(frozen=True)
class LoadedAgent:
    """An agent that was asked for."""

    name: str  # As of `swarm_envs.agents.load`
    agent: Agent | None  # None if it could not be made
    digest: str  # Of its source; empty if it could not be made
    error: str = ""  # Why it could not

    @property
    def privileged(self) -> bool:
        """Whether it sees the true state."""
        return self.agent is not None and self.agent.privileged


@dataclass
class Evaluation:
    """An agent on a task."""

    task: ScoredTask  # What is flown
    loaded: LoadedAgent  # Who flies
    seeds: Sequence[int]  # Of its episodes
    spec: EvaluationSpec | None = None  # Its flights; None if there can be none
    refusal: str = ""  # Why there can be none, found before anything flew

    @property
    def episodes(self) -> list[Episode]:
        """Those that count, in the order of the seeds: none after the first that failed."""
        if self.spec is None:
            return []
        record = self.spec.record
        last = len(self.seeds) if record.failure is None else int(record.failed_at)
        return record.flown(self.seeds[:last])

    @property
    def refused(self) -> list[str]:
        """Why the agent refused, one for each episode that it did."""
        found = (episode["metrics"].get("refused") for episode in self.episodes)
        return [why for why in found if why is not None]

    @property
    def outcome(self) -> tuple[Literal["flown", "failed", "unsupported"], str]:
        """What became of it, and why it was not flown, or some of it not; empty if all was.

        An agent that refuses every episode does not support the task.
        """
        failure = self.spec.record.failure if self.spec is not None else None
        if self.loaded.error or failure is not None:
            return "failed", self.loaded.error or str(failure)
        refused = self.refused
        if self.spec is None or len(refused) == len(self.seeds):
            return "unsupported", self.refusal or refused[0]
        if refused:
            return "flown", f"refused {len(refused)} of {len(self.seeds)} episodes: {refused[0]}"
        return "flown", ""

    @property
    def act_us(self) -> list[int]:
        """Times of the decisions that were timed, microseconds."""
        return [spent for episode in self.episodes for spent in episode["act_us"]]


@dataclass(frozen=True, kw_only=True)
class BenchmarkPlan:
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

    def config(self, agents: Sequence[LoadedAgent]) -> dict[str, Any]:
        """Everything that the results depend on, ready for JSON."""
        return {
            "version": __version__,
            "seed": self.seed,
            "episodes": self.episodes if self.episodes is not None else "as of the tables",
            "quick": self.quick,
            "setting": dict(COMMON),
            "tasks": {task.id: digest(task) for task in self.tasks},
            "agents": {c.name: c.digest or "cannot be made" for c in agents},
        }


def fly_benchmark(
    plan: BenchmarkPlan, out: Path, scale: ScaleOptions, form: TableForm = "parquet"
) -> dict[str, Any]:
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
    check_table_form(form)
    agents = [_enter(name) for name in plan.agents]
    manifest = Manifest(out, plan.config(agents))
    manifest.begin(["swarm-envs", *sys.argv[1:]])
    pairs = [(task, loaded) for task in plan.tasks for loaded in agents]
    cells = [
        _prepare(task, loaded, frozen_seeds(plan.seed, plan.count(loaded.name, task)), out)
        for task, loaded in tqdm(pairs, desc="cells", unit="cell", mininterval=0.5)
    ]
    _fly(cells, scale)
    rows = _rows(cells)
    write_rows(out / f"episodes.{form}", [row for part in rows for row in part])
    write_rows(out / f"timing.{form}", _times(cells))
    manifest.end()
    content = standings.scores_of(manifest.content(), cells, rows)
    write_json(out / FILE, content)
    return content


def _enter(name: str) -> LoadedAgent:
    try:
        agent = load(name)
        return LoadedAgent(name, agent, source_digest(agent))
    except (Exception, SystemExit) as error:
        return LoadedAgent(name, None, "", f"cannot be made: {type(error).__name__}: {error}")


def _prepare(task: ScoredTask, loaded: LoadedAgent, seeds: Sequence[int], out: Path) -> Evaluation:
    agent, cell = loaded.agent, Evaluation(task, loaded, seeds)
    if agent is None:
        return cell
    try:
        check_options_agree(agent, task.setting)
        env = make_scored(task.environment, {**task.setting, **agent.requires})
    except (ValueError, TypeError, ImportError) as error:
        cell.refusal = str(error)
        return cell
    batched = flies_batches(env, agent)
    env.close()
    depends_on = {
        "task": task.id,
        "definition": digest(task),
        "version": __version__,
        "agent": loaded.name,
        "source": loaded.digest,
    }
    kept = EpisodeFile(out / FOLDER / task.id, loaded.name, depends_on)
    record = AgentEpisodes(loaded.name, loaded.digest, batched, kept)
    cell.spec = EvaluationSpec(record, task.environment, task.setting, seeds, refusals=True)
    return cell


def _fly(cells: Sequence[Evaluation], scale: ScaleOptions) -> None:
    """Fly all that is missing, what costs most first, with one bar of expected CPU seconds."""
    flights = [(cell, cell.spec) for cell in cells if cell.spec is not None]
    cells_of = {id(spec.record): cell for cell, spec in flights}
    wanted = sum(len(spec.seeds) for _, spec in flights)
    total, done = sum(len(spec.missing) for _, spec in flights), 0
    if total < wanted:
        sys.stderr.write(f"{wanted - total:,} of {wanted:,} episodes were flown before\n")
    if not total:
        return
    left = [spec for _, spec in flights if spec.missing]
    costs = {key: roster.seconds_of(c.loaded.name, c.task) for key, c in cells_of.items()}
    left.sort(key=lambda spec: -costs[id(spec.record)])
    work = sum(len(spec.missing) * costs[id(spec.record)] for spec in left)
    bar_format = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
    with scale.open() as workers, tqdm(total=work, bar_format=bar_format, mininterval=0.5) as bar:

        def on_episode(record: AgentEpisodes, episode: Episode) -> None:
            nonlocal done
            done += 1
            task = cells_of[id(record)].task
            bar.set_description_str(f"{task.id} {record.name[-24:]}", refresh=False)
            bar.set_postfix_str(f"{done:,} of {total:,} episodes", refresh=False)
            if "refused" in episode["metrics"]:
                bar.total -= costs[id(record)]  # it took no time
            else:
                bar.update(costs[id(record)])

        evaluate_distributed(left, workers, on_episode)
        bar.total = bar.n  # agents that failed flew less
    failed = [spec.record for spec in left if spec.record.failure is not None]
    traces = {record.name: record.trace for record in failed if ":" in record.name}
    sys.stderr.write("".join(traces.values()))  # whoever wrote a file needs to see where it failed


def _rows(cells: Sequence[Evaluation]) -> list[list[EpisodeRow]]:
    fastest: dict[str, Mapping[int, float]] = {}
    for cell in cells:
        task = cell.task
        if task.score == "time" and task.id not in fastest:
            flown = (c.seeds[: len(c.episodes)] for c in cells if c.task is task)
            fastest[task.id] = fastest_times(task, max(flown, key=len))  # others fly the first
    return [
        [
            row_of(
                cell.task,
                cell.loaded.name,
                k,
                episode,
                fastest.get(cell.task.id, {}).get(episode["seed"]),
            )
            for k, episode in enumerate(cell.episodes)
        ]
        for cell in cells
    ]


def _times(cells: Sequence[Evaluation]) -> list[EpisodeRow]:
    """A row for each episode whose decisions were timed: no two runs measure the same."""
    return [
        {
            "task_id": cell.task.id,
            "agent": cell.loaded.name,
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
