"""`swarm-envs benchmark`: every agent on every task, and a report of it."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from swarm_envs.commands.checks import Misuse, check_file, check_folder
from swarm_envs.errors import check_integer
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard.tasks import SEED

if TYPE_CHECKING:
    from swarm_envs.training.scoreboard.runner import Plan


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Fly every agent on every task that it supports, and report how they did.

    Interrupted or killed, the same command goes on. An agent that fails is named with the reason,
    the others go on, and the exit code is 1; what an agent does not support is in the report too.
    """

    out: Path
    """folder of the report, the tables, every episode and the replay pages"""
    agents: list[str] = field(default_factory=lambda: ["*"])
    """who flies: names of those that ship or patterns of them, such as `swap-*` (in quotes), and
    agents of your own, as of `evaluate`: path/to/file.py:Class"""
    tasks: list[str] = field(default_factory=lambda: ["*"])
    """ids of tasks, such as `swap-circle-4-v1`, or patterns of them, in quotes"""
    episodes: int | None = None
    """of every agent on every task; by default those of the tables, more where they are cheap"""
    quick: bool = False
    """fly a sixteenth of the episodes, to see that all works"""
    seed: int = SEED
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
        check_integer("--seed", self.seed, 0)
        if self.episodes is not None:
            check_integer("--episodes", self.episodes, 1)
            if self.quick:
                raise ValueError("--quick and --episodes both say how many are flown; give one")


def run(options: BenchmarkOptions) -> int:
    """Fly, write and print; return how many cells failed, or have no replay that should.

    Raises:
        BlockingIOError: another process writes into the folder.
        ImportError: what the tables, the pages or a cluster need is not installed.
        Misuse: there is no such agent or task, or no place to write; nothing was flown.
    """
    from swarm_envs.files import claimed, write_json
    from swarm_envs.training.scoreboard.manifest import OtherBenchmark
    from swarm_envs.training.scoreboard.replays import record
    from swarm_envs.training.scoreboard.report import write
    from swarm_envs.training.scoreboard.runner import SCORES
    from swarm_envs.training.scoreboard.runner import run as fly

    check_folder("--out", options.out)
    if options.json is not None:
        check_file("--json", options.json, (".json",))
    plan = _plan(options)
    if options.replays and importlib.util.find_spec("plotly") is None:
        raise ImportError(
            "replay pages need plotly; install it by: pip install 'swarm-envs[viz]', or do without "
            "them by --no-replays"
        )
    with claimed(options.out):
        try:
            content = fly(plan, options.out, options.scale, options.table)
        except OtherBenchmark as error:
            raise Misuse(str(error)) from error
        if options.json is not None:
            write_json(options.json, content)
        problems = record(options.out, options.scale.workers) if options.replays else []
        page = write(options.out)
    print(_standings(content))
    for problem in problems:
        print(f"no replay: {problem}")
    for path in filter(None, (options.out / SCORES, options.json, page)):
        print(f"wrote {path}")
    return len(problems) + sum(cell["status"] == "failed" for cell in content["cells"])


def _plan(options: BenchmarkOptions) -> Plan:
    from swarm_envs.training.scoreboard import roster, tasks
    from swarm_envs.training.scoreboard.runner import Plan

    try:
        chosen, agents = tasks.choose(options.tasks), roster.choose(options.agents)
    except ValueError as error:
        raise Misuse(str(error)) from error
    return Plan(
        tasks=chosen,
        agents=agents,
        seed=options.seed,
        episodes=options.episodes,
        quick=options.quick,
    )


def _standings(content: dict[str, Any]) -> str:
    """The agents' scores in a few columns, and who failed."""
    families = list(content["aggregates"])
    rows = [["agent", *families]]
    for agent in content["agents"]:
        row = [agent["name"] + ("*" if agent["privileged"] else "")]
        rows.append([*row, *(_cell(content["aggregates"][f].get(agent["name"])) for f in families)])
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows]
    lines += ["* sees the true state; (k of n): tasks that it supports, all where nothing stands"]
    lines += [
        f"{cell['agent']} FAILED {cell['task']}: {cell['reason']}"
        for cell in content["cells"]
        if cell["status"] == "failed"
    ]
    return "\n" + "\n".join(line.rstrip() for line in lines)


def _cell(standing: dict[str, Any] | None) -> str:
    if standing is None:
        return "-"
    low, high = standing["interval"]
    part = (
        "" if standing["tasks"] == standing["of"] else f" ({standing['tasks']} of {standing['of']})"
    )
    return f"{standing['value']:.2f} [{low:.2f}, {high:.2f}]{part}"
