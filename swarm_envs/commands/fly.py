"""`swarm-envs fly`: one episode, its metrics, its trajectory, its replay page and its film."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from swarm_envs import TASKS, __version__, task_family
from swarm_envs.commands.checks import (
    Misuse,
    as_misuse,
    check_file,
    output_files,
)
from swarm_envs.envs.config import MOST_DRONES, MOST_OBSERVED
from swarm_envs.envs.options import blueprint_of, default_of, options_type, task_class
from swarm_envs.envs.randomization import Randomization
from swarm_envs.envs.setting import WorldOptions
from swarm_envs.errors import check_integer, check_name, check_number, unknown_name
from swarm_envs.files import write_json
from swarm_envs.tasks.obstacles import parse_obstacles
from swarm_envs.user_files import users_traceback
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Team, parse_team, team_string

if TYPE_CHECKING:
    from swarm_envs.agents import Agent
    from swarm_envs.envs.options import Blueprint
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.viewing.record import Recording

_FILES = {
    "json": ("flight.json", ".json"),
    "trajectory": ("trajectory.parquet", ".parquet", ".npz"),
    "replay": ("replay.html", ".html"),
}
"""Files that `--out` writes: by option, the file's name and the allowed suffixes."""
_GOOD_HEIGHT_M = 0.05
"""The height error of compensated rings in Neural-Swarm2, Fig. 9, m."""


@dataclass(frozen=True, kw_only=True)
class EpisodeFields:
    """The main options of an episode, which come first in the help."""

    task: str = "swap"
    """Task: swap, ring, formation, columns, delivery, gates, pursuit or crowd, optionally with a
    version, such as `swap_v1`; or a custom task, path/to/file.py:Class."""
    layout: str | None = None
    """Layout of the task, such as `random` or `stacked`. If None, the task's default."""
    drones: int | None = None
    """Number of drones, unless --team is given. If None, 4 in swap, ring and formation, and the
    task's default otherwise."""
    physics: str | None = None
    """Physics engine, `bullet` or `batch`. If None, Bullet if it is installed."""
    interactions: str = "learned"
    """Model of the aerodynamic forces, between drones and from the ground: `none`, `wake`,
    `learned`, `deep-set`, a weights file, or path/to/file.py:function."""
    horizon_s: float | None = None
    """Time limit of an episode, s. If None, the task's default."""


@dataclass(frozen=True, kw_only=True)
class EpisodeOptions(WorldOptions, EpisodeFields):
    """Options of the episodes of `fly` and `evaluate`."""

    team: str | None = None
    """Vehicle types of the team, such as `LLSS`, instead of a number of drones: S is small, L is
    large, S* is small with strong motors. A 2 only separates letters; in stacked layouts, `L2S`
    is L above S."""
    neighbors: int | None = None
    """Number of nearest neighbors that each drone observes. If None, the task's default."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid or contradictory options."""
        if self.drones is not None:
            check_integer("--drones", self.drones, at_least=1, at_most=MOST_DRONES)
        if self.neighbors is not None:
            check_integer("--neighbors", self.neighbors, at_least=0, at_most=MOST_OBSERVED)
        if self.horizon_s is not None:
            check_number("--horizon-s", self.horizon_s, above=0.0, unit="s")
        Randomization.of(self.randomization)
        if self.obstacles is not None:
            parse_obstacles(self.obstacles)
        if self.layout is not None:
            check_layout(find_task(self.task), self.layout)
        if self.team is None or self.drones is None:
            return
        if (count := len(parse_team(self.team))) != self.drones:
            raise ValueError(
                f"--drones is {self.drones}, but --team {self.team} has {count}; give one of them"
            )

    def setting(self) -> dict[str, Any]:
        """Return the options of the environment that were given, ready for JSON."""
        drones = self.drones
        if drones is None and task_family(self.task) in ("swap", "ring", "formation"):
            drones = 4
        team = {"num_drones": drones} if self.team is None else {}
        names = ("layout", "physics", "interactions", "force_rate", "horizon_s")
        given = {**team, **{name: getattr(self, name, None) for name in names}}
        given |= {"team": self.team, "num_neighbors": self.neighbors}
        return {
            name: value for name, value in given.items() if value is not None
        } | self.world_options()

    def conditions(self, in_hall: bool) -> list[str]:
        """Return the options of the environment, besides the team, that are not the defaults.

        `in_hall` is True if the world is the hall, which is always among them.
        """
        usual = type(self)().setting().items()
        given = dict(each for each in self.setting().items() if each not in usual)
        given |= {"world": "hall"} if in_hall else {}
        hidden = ("team", "num_drones")
        return [f"{name} {value}" for name, value in given.items() if name not in hidden]


