"""`swarm-envs evaluate`: evaluate agents on many episodes with the same seeds."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarm_envs import __version__
from swarm_envs.commands.checks import (
    Misuse,
    as_misuse,
    check_file,
    check_folder,
)
from swarm_envs.commands.fly import (
    EpisodeOptions,
    best_agent,
    cannot_fly,
    check_flies,
    find_task,
    prepare,
    team_text,
    training_notes,
)
from swarm_envs.envs.options import Blueprint, blueprint_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_divisor, check_integer
from swarm_envs.files import claimed, write_json
from swarm_envs.physics.bullet import import_bullet
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.training.scale_out import ScaleOptions
from swarm_envs.user_files import file_digest

if TYPE_CHECKING:
    from swarm_envs.agents import Agent
    from swarm_envs.agents.evaluation import EpisodeFile
    from swarm_envs.training.flights import Flight

    Made = tuple[Agent, SwarmParallelEnv] | BaseException


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(EpisodeOptions):
    """Evaluate agents on many episodes with the same seeds, and report rates and means.

    With --out, an interrupted command resumes after the last complete episode when it is run
    again. An agent that does not support the task is refused before the first episode. If an agent
    fails during an episode, its error is reported, and the exit status is 1.

    The table has a row for each agent. Success: the share of episodes that solve the task, with its
    95 % interval (Wilson). Crashed: the share in which a drone touches another, the floor, a wall
    or an obstacle, or tumbles; episodes that neither succeed nor crash reach the time limit. Near
    miss: the share without a crash in which two drones come closer than 1.5 times the distance at
    which they touch. Time to goal, energy of the rotors, return and others are interquartile means,
    of the successful episodes or of all. Decision: the median and the 99th percentile of the time
    in which the agent decides for the whole team, on one core.
    """

    agent: list[str] | None = None
    """One or more agents; the help of `swarm-envs fly` lists their names. Also folders of trained
    policies, path/to/file.py:Class or path/to/file.py:function. The suffix +filter adds a safety
    filter. If None, the best agent of the benchmark for the task is evaluated."""
    episodes: int = 256
    """Number of episodes per agent."""
    seed: int = 0
    """Random seed from which the seeds of the episodes are drawn, the same for every agent."""
    physics: str = "batch"
    """Physics engine, `batch` or `bullet`."""
    force_rate: int = 240
    """Rate at which interaction forces are computed, Hz; a divisor of 240."""
    out: Path | None = None
    """Output folder for report.json, and for the results of every episode in episodes/."""
    json: Path | None = None
    """Write the report to this file."""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """Options of parallel evaluation; they do not change the results."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid numbers, no agents, or an agent that is named twice."""
        super().__post_init__()
        check_integer("--episodes", self.episodes, at_least=1)
        check_integer("--seed", self.seed, at_least=0)
        check_divisor("--force-rate", self.force_rate, PHYSICS_RATE)
        if self.agent == []:
            raise ValueError("--agent is empty; name an agent, or leave the option out")
        if self.agent is not None and len(set(self.agent)) < len(self.agent):
            raise ValueError(f"--agent is {self.agent}, but must name each agent once")


def run_evaluate(options: EvaluateOptions) -> int:
    """Evaluate, print and write; return the number of agents that failed."""
    reports = [] if options.json is None else [options.json]
    if options.out is not None:
        check_folder("--out", options.out)
        reports.append(options.out / "report.json")
    for path in reports:
        check_file("--json", path, (".json",))
    with as_misuse(TypeError, ImportError):
        task = find_task(options.task)
        blueprint_of(task, **options.setting())
        if options.physics == "bullet":
            import_bullet()
        options = replace(options, agent=options.agent or [best_agent(options, task)])
    with ExitStack() as opened:
        made = _make_all(options, task, opened)
        opened.enter_context(nullcontext() if options.out is None else claimed(options.out))
        return _evaluate(options, task, made, reports)


