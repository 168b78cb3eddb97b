"""`swarm-envs evaluate`: many episodes of one or more agents, all on the same seeds."""

from __future__ import annotations

import shutil
import sys
import traceback
from collections.abc import Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarm_envs.arguments import Count, Seed
from swarm_envs.commands.checks import Misuse, check_file, check_folder, command_options
from swarm_envs.commands.fly import EpisodeOptions, best_agent, check_flies, find_task, prepare
from swarm_envs.training.scale_out.options import ScaleOptions

if TYPE_CHECKING:
    from swarm_envs.agents import Agent
    from swarm_envs.agents.evaluation import Episode, EpisodeFile
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.training.scale_out.episodes import AgentEpisodes

    Made = tuple[Agent, SwarmParallelEnv] | BaseException


@command_options
@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(EpisodeOptions):
    """Evaluate agents on many episodes with the same seeds, and report rates and means.

    An interrupted command resumes after the last complete episode when it is run again. An agent
    that fails during an episode is reported with its error, and the exit status is 1. Agents that
    cannot fly the task are refused before the first episode.
    """

    agent: list[str] = field(default_factory=list)
    """agents: names as of `fly`, folders of trained policies, or path/to/file.py:Class; the suffix
    +filter adds a safety filter (default: the best for the task in the benchmark)"""
    episodes: Count = 256
    """number of episodes per agent"""
    seed: Seed = 0
    """random seed from which the seeds of the episodes are drawn, the same for every agent"""
    physics: str = "batch"
    """`batch` or `bullet`"""
    force_rate: Count = 240
    """force evaluations per second: 240 over an integer"""
    out: Path | None = None
    """output folder for report.json, and for the results of every episode in episodes/"""
    json: Path | None = None
    """write the report to this file; until then, episodes are stored next to it"""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """parallel evaluation"""

    def __post_init__(self) -> None:
        """Refuse names that would be flown twice, and two numbers of drones."""
        super().__post_init__()
        if len(set(self.agent)) < len(self.agent):
            raise ValueError(f"--agent is {self.agent}; name each once")


def run_evaluate(options: EvaluateOptions) -> int:
    """Fly, print and write; return how many agents failed."""
    from swarm_envs import make
    from swarm_envs.files import claimed

    reports = [path for path in (options.json, _inside(options.out, "report.json")) if path]
    if options.out is not None:
        check_folder("--out", options.out)
    for path in reports:
        check_file("--json", path, (".json",))
    try:
        task = find_task(options.task)
        make(task, **options.setting()).close()
        options = replace(options, agent=options.agent or [best_agent(options, task)])
    except (ValueError, TypeError, ImportError) as error:
        raise Misuse(str(error)) from error
    folder = _kept(options) if options.out is None else options.out
    with ExitStack() as opened:
        made = _make_all(options, task, opened)
        opened.enter_context(nullcontext() if folder is None else claimed(folder))
        return _evaluate(options, task, made, reports)


def _make_all(options: EvaluateOptions, task: str, opened: ExitStack) -> dict[str, Made]:
    """Every agent with its environment, or what its own file raises."""
    from swarm_envs.agents.evaluation import frozen_seeds

    found: dict[str, Made] = {}
    for name in options.agent:
        try:
            agent, env = prepare(name, options, task)
        except (ValueError, TypeError, FileNotFoundError) as error:
            raise Misuse(f"agent {name!r} cannot fly: {error}") from error
        except (Exception, SystemExit) as error:
            found[name] = error
            continue
        opened.callback(env.close)
        check_flies(name, agent, env, options, frozen_seeds(options.seed, 1)[0])
        found[name] = agent, env
    return found


def _evaluate(
    options: EvaluateOptions, task: str, made: Mapping[str, Made], reports: list[Path]
) -> int:
    """Fly all agents and write the reports; return how many failed."""
    from swarm_envs.files import write_json

    about = {"task": task, **options.setting(), "seed": options.seed}
    agents = _reports(options, about, made)
    failed = sum("error" in report for report in agents)
    content = {**about, **(agents[0] if len(agents) == 1 else {}), "agents": agents}
    for path in reports:
        write_json(path, content)
        print(f"wrote {path}", flush=True)
    print(_table(agents))
    kept = _kept(options)
    if options.out is None and kept is not None and kept.is_dir() and not failed:
        shutil.rmtree(kept)  # the report is whole: nothing is left to go on with
    return failed


