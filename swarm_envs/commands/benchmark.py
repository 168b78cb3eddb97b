"""`swarm-envs benchmark`: every agent on every task, and a report of it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from swarm_envs.arguments import Count, Seed
from swarm_envs.commands.checks import Misuse, as_misuse, check_file, check_folder, command_options
from swarm_envs.envs.setting import CrewOptions
from swarm_envs.files import claimed, write_json
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard.board import FILE, read
from swarm_envs.training.scoreboard.manifest import OtherBenchmark
from swarm_envs.training.scoreboard.replays import record_replays
from swarm_envs.training.scoreboard.report import write
from swarm_envs.training.scoreboard.results import join_results, verify_results
from swarm_envs.training.scoreboard.roster import choose_agents
from swarm_envs.training.scoreboard.runner import BenchmarkPlan, fly_benchmark
from swarm_envs.training.scoreboard.standings import NOTE, align_columns, standings
from swarm_envs.training.scoreboard.tasks import SEED, choose_tasks


@dataclass(frozen=True, kw_only=True)
class CellOptions:
    """Which cells of the benchmark are flown, and where they are kept."""

    out: Path | None = None
    """output folder for the report, tables, episodes and replay pages"""
    report: Path | None = None
    """rebuild the report of this folder, with missing replay pages, without new episodes"""
    verify: Path | None = None
    """check a results file (scores.json, or its folder): recompute the report and fly some episodes
    again"""
    join: list[Path] = field(default_factory=list)
    """merge these results files into one report in the folder --out"""
    agent: list[str] = field(default_factory=lambda: ["*"])
    """agents: included names or patterns, such as `swap-*` (quoted), and custom agents as of
    `evaluate`, path/to/file.py:Class"""
    task: list[str] = field(default_factory=lambda: ["*"])
    """task ids, such as `swap-circle-4-v2`, or patterns (quoted)"""
    episodes: Count | None = None
    """number of episodes per agent and task; default: depends on the task and the speed of the
    agent"""
    quick: bool = False
    """fly a sixteenth of the episodes"""
    seed: Seed = SEED
    """random seed of the episodes; scores of other seeds are not comparable"""


@command_options
@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions(CrewOptions, CellOptions):
    """Evaluate every agent on every benchmark task that it supports, and write a report.

    An interrupted command resumes when it is run again. An agent that fails is reported with its
    error, and the exit status is 1. Options of the environment apply to every task and change the
    tasks' ids.
    """

    replays: bool = True
    """record a replay of one episode per agent and task"""
    table: Literal["parquet", "csv"] = "parquet"
    """format of the tables of episodes; csv does not need pyarrow"""
    json: Path | None = None
    """also write the content of scores.json to this file"""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """parallel evaluation"""

    def __post_init__(self) -> None:
        """Refuse numbers with which nothing can be flown."""
        if self.episodes is not None and self.quick:
            raise ValueError("--quick and --episodes both say how many are flown; give one")
        if sum(each is not None for each in (self.out, self.report, self.verify)) != 1:
            raise ValueError(
                "give either --out DIR, to fly, or --report DIR, to report again, or --verify FILE"
            )
        if self.join and self.out is None:
            raise ValueError("--join writes into a folder; give --out DIR too")


def run_benchmark(options: BenchmarkOptions) -> int:
    """Fly, write and print; return how many cells failed, or have no replay that should."""
    if options.json is not None:
        check_file("--json", options.json, (".json",))
    if options.verify is not None:
        return _verify(options.verify)
    if options.join:
        assert options.out is not None
        return _join(options.join, options.out)
    if options.out is not None:
        return _fly(options, options.out)
    assert options.report is not None
    return _rewrite(options, options.report)


def _fly(options: BenchmarkOptions, out: Path) -> int:
    check_folder("--out", out)
    with as_misuse():
        tasks, agents = choose_tasks(options.task, options.crew()), choose_agents(options.agent)
    given = {name: getattr(options, name) for name in ("seed", "episodes", "quick")}
    plan = BenchmarkPlan(tasks=tasks, agents=agents, **given)
    with claimed(out):
        try:
            content = fly_benchmark(plan, out, options.scale, options.table)
        except OtherBenchmark as error:
            raise Misuse(str(error)) from error
        if options.json is not None:
            write_json(options.json, content)
        problems, page = _show(options, out)
    print(_standings(content))
    _tell(problems, out / FILE, options.json, page)
    return len(problems) + sum(cell["status"] == "failed" for cell in content["cells"])


def _verify(path: Path) -> int:
    """Say what is wrong with a results file; return how much."""
    count = 0
    with as_misuse(FileNotFoundError):
        for problem in verify_results(path):
            count += 1
            print(f"WRONG {problem}", flush=True)
    print(f"{path}: {f'{count} problems' if count else 'verified'}")
    return count


def _join(paths: list[Path], out: Path) -> int:
    """Write a results file of several, and its report."""
    check_folder("--out", out)
    with as_misuse(FileNotFoundError):
        content = join_results(paths)
    with claimed(out):
        write_json(out / FILE, content)
        print(_standings(content))
        _tell([], out / FILE, write(out))
    return 0


def _rewrite(options: BenchmarkOptions, folder: Path) -> int:
    """Write the pages of a benchmark that was flown; return how many are missing."""
    with as_misuse(FileNotFoundError):
        read(folder)
    with claimed(folder):
        problems, page = _show(options, folder)
        if options.json is not None:
            write_json(options.json, json.loads((folder / FILE).read_text(encoding="utf-8")))
    _tell(problems, options.json, page)
    return len(problems)


def _show(options: BenchmarkOptions, folder: Path) -> tuple[list[str], Path]:
    """Write the replay pages and the report; give what went wrong, and the report."""
    problems = record_replays(folder, options.scale.workers) if options.replays else []
    return problems, write(folder)


def _tell(problems: list[str], *written: Path | None) -> None:
    for problem in problems:
        print(f"no replay: {problem}")
    for path in filter(None, written):
        print(f"wrote {path}")


def _standings(content: dict[str, Any]) -> str:
    lines = [*align_columns(standings(content)), NOTE]
    lines += [
        f"{cell['agent']} FAILED {cell['task']}: {cell['reason']}"
        for cell in content["cells"]
        if cell["status"] == "failed"
    ]
    return "\n" + "\n".join(lines)