def _make_all(options: EvaluateOptions, task: str, opened: ExitStack) -> dict[str, Made]:
    """Return every agent with its environment, or the exception that its own file raises."""
    from swarm_envs.agents.evaluation import frozen_seeds

    found: dict[str, Made] = {}
    prepared = {name: _prepared(name, options, task) for name in options.agent or ()}
    for name, given in prepared.items():  # only when none is refused: here kernels are compiled
        if isinstance(given, BaseException):
            found[name] = given
            continue
        agent, blueprint = given
        with as_misuse(TypeError):
            env = SwarmParallelEnv(*blueprint)
        opened.callback(env.close)
        check_flies(name, agent, env, options, frozen_seeds(options.seed, 1)[0])
        found[name] = agent, env
    return found


def _prepared(
    name: str, options: EvaluateOptions, task: str
) -> tuple[Agent, Blueprint] | BaseException:
    """Return what `prepare` returns, or raise the error of an agent's own file."""
    try:
        return prepare(name, options, task)
    except (ValueError, TypeError, FileNotFoundError) as error:
        raise Misuse(cannot_fly(name, error)) from error
    except (Exception, SystemExit) as error:
        return error


def _evaluate(
    options: EvaluateOptions, task: str, made: Mapping[str, Made], reports: list[Path]
) -> int:
    """Evaluate all agents and write the reports; return the number of agents that failed."""
    about = {"task": task, **options.setting(), "seed": options.seed}
    agents = _reports(options, about, made)
    failed = sum("error" in report for report in agents)
    content = {**about, **(agents[0] if len(agents) == 1 else {}), "agents": agents}
    for path in reports:
        write_json(path, content)
        print(f"wrote {path}", flush=True)
    flown = {name: each[0] for name, each in made.items() if isinstance(each, tuple)}
    notes = training_notes(flown, options)
    table = _table(agents, _scores_of(made))
    print(_head(options, task, made), "\n".join([table, *notes]), sep="")
    return failed


def _reports(
    options: EvaluateOptions, about: dict[str, Any], made: Mapping[str, Made]
) -> list[dict[str, Any]]:
    """Return each agent's scores, or an entry `error` with the reason that it has none."""
    from swarm_envs.agents.evaluation import score_episodes
    from swarm_envs.training.flights import fly_flights

    found: dict[str, dict[str, Any]] = {name: {"agent": name} for name in made}
    flights: dict[str, tuple[Flight, EpisodeFile | None]] = {}
    for name, each in made.items():
        if isinstance(each, BaseException):
            found[name]["error"] = f"cannot be loaded: {type(each).__name__}: {each}"
            continue
        agent, env = each
        rate = env.core.config.decision_rate
        found[name] |= {"privileged": agent.privileged, "decision_rate": rate}
        try:
            flight = _flight(name, agent, env, options)
            flights[name] = flight, _open_episodes(flight, options, about)
        except ValueError as error:
            found[name]["error"] = str(error)
    flown = fly_flights([*flights.values()], options.scale)
    for name, (episodes, why, trace) in zip(flights, flown, strict=True):
        found[name] |= {"error": why} if why else score_episodes(episodes, _scores_of(made))
        sys.stderr.write(trace)
    return [*found.values()]


def _flight(name: str, agent: Agent, env: SwarmParallelEnv, options: EvaluateOptions) -> Flight:
    """Return the episodes of an agent."""
    from swarm_envs.agents.evaluation import TIMED, frozen_seeds, source_digest
    from swarm_envs.agents.protocol import flies_batches
    from swarm_envs.training.flights import Flight

    return Flight(
        agent=name,
        digest=source_digest(agent, name),
        task=find_task(options.task),
        setting=options.setting(),
        seeds=frozen_seeds(options.seed, options.episodes),
        timed=TIMED,
        batched=flies_batches(env, agent),
    )