def _inside(folder: Path | None, name: str) -> Path | None:
    return None if folder is None else folder / name


def _kept(options: EvaluateOptions) -> Path | None:
    """Folder in which episodes are kept, if any."""
    if options.out is not None:
        return options.out / "episodes"
    return None if options.json is None else options.json.with_suffix(".episodes")


def _reports(
    options: EvaluateOptions, about: dict[str, Any], made: Mapping[str, Made]
) -> list[dict[str, Any]]:
    """Each agent's scores; or, under `error`, why it has none."""
    if not options.scale.alone:
        return _reports_apart(options, about, made)
    return [_report(name, each, options, about) for name, each in made.items()]


def _report(
    name: str, made: Made, options: EvaluateOptions, about: dict[str, Any]
) -> dict[str, Any]:
    from swarm_envs.agents import SafetyFilter
    from swarm_envs.agents.evaluation import score_episodes

    report: dict[str, Any] = {"agent": name}
    if isinstance(made, BaseException):
        return {**report, "error": _unflyable(made)}
    agent, env = made
    report |= _described(agent, env)
    try:
        scores = score_episodes(_fly(name, env, agent, options, about))
        counted = {"filter": agent.statistics()} if isinstance(agent, SafetyFilter) else {}
        return {**report, **scores, **counted}
    except Exception as error:
        if ":" in name:  # its author needs to see where it failed
            traceback.print_exception(error.__cause__ or error)
        return {**report, "error": str(error)}


def _unflyable(error: BaseException) -> str:
    """Why an agent has no scores, if it cannot even be made."""
    return f"cannot be flown: {type(error).__name__}: {error}"


def _described(agent: Agent, env: SwarmParallelEnv) -> dict[str, Any]:
    """What a report says of an agent besides its scores."""
    return {"privileged": agent.privileged, "decision_rate": env.core.config.decision_rate}


def _fly(
    name: str, env: SwarmParallelEnv, agent: Agent, options: EvaluateOptions, about: dict[str, Any]
) -> list[dict[str, Any]]:
    """Every episode of an agent, with a progress bar; what is kept is not flown again."""
    from tqdm import tqdm

    from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds

    seeds = frozen_seeds(options.seed, options.episodes)
    kept = _open_episodes(name, agent, options, about)
    found = kept.episodes if kept is not None else {}
    _tell_before(name, sum(seed in found for seed in seeds), len(seeds))
    episodes, good = [], 0
    flown = evaluate_agent(env, agent, seeds, dict(found), kept.add if kept is not None else None)
    with tqdm(total=len(seeds), desc=name[-30:], unit="episode", mininterval=0.5) as bar:
        for episode in flown:
            episodes.append(episode)
            good += episode["metrics"]["success"]
            bar.set_postfix_str(f"success {good / len(episodes):.1%}", refresh=False)
            bar.update()
    return episodes


def _tell_before(name: str, before: int, wanted: int) -> None:
    """Say how many of an agent's episodes are there already, if any."""
    if before:
        print(f"{name}: {before} of {wanted} episodes were flown before", flush=True)


def _open_episodes(
    name: str, agent: Agent, options: EvaluateOptions, about: dict[str, Any]
) -> EpisodeFile | None:
    """Where an agent's episodes are kept; None if they are not."""
    from swarm_envs import __version__
    from swarm_envs.agents.evaluation import EpisodeFile, source_digest

    folder = _kept(options)
    if folder is None:
        return None
    depends = {k: v for k, v in about.items() if k != "seed"}
    depends |= {"agent": name, "source": source_digest(agent), "version": __version__}
    return EpisodeFile(folder, name, depends)


def _reports_apart(
    options: EvaluateOptions, about: dict[str, Any], made: Mapping[str, Made]
) -> list[dict[str, Any]]:
    """The same with other processes or a Ray cluster."""
    found: dict[str, dict[str, Any]] = {}
    agents: dict[str, AgentEpisodes] = {}
    for name, each in made.items():
        found[name], record = _enter_apart(name, each, options, about)
        if record is not None:
            agents[name] = record
    _fly_apart([*agents.values()], options, about["task"])
    for name, record in agents.items():
        found[name] |= _scores(record, options)
    return [found[name] for name in options.agent]