@dataclass(frozen=True, kw_only=True)
class FlyOptions(EpisodeOptions):
    """Fly one episode, print its key figures, and write the requested files.

    The output has the task with the given options, the outcome, and four figures. Goals: when the
    last drone arrived for good, or how many sets of goals all drones reached, or the score of a
    task whose goals continue; success needs half a second at the goals. Distance: the smallest
    distance between two drones; a near miss is one below 1.5 times that of contact, without a
    contact. Force: the largest aerodynamic force on a drone, from other drones or the ground, in
    grams (1 g is 9.81 mN), and the thrust reserve, by which the weakest drone can exceed its
    weight; a drone sinks under a larger force. Height: the largest error of height to the
    reference, in tasks that have one; at most 5 cm is as good as the flights of Neural-Swarm2. All
    metrics are in the file of --json. A crash is a valid result, with exit status 0.
    """

    agent: str | None = None
    """Agent that controls the drones. If None, the best agent of the benchmark for the task. Simple
    baselines: hover, random, straight-line. Scripted collision avoidance: fast-line, orca,
    roundabout. Planners: detour, mlr-dmpc, rth3d (each also with +compensated) and
    neural-swarm-planner. Tracking of moving references: tracking (also with +compensated, +adaptive
    or both, in this order). Precise flight in downwash: pid (also with +adaptive), downwash-aware,
    heavy-on-top. Trained policies: swap-dagger, gates-dagger, pursuit-dagger, crowd-dagger,
    stack-dagger, mixed-dagger, sprint-dagger, delivery-dagger, ring-dagger, swap-ppo. Custom
    agents: the folder of a trained policy, path/to/file.py:Class, or path/to/file.py:function,
    which maps observation rows to actions. The last suffix, +filter, adds a safety filter."""
    seed: int = 0
    """Random seed of the episode and the agent."""
    out: Path | None = None
    """Output folder for flight.json, trajectory.parquet (.npz without pyarrow) and replay.html."""
    video: Path | None = None
    """Write a video to this file, .mp4 (needs ffmpeg) or .gif."""
    replay: Path | None = None
    """Write a replay page for web browsers to this file, .html."""
    trajectory: Path | None = None
    """Write positions, forces, rewards and more to this file, .parquet or .npz."""
    json: Path | None = None
    """Write metrics and events to this file, .json."""

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid seed, or invalid options of the episode."""
        super().__post_init__()
        check_integer("--seed", self.seed, at_least=0)


def run_fly(options: FlyOptions) -> None:
    """Fly an episode, print its summary, and write the requested files."""
    from swarm_envs.agents.recommendation import avoids_obstacles
    from swarm_envs.envs.parallel import SwarmParallelEnv

    files = output_files(options, _FILES)
    if options.video is not None:
        check_file("--video", options.video, (".mp4", ".gif"))
        files["video"] = options.video
    if options.trajectory is None and "trajectory" in files and find_spec("pyarrow") is None:
        files["trajectory"] = files["trajectory"].with_suffix(".npz")
    _check_writers(files)
    with as_misuse(TypeError, FileNotFoundError):
        task = find_task(options.task)
        blueprint_of(task, **options.setting())  # refuses options whatever the agent
        name = best_agent(options, task) if options.agent is None else options.agent
        try:
            agent, blueprint = prepare(name, options, task)
        except ValueError as error:
            raise ValueError(cannot_fly(name, error)) from error
        env = SwarmParallelEnv(*blueprint)
    with closing(env):
        recording = _fly(env, agent, name, options)
        reserve_g = _least_reserve_g(env)
    _print_summary(recording, options, blueprint, reserve_g)
    for note in training_notes({name: agent}, options):
        print(note)
    if agent.privileged:
        limited = blueprint.config.communicates
        more = "; limits of communication hold for observations only" if limited else ""
        print(f"note: this agent sees the true state{more}")
    if options.obstacles and options.agent is None and not avoids_obstacles(agent):
        print(f"note: {name} was measured without obstacles, and may fly into them")
    _write_files(files, recording, options)


def _check_writers(files: Mapping[str, Path]) -> None:
    """Raise ImportError if pyarrow or ffmpeg is missing for a file."""
    if "trajectory" in files:
        from swarm_envs.viewing.trajectory import check_trajectory_path

        check_trajectory_path(files["trajectory"])
    if "video" in files and files["video"].suffix == ".mp4":
        from swarm_envs.viewing.video import find_ffmpeg

        find_ffmpeg()


def prepare(name: str, options: EpisodeOptions, task: str) -> tuple[Agent, Blueprint]:
    """Return an agent, and the blueprint of the environment that it requires.

    An included agent refuses tasks and teams here, before an environment compiles kernels.
    """
    from swarm_envs.agents import load
    from swarm_envs.agents.protocol import check_options_agree, check_task

    agent, given = load(name), options.setting()
    check_options_agree(agent, given)
    blueprint = blueprint_of(task, **{**given, **agent.requires})
    try:
        if ":" not in name:
            check_task(agent, blueprint.task)
    except ValueError as error:
        raise Misuse(_refusal(name, error, options, blueprint.task.name)) from error
    return agent, blueprint


def check_flies(
    name: str, agent: Agent, env: SwarmParallelEnv, options: EpisodeOptions, seed: int
) -> None:
    """Raise Misuse if an included agent or a policy refuses this task or team in `reset`.

    Agents from a user's file are not checked: their errors are reported in flight.
    """
    from swarm_envs.agents.policy import PolicyAgent

    if ":" in name:
        return
    if not isinstance(agent, PolicyAgent):  # which asks for no state, so nothing is compiled
        with as_misuse(RuntimeError):  # obstacles that leave no place to start
            env.reset(seed=seed)
    try:
        agent.reset(env, seed)
    except ValueError as error:
        raise Misuse(_refusal(name, error, options, env.core.task.name)) from error


def find_task(name: str) -> str:
    """Return the versioned name of a task, the newest if the name has no version."""
    if ".py:" in name:  # a task of one's own
        task_class(name)
        return name
    if name.endswith(".py"):
        raise ValueError(f"--task is {name!r}, but must name a class too: {name}:ClassName")
    families = _newest()
    return families.get(name) or check_name("task", name, (*families, *TASKS))


def _newest() -> dict[str, str]:
    """Return the newest version of every task, by its family."""
    return {task_family(task): task for task in sorted(TASKS)}


def check_layout(task: str, layout: str) -> None:
    """Raise ValueError, naming the tasks that have it, if a task does not have a layout."""
    valid, family = task_class(task).layouts, task_family(task)
    if layout in valid:
        return
    message = f"--layout is {layout!r}, but task {family!r} has no layouts; leave it out"
    if valid:
        message = unknown_name("layout", layout, valid, f"of task {family!r}")
    newest = _newest().items()
    others = [other for other, name in newest if layout in task_class(name).layouts]
    raise ValueError("; ".join([message, *(f"--task {other} has {layout!r}" for other in others)]))


def best_agent(options: EpisodeOptions, task: str) -> str:
    """Return the recommended agent for a task with these options."""
    from swarm_envs.agents import recommended

    if ".py:" in task:
        raise ValueError("no agent is recommended for a custom task; name one, as --agent orca")
    setting = options.setting()
    drones = len(blueprint_of(task, **setting).task.team)
    try:
        return recommended(
            task,
            num_drones=drones,
            team=options.team,
            layout=options.layout,
            obstacles="obstacles" in setting,
            world=options.world,
        )
    except ValueError as error:
        raise ValueError(f"{error}; name one by --agent") from error


class _FlightBar:
    """Progress bar of decisions that begins after the first, which may plan and compile."""

    def __init__(self, total: int) -> None:
        self._total = total
        self.began = False
        """True after the reset of the environment and the agent."""
        self.bar: Any = None
        """The tqdm bar; None before the first decision."""

    def __call__(self, *_: object) -> None:
        """Count a decision; the first call follows the reset."""
        if not self.began:
            self.began = True
        elif self.bar is None:
            given: dict[str, Any] = {"desc": "flight", "unit": "decision", "mininterval": 0.5}
            self.bar = tqdm(total=self._total, initial=1, **given)
        else:
            self.bar.update()

    def close(self) -> None:
        """Close the bar."""
        if self.bar is not None:
            self.bar.close()


def _fly(env: SwarmParallelEnv, agent: Agent, name: str, options: FlyOptions) -> Recording:
    from swarm_envs.agents import record_episode

    bar = _FlightBar(env.core.most_decisions)
    try:
        recording = record_episode(env, agent, options.seed, watch=bar, name=name)
        bar.bar.total = bar.bar.n  # it may have ended before the time limit
        return recording
    except Exception as error:
        if isinstance(error, RuntimeError) and not bar.began and not env.agents:
            raise Misuse(str(error)) from error  # obstacles that leave no place to start
        own = any(".py:" in str(each) for each in (name, options.task, options.interactions))
        if not own and not bar.began and isinstance(error, ValueError):
            raise Misuse(_refusal(name, error, options, env.core.task.name)) from error
        sys.stderr.write(users_traceback(error))
        where = f"the episode of seed {options.seed}, flown by agent {name!r}, failed"
        raise ValueError(f"{where}: {type(error).__name__}: {error}") from error
    finally:
        bar.close()


def cannot_fly(name: str, error: Exception) -> str:
    """Return the message of an error with the name of the agent."""
    message = str(error)
    return message if repr(name) in message else f"agent {name!r} cannot fly: {message}"


def _refusal(name: str, error: ValueError, options: EpisodeOptions, task: str) -> str:
    """Return why an agent cannot fly a task, and which agent can, if there is one."""
    from swarm_envs.agents import load
    from swarm_envs.agents.recommendation import avoids_obstacles

    message = cannot_fly(name, error)
    try:
        best = best_agent(options, task)
    except ValueError:
        return message
    if best == name:
        return message
    agent = load(best)
    about = ["sees the true state"] if agent.privileged else []
    if options.obstacles and not avoids_obstacles(agent):
        about.append("was measured without obstacles")
    return f"{message}; try --agent {best}{', which ' if about else ''}{' and '.join(about)}"


_LETTERS = 16  # Drones up to which a team is written out


def team_text(team: Team) -> str:
    """Return the string of a team, or its size if the string is long."""
    return f"team {team_string(team)}" if len(team) <= _LETTERS else f"{len(team)} drones"


_CONDITIONS = ("world", "randomization", "observe_range_m", "observe_delay_s", "observe_loss")
"""Options of `WorldOptions` with which a policy may be trained on purpose, and flown without."""
_SAME_EPISODE = ("physics", "threads")  # Options that leave episodes as they are


def training_notes(agents: Mapping[str, Agent], options: EpisodeOptions) -> list[str]:
    """Return a note for each policy that was trained with other interactions or options."""
    kinds = fields(options_type(find_task(options.task)))
    usual = {each.name: default_of(each) for each in kinds}
    notes, here = [], usual | options.setting()
    for name, agent in agents.items():
        if (trained := _trained_with(agent)) is None:
            continue
        names = {*trained, *options.env_options(), *_CONDITIONS}
        names -= {*agent.requires, *_SAME_EPISODE}
        there = usual | trained
        differ = sorted(each for each in names if not _same(there.get(each), here.get(each)))
        if differ:
            theirs, ours = (
                ", ".join(f"{each}={_shown(given.get(each))}" for each in differ)
                for given in (there, here)
            )
            notes.append(f"note: {name} was trained with {theirs}, but flies with {ours}")
    return notes


def _shown(value: object) -> object:
    """Return a value for a note; None stands for the default of the task."""
    return "default" if value is None else value


def _same(one: object, other: object) -> bool:
    """Return True for equal values; a default may be a tuple, which is a list in JSON."""
    one, other = (list(each) if isinstance(each, tuple) else each for each in (one, other))
    return one == other


def _trained_with(agent: Agent) -> dict[str, Any] | None:
    """Return the interactions, conditions and `--env` of a policy's training; None if unknown."""
    from swarm_envs.agents.policy import PolicyAgent
    from swarm_envs.agents.safety import SafetyFilter

    pilot = agent.agent if isinstance(agent, SafetyFilter) else agent
    if not isinstance(pilot, PolicyAgent):
        return None
    try:
        config = pilot.policy.provenance["config"]
        given = WorldOptions(env=tuple(config["env"])).env_options()
        given |= {name: config[name] for name in _CONDITIONS if config.get(name) is not None}
        return {"interactions": config["interactions"], **given}
    except (KeyError, TypeError, ValueError, AttributeError):  # of another program, or damaged
        return None