def _open_episodes(
    flight: Flight, options: EvaluateOptions, about: dict[str, Any]
) -> EpisodeFile | None:
    """Return the file that stores an agent's episodes; None if they are not stored."""
    from swarm_envs.agents.evaluation import EpisodeFile

    if options.out is None:
        return None
    depends = {"task": about["task"], "setting": options.setting()}
    depends |= {"agent": flight.agent, "source": flight.digest, "version": __version__}
    own = {name: file_digest(str(getattr(options, name))) for name in ("task", "interactions")}
    depends |= {f"file of {name}": digest for name, digest in own.items() if digest}
    file = EpisodeFile(options.out / "episodes", flight.agent, depends)
    if before := sum(seed in file.episodes for seed in flight.seeds):
        print(f"{flight.agent}: resumes after {before} of {options.episodes} episodes", flush=True)
    return file


def _head(options: EvaluateOptions, task: str, made: Mapping[str, Made]) -> str:
    """Return the line above the table: task, team, given options, number of episodes and seed."""
    cores = [each[1].core for each in made.values() if isinstance(each, tuple)]
    words = [task, *(team_text(core.task.team) for core in cores[:1])]  # the same for all
    words += options.conditions(any(core.config.hall is not None for core in cores))
    words += [f"{options.episodes} episodes", f"seed {options.seed}"]
    return "\n" + ", ".join(words) + "\n"


def _scores_of(made: Mapping[str, Made]) -> tuple[str, ...]:
    """Return the name of the score of the task, if it has one."""
    tasks = [each[1].core.task for each in made.values() if isinstance(each, tuple)]
    return tasks[0].score_names[:1] if tasks else ()


def _table(agents: list[dict[str, Any]], scores: tuple[str, ...]) -> str:
    """Return the reports as a table; a column that is empty for all agents is left out."""
    from swarm_envs.agents.evaluation import OF_SUCCESSES
    from swarm_envs.training.scoreboard.summary import align_columns

    known = [report for report in agents if "error" not in report]
    columns = {**{name: name for name in scores}, **_COLUMNS}
    shown = {n: head for n, head in columns.items() if any(r.get(n) is not None for r in known)}
    heads = ("agent", "success (95 %)", "crashed", "near miss", *shown.values(), "decision, ms")
    lines = align_columns([heads, *(_row(report, [*shown]) for report in known)])
    lines += [f"{r['agent']} FAILED: {r['error']}" for r in agents if "error" in r]
    if any(report.get("privileged") for report in agents):
        lines.append("* sees the true state of the simulation")
    if shown:
        of = {True: "successes", False: "all episodes"}
        means = [f"{head} (of {of[n in OF_SUCCESSES]})" for n, head in shown.items()]
        lines.append(f"interquartile means, with intervals in --json: {'; '.join(means)}")
    if known:
        lines.append("decision: median (99th percentile) time per decision of the whole team")
    return "\n" + "\n".join(lines)


_COLUMNS = {
    "time_to_goal_s": "time to goal, s",
    "worst_height_error_m": "worst height error, m",
    "throughput_per_min": "goals per minute",
    "share_on_goal": "share on goal",
    "gates_per_min": "gates per minute",
    "energy_j": "energy, J",
    "mean_return": "return per drone",
}
"""Fields of a report and their column headings, in the order of the table."""


def _row(report: dict[str, Any], shown: list[str]) -> tuple[str, ...]:
    low, high = report["intervals"]["success_rate"]
    numbers = [(report.get(name), 3 if name.endswith("_m") else 2) for name in shown]
    return (
        report["agent"] + ("*" if report["privileged"] else ""),
        f"{report['success_rate']:.1%} ({100 * low:.0f}-{100 * high:.0f})",
        f"{report['collision_rate']:.1%}",
        f"{report['near_miss_rate']:.1%}",
        *("-" if value is None else f"{value:.{digits}f}" for value, digits in numbers),
        f"{report['act_ms']['p50']:.2f} ({report['act_ms']['p99']:.2f})",
    )
