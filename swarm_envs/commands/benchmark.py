"""`swarm-envs benchmark`: evaluate every agent on every task, with tables and plots."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from swarm_envs.commands.checks import as_misuse, check_file, check_folder
from swarm_envs.errors import check_integer
from swarm_envs.files import claimed, write_json, written_whole
from swarm_envs.training.scale_out import ScaleOptions
from swarm_envs.training.scoreboard.agents import choose_agents
from swarm_envs.training.scoreboard.results import FILE
from swarm_envs.training.scoreboard.run import fly_benchmark
from swarm_envs.training.scoreboard.summary import (
    NOTE,
    align_columns,
    markdown,
    standings,
    summarize,
)
from swarm_envs.training.scoreboard.tasks import SEED, choose_tasks


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Evaluate every agent on every benchmark task that it supports; write a table and plots.

    An interrupted command resumes after the last complete episode when it is run again. An agent
    that fails is reported with its error, and the exit status is 1.
    """

    out: Path
    """Output folder for episodes.parquet, report.md, success.png and scores.png."""
    agent: list[str] = field(default_factory=lambda: ["*"])
    """Names of included agents or patterns, such as `swap-*` (in quotes), and custom agents as
    path/to/file.py:Class."""
    task: list[str] = field(default_factory=lambda: ["*"])
    """Ids of benchmark tasks, such as `swap-circle-4-v2`, or patterns (in quotes)."""
    episodes: int | None = None
    """Number of episodes per agent and task. If None, it depends on the task and on the speed of
    the agent."""
    quick: bool = False
    """Simulate a sixteenth of the episodes."""
    seed: int = SEED
    """Random seed of the episodes. Scores of different seeds are not comparable."""
    json: Path | None = None
    """Also write all metrics of every agent and task, with 95 % intervals, to this file."""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """Options of parallel evaluation; they do not change the results."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid numbers, or for two numbers of episodes."""
        check_integer("--seed", self.seed, at_least=0)
        if self.episodes is not None:
            check_integer("--episodes", self.episodes, at_least=1)
        if self.episodes is not None and self.quick:
            raise ValueError("--quick and --episodes both set the number of episodes; give one")


def run_benchmark(options: BenchmarkOptions) -> int:
    """Run the benchmark, and write and print its results; return the number of failures."""
    if options.json is not None:
        check_file("--json", options.json, (".json",))
    check_folder("--out", options.out)
    with as_misuse():
        tasks, agents = choose_tasks(options.task), choose_agents(options.agent)
    given = {name: getattr(options, name) for name in ("seed", "episodes", "quick")}
    with claimed(options.out):
        with as_misuse():
            results = fly_benchmark(tasks, agents, options.out, options.scale, **given)
        content = summarize(results)
        files = [options.out / FILE, *_write(content, options.out)]
    if options.json is not None:
        write_json(options.json, content)
        files.append(options.json)
    print("", *align_columns(standings(content)), NOTE, sep="\n")
    failed = [cell for cell in content["cells"] if cell["status"] == "failed"]
    for cell in failed:
        print(f"{cell['agent']} FAILED {cell['task']}: {cell['reason']}")
    for path in files:
        print(f"wrote {path}")
    return len(failed)


def _write(content: dict[str, Any], out: Path) -> list[Path]:
    """Write the tables and plots of a summary; return their files."""
    from swarm_envs.training.scoreboard.plots import plot_scores, plot_success

    report, success, scores = (out / name for name in ("report.md", "success.png", "scores.png"))
    with written_whole(report) as partial:
        partial.write_text(markdown(content), encoding="utf-8")
    plot_success(success, content)
    plot_scores(scores, content)
    return [report, success, scores]