def _least_reserve_g(env: SwarmParallelEnv) -> float:
    """Return by how much the weakest drone of this episode can exceed its weight, grams."""
    drones = env.core.world.drones[0]
    reserve_n = 4.0 * drones["max_rotor_thrust"] - drones["mass"] * GRAVITY
    return float(reserve_n.min()) / GRAM_FORCE


def _print_summary(
    recording: Recording, options: FlyOptions, blueprint: Blueprint, reserve_g: float
) -> None:
    from swarm_envs.viewing.summary import outcome

    about, metrics = recording.about, recording.about.metrics
    in_hall, scores = blueprint.config.hall is not None, blueprint.task.score_names[:1]
    flown = [about.task, team_text(recording.team), *options.conditions(in_hall)]
    print(", ".join([*flown, f"agent {about.agent}", f"seed {about.seed}"]))
    print(outcome(recording))
    if goals := _goals_text(metrics, len(recording.team)):
        print(f"  Goals     {goals}")
    for name in scores if ":" in options.task else ():  # of a custom task
        print(f"  Score     {name} {metrics[name]:g}")
    if metrics["minimum_separation_m"] is not None:
        misses = metrics["near_misses"]
        text = "no near miss" if not misses else f"near misses of {misses} drones"
        print(f"  Distance  {metrics['minimum_separation_m']:.3f} m at the closest; {text}")
    print(f"  Force     {metrics['worst_force_g']:.1f} g at most; thrust reserve {reserve_g:.1f} g")
    if (height := metrics["worst_height_error_m"]) is not None:
        verdict = "good, at most" if height <= _GOOD_HEIGHT_M else "large, above"
        limit = f"{verdict} {100 * _GOOD_HEIGHT_M:.0f} cm"
        print(f"  Height    {100 * height:.1f} cm from the reference at worst; {limit}")