def _enter_apart(
    name: str, made: Made, options: EvaluateOptions, about: dict[str, Any]
) -> tuple[dict[str, Any], AgentEpisodes | None]:
    """What is known of an agent before it flies; no record if it cannot."""
    from swarm_envs.agents.evaluation import source_digest
    from swarm_envs.agents.protocol import flies_batches
    from swarm_envs.training.scale_out.episodes import AgentEpisodes

    report: dict[str, Any] = {"agent": name}
    if isinstance(made, BaseException):
        return {**report, "error": _unflyable(made)}, None
    agent, env = made
    report |= _described(agent, env)
    batched = flies_batches(env, agent)
    try:
        kept = _open_episodes(name, agent, options, about)
    except Exception as error:
        return {**report, "error": str(error)}, None
    return report, AgentEpisodes(name, source_digest(agent), batched, kept)


def _fly_apart(agents: list[AgentEpisodes], options: EvaluateOptions, task: str) -> None:
    """Every episode of all agents that is not there yet, with one progress bar."""
    from tqdm import tqdm

    from swarm_envs.agents.evaluation import frozen_seeds
    from swarm_envs.training.scale_out.episodes import EvaluationSpec, evaluate_distributed

    seeds = frozen_seeds(options.seed, options.episodes)
    before = {e.name: sum(seed in e.episodes for seed in seeds) for e in agents}
    for name, count in before.items():
        _tell_before(name, count, len(seeds))
    total = len(seeds) * len(agents)
    if sum(before.values()) == total:
        return
    with (
        options.scale.open() as workers,
        tqdm(total=total, initial=sum(before.values()), unit="episode", mininterval=0.5) as bar,
    ):

        def on_episode(record: AgentEpisodes, episode: Episode) -> None:
            bar.set_description_str(record.name[-30:], refresh=False)
            bar.update()

        setting = options.setting()
        evaluate_distributed(
            [EvaluationSpec(e, task, setting, seeds) for e in agents], workers, on_episode
        )


def _scores(record: AgentEpisodes, options: EvaluateOptions) -> dict[str, Any]:
    from swarm_envs.agents.evaluation import frozen_seeds, score_episodes

    if record.failure is None:
        return score_episodes(record.flown(frozen_seeds(options.seed, options.episodes)))
    if ":" in record.name:  # its author needs to see where it failed
        sys.stderr.write(record.trace)
    return {"error": record.failure}


def _table(agents: list[dict[str, Any]]) -> str:
    """The reports in a few columns; a number that no agent has is left out."""
    known = [report for report in agents if "error" not in report]
    shown = {n: head for n, head in _COLUMNS.items() if any(r.get(n) is not None for r in known)}
    heads = ("agent", "success (95 %)", "collided", "near miss", *shown.values(), "decision, ms")
    rows = [heads, *(_row(report, [*shown]) for report in known)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    lines += [f"{r['agent']} FAILED: {r['error']}" for r in agents if "error" in r]
    if any(report.get("privileged") for report in agents):
        lines.append("* sees the true state")
    if known:
        lines.append("decision: median (99th percentile) of the agent's time for the whole team")
    return "\n" + "\n".join(line.rstrip() for line in lines)


_COLUMNS = {
    "time_to_goal_s": "time to goal, s",
    "worst_height_error_m": "worst height error, m",
    "throughput_per_min": "goals per minute",
    "share_on_goal": "time on goal",
    "gates_per_min": "gates per minute",
    "energy_j": "energy, J",
}
"""Numbers of a report and their heads, in the order of the table."""


def _row(report: dict[str, Any], shown: list[str]) -> tuple[str, ...]:
    low, high = report["intervals"]["success_rate"]
    return (
        report["agent"] + ("*" if report["privileged"] else ""),
        f"{report['success_rate']:.1%} ({100 * low:.0f}-{100 * high:.0f})",
        f"{report['collision_rate']:.1%}",
        f"{report['near_miss_rate']:.1%}",
        *(_number(report.get(name), 3 if name.endswith("_m") else 2) for name in shown),
        f"{report['act_ms']['p50']:.2f} ({report['act_ms']['p99']:.2f})",
    )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
