"""`swarm-envs benchmark`: every agent on every task, and a report of it."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from swarm_envs.arguments import Count, Seed
from swarm_envs.commands.checks import Misuse, check_file, check_folder, command_options
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard.tasks import SEED


@command_options
@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Fly every agent on every task that it supports, and report how they did.

    Interrupted or killed, the same command resumes. An agent that fails is named with the reason,
    the others go on, and the exit code is 1; what an agent does not support is in the report too.
    """

    out: Path | None = None
    """folder of the report, the tables, every episode and the replay pages"""
    report: Path | None = None
    """write the report of this folder again, and the replay pages that it lacks; nothing else is
    flown"""
    agents: list[str] = field(default_factory=lambda: ["*"])
    """who flies: names of those that ship or patterns of them, such as `swap-*` (in quotes), and
    agents of your own, as of `evaluate`: path/to/file.py:Class"""
    tasks: list[str] = field(default_factory=lambda: ["*"])
    """ids of tasks, such as `swap-circle-4-v1`, or patterns of them, in quotes"""
    episodes: Count | None = None
    """of every agent on every task; by default those of the tables, more where they are cheap"""
    quick: bool = False
    """fly a sixteenth of the episodes, to see that all works"""
    seed: Seed = SEED
    """the episodes' seeds are drawn from it; with another, scores compare with nobody else's"""
    replays: bool = True
    """record for each cell an episode that can be looked at, one click from the report"""
    table: Literal["parquet", "csv"] = "parquet"
    """form of the tables of episodes; csv needs no pyarrow"""
    json: Path | None = None
    """write what scores.json holds to this file too"""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """who shares the flights"""

    def __post_init__(self) -> None:
        """Refuse numbers with which nothing can be flown."""
        if self.episodes is not None and self.quick:
            raise ValueError("--quick and --episodes both say how many are flown; give one")
        if (self.out is None) == (self.report is None):
            raise ValueError("give either --out DIR, to fly, or --report DIR, to report again")


def run_benchmark(options: BenchmarkOptions) -> int:
    """Fly, write and print; return how many cells failed, or have no replay that should.

    Raises:
        BlockingIOError: another process writes into the folder.
        ImportError: what the tables, the pages or a cluster need is not installed.
        Misuse: there is no such agent or task, no place to write, or nothing to write again;
            nothing was flown.
    """
    if options.json is not None:
        check_file("--json", options.json, (".json",))
    if options.replays and importlib.util.find_spec("plotly") is None:
        raise ImportError(
            "replay pages need plotly; install it by: pip install 'swarm-envs[viz]', or do without "
            "them by --no-replays"
        )
    if options.out is not None:
        return _fly(options, options.out)
    assert options.report is not None
    return _rewrite(options, options.report)


def _fly(options: BenchmarkOptions, out: Path) -> int:
    from swarm_envs.files import claimed, write_json
    from swarm_envs.training.scoreboard.board import FILE
    from swarm_envs.training.scoreboard.manifest import OtherBenchmark
    from swarm_envs.training.scoreboard.roster import choose_agents
    from swarm_envs.training.scoreboard.runner import BenchmarkPlan, fly_benchmark
    from swarm_envs.training.scoreboard.tasks import choose_tasks

    check_folder("--out", out)
    try:
        tasks, agents = choose_tasks(options.tasks), choose_agents(options.agents)
    except ValueError as error:
        raise Misuse(str(error)) from error
    plan = BenchmarkPlan(
        tasks=tasks,
        agents=agents,
        seed=options.seed,
        episodes=options.episodes,
        quick=options.quick,
    )
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


def _rewrite(options: BenchmarkOptions, folder: Path) -> int:
    """Write the pages of a benchmark that was flown; return how many are missing."""
    from swarm_envs.files import claimed, write_json
    from swarm_envs.training.scoreboard.board import FILE, read

    try:
        read(folder)
    except (FileNotFoundError, ValueError) as error:
        raise Misuse(str(error)) from error
    with claimed(folder):
        problems, page = _show(options, folder)
        if options.json is not None:
            write_json(options.json, json.loads((folder / FILE).read_text(encoding="utf-8")))
    _tell(problems, options.json, page)
    return len(problems)


def _show(options: BenchmarkOptions, folder: Path) -> tuple[list[str], Path]:
    """Write the replay pages and the report; give what went wrong, and the report."""
    from swarm_envs.training.scoreboard.replays import record_replays
    from swarm_envs.training.scoreboard.report import write

    problems = record_replays(folder, options.scale.workers) if options.replays else []
    return problems, write(folder)


def _tell(problems: list[str], *written: Path | None) -> None:
    for problem in problems:
        print(f"no replay: {problem}")
    for path in filter(None, written):
        print(f"wrote {path}")


def _standings(content: dict[str, Any]) -> str:
    from swarm_envs.training.scoreboard.standings import NOTE, align_columns, standings

    lines = [*align_columns(standings(content)), NOTE]
    lines += [
        f"{cell['agent']} FAILED {cell['task']}: {cell['reason']}"
        for cell in content["cells"]
        if cell["status"] == "failed"
    ]
    return "\n" + "\n".join(lines)