def _goals_text(metrics: Mapping[str, Any], drones: int) -> str:
    """Return the score of a task whose goals continue, or when all arrived; "" in ring."""
    if "throughput_per_min" in metrics:
        return f"{metrics['throughput_per_min']:.1f} a minute for each drone"
    if "gates_per_min" in metrics:
        return f"{metrics['gates_per_min']:.1f} gates a minute for each drone"
    if "share_on_goal" in metrics:
        return f"{metrics['share_on_goal']:.0%} of the time near the moving goals"
    if metrics["time_to_goal_s"] is not None:
        who = f"all {drones} drones, the last" if drones > 1 else "the drone,"
        return f"{who} after {metrics['time_to_goal_s']:.2f} s"
    if metrics["success"]:
        return ""
    return f"{metrics['stages_reached']} of {metrics['stages']} sets of goals reached by all drones"


def _write_json(path: Path, recording: Recording, options: FlyOptions) -> None:
    from swarm_envs.viewing.summary import events, outcome

    about = recording.about
    content = {
        "task": about.task,
        "team": team_string(recording.team),
        **{n: getattr(about, n) for n in ("agent", "seed", "physics", "decision_rate")},
        "options": options.setting(),
        "outcome": outcome(recording),
        "events": [
            {"time_s": event.time, "kind": event.kind, "drones": list(event.drones)}
            for event in events(recording)
        ],
        "metrics": dict(about.metrics),
        "version": __version__,
    }
    write_json(path, content)


def _write_video(path: Path, recording: Recording) -> None:
    from swarm_envs.viewing.video import FPS, VideoError, count_frames, film, write_gif, write_video

    total = count_frames(recording)
    frames = tqdm(film(recording), total=total, desc="video", unit="frame", mininterval=0.5)
    write = write_gif if path.suffix == ".gif" else write_video
    try:
        write(path, frames, FPS)
    except VideoError as error:
        raise OSError(f"{error}; name the video .gif, which needs no ffmpeg") from error


def _write_files(files: Mapping[str, Path], recording: Recording, options: FlyOptions) -> None:
    """Write a recording into files, by their options, and print their names."""
    from swarm_envs.viewing import write_replay, write_trajectory

    for option, path in files.items():
        if option == "json":
            _write_json(path, recording, options)
        elif option == "trajectory":
            write_trajectory(path, recording)
        elif option == "replay":
            write_replay(path, recording)
        else:
            _write_video(path, recording)
        hint = "; open it in a browser" if option == "replay" else ""
        print(f"wrote {path}{hint}", flush=True)
