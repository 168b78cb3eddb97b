"""Options of a training run: readable where torch is not installed."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from swarm_envs.envs.setting import WorldOptions
from swarm_envs.errors import (
    check_bool,
    check_divisor,
    check_integer,
    check_name,
    check_number,
    check_numbers,
)
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.vehicles import parse_team

__all__ = ["RlConfig"]

Encoder = Literal["mlp", "deep-set"]
Action = Literal["acceleration", "velocity", "ctbr", "rotors"]
DAGGER = "dagger"  # The algorithm of `--dagger.*`; others are Stable-Baselines3's
_COUNTS = (
    *("steps", "environments", "threads", "num_neighbors"),
    *("checkpoint_rollouts", "evaluations", "evaluation_episodes"),
)
"""Options that are positive integers."""
ALGORITHMS = ("ppo", "sac", "td3", DAGGER)  # those that need no import path


_TYPED = {"num_neighbors": "neighbors"}  # Fields that the command line calls otherwise


def _option(name: str) -> str:
    return f"--{_TYPED.get(name, name).replace('_', '-')}"


@dataclass(frozen=True)
class DaggerConfig:
    """Options of `--algo dagger`: the teachers, and the gradient steps."""

    teacher: tuple[str, ...] = ("roundabout",)
    """the teachers: names or files of agents, which may be privileged, each optionally after a
    layout, a number of drones or both, such as `circle=NAME` or `random,16=NAME`; the last that
    fits a team teaches it"""
    train_freq: int = 10
    """decisions of each drone between two rounds of gradient steps"""
    gradient_steps: int = 12
    """gradient steps of a round; each takes a batch from all that is remembered"""
    batch_size: int = 1024
    """decisions per gradient step"""
    learning_rate: float = 2e-3
    """learning rate of Adam at the start; it falls as a cosine"""
    last_rate: tyro.conf.Suppress[float] = 0.02
    """final learning rate, as a share of the initial one"""
    buffer_size: int = 400_000
    """size of the replay buffer in decisions of single drones; checkpoints contain it"""
    guided: float = 0.125
    """share of the run during which the teacher flies too; its share of the decisions falls from 1
    to 0"""
    noise: tyro.conf.Suppress[float] = 0.1
    """standard deviation of noise on the actions of a third of the environments"""
    avoiding: float = 3.0
    """weight of decisions in which other drones change the teacher's action; others have 1"""
    huber: tyro.conf.Suppress[float] = 0.1
    """error of an action from which on the loss grows linearly"""

    def __post_init__(self) -> None:
        """Refuse numbers with which nothing is learned."""
        for name in ("train_freq", "gradient_steps", "batch_size", "buffer_size"):
            check_integer(_option(f"dagger.{name}"), getattr(self, name), at_least=1)
        for name in ("learning_rate", "last_rate"):
            check_number(_option(f"dagger.{name}"), getattr(self, name), at_least=1e-7, at_most=1.0)
        for name in ("guided", "noise"):
            check_number(_option(f"dagger.{name}"), getattr(self, name), at_least=0.0, at_most=1.0)
        check_number("--dagger.avoiding", self.avoiding, at_least=0.0, at_most=100.0)
        check_number("--dagger.huber", self.huber, at_least=1e-3, at_most=10.0)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What is trained, and where it is kept: these come first in the help."""

    out: Path
    """folder of the run: policy.safetensors, progress.csv, report.json, checkpoints, event files"""
    task: str = "swap"
    """the task, such as `swap`, or with its version, `swap_v1`; or path/to/file.py:Class"""
    layout: str | None = None
    """the layout of the task; default: `random` for swap (half of the episodes are crowded, a
    quarter on the circle; or `circle`), `shuffle` for formation (or `cube`, `tour`), `stack` for
    columns (or `sprint`), `all` for pursuit and crowd, by DAgger"""
    algo: str = "ppo"
    """the algorithm: `ppo`, `sac` or `td3` of Stable-Baselines3, the import path of another of its
    algorithms or of sb3-contrib's, such as `sb3_contrib.TQC`, or `dagger`, which imitates another
    agent where the policy itself has flown; one policy flies all drones"""
    start: str | None = None
    """a trained policy, by name, file or folder, from which DAgger begins"""
    drones: int | tuple[int, ...] = 4
    """number of drones; of several numbers, such as `4 8`, each has an equal share of the
    environments; the policy will fly in teams from the smallest to the largest"""
    fewest: int | None = None
    """smallest team in which the policy will fly; that of its training if not given"""
    most: int | None = None
    """largest team in which the policy will fly; that of its training if not given"""
    team: tuple[str, ...] = ()
    """the vehicles, such as `SSLL`, one team or more; overrides --drones"""
    steps: int = 3_000_000
    """decisions of single drones, rounded up to whole rollouts"""
    seed: int = 0
    """random seed of initial weights, episodes and exploration; the same seed gives the same
    policy"""
    json: Path | None = None
    """write the report to this file too"""


@dataclass(frozen=True, kw_only=True)
class RlConfig(WorldOptions, RunOptions):
    """Train one policy for all drones by Stable-Baselines3, or by DAgger from a teacher.

    Interrupted or killed at any moment, the same command resumes from the last checkpoint. A
    finished run is not overwritten.
    """

    set: tuple[str, ...] = ()
    """arguments of the algorithm of Stable-Baselines3, as NAME=VALUE, such as `learning_rate=3e-4
    n_steps=64`, in place of the defaults that docs/rl.md lists"""
    environments: int = 128
    """teams that fly at once, of all sizes together"""
    threads: int = 2
    """threads of the environments, which do not change the policy"""
    encoder: Encoder = "mlp"
    """how neighbors are encoded: `mlp`, one after another, nearest first; `deep-set`, each with
    the drone's own features through a small network, then pooled"""
    hidden: tuple[int, ...] = (64, 64)
    """widths of the hidden layers of the actor"""
    set_hidden: tuple[int, ...] = (32, 32)
    """widths of the network to which a deep set gives each neighbor"""
    horizon_s: float | None = None
    """time limit of an episode in training, s; default: the task's"""
    action: Action = "acceleration"
    """what the policy's numbers mean: set-points' `acceleration` or `velocity`, collective thrust
    and body rates (`ctbr`), or each of the `rotors`; it will fly with this one alone"""
    decision_rate: int = 10
    """decisions per second, in training and in flight"""
    force_rate: tyro.conf.Suppress[int] = 48
    """evaluations of the interaction force per second in training"""
    num_neighbors: Annotated[int, tyro.conf.arg(name=_TYPED["num_neighbors"])] = 3
    """K, the number of observed neighbors"""
    num_obstacles: int | None = None
    """M, the number of observed obstacles; default: 3 where there are any"""
    observe_load: bool | None = None
    """observe thrust margins, masses and charges; default: the task's"""
    observe_force: bool = False
    """observe the force that the shipped belief predicts for the drone"""
    observe_setpoint: bool = False
    """observe velocity and acceleration of the set-point, which are exact where the drone's own
    velocity is noisy"""
    controller: str | None = None
    """the shipped agent whose tracking controller flies the policy's set-points, such as
    `downwash-aware`; the default controller if not given"""
    interactions: str = "learned"
    """interaction forces: `none`, `wake`, `learned`, a weights file or path/to/file.py:function"""
    proximity: tyro.conf.Suppress[tuple[float, float]] = (4.0, 2.0)
    """cost of being near another drone, before and after 37 % of the steps; too much for too long,
    and drones hover next to their goals"""
    checkpoint_rollouts: int = 100
    """rollouts between two checkpoints of DAgger"""
    evaluations: int = 5
    """number of evaluations, evenly spread; the last one is at the end"""
    evaluation_episodes: int = 256
    """episodes of an evaluation, on each layout, on seeds that are the same in every run and never
    trained on; the policy that does best on them is kept"""
    progress: bool = True
    """show a progress bar"""
    dagger: DaggerConfig = DaggerConfig()
    """only with `--algo dagger`"""

    def __post_init__(self) -> None:
        """Refuse numbers out of range, and options that do not fit each other."""
        self._check_numbers()
        self._check_teams()
        self._check_belongs()
        self._check_sizes()

    def _check_numbers(self) -> None:
        for name in _COUNTS:
            check_integer(_option(name), getattr(self, name), at_least=1)
        check_integer("--seed", self.seed, at_least=0)
        if self.num_obstacles is not None:
            check_integer("--num-obstacles", self.num_obstacles, at_least=0)
        for name in ("decision_rate", "force_rate"):
            check_divisor(_option(name), getattr(self, name), PHYSICS_RATE)
        if self.horizon_s is not None:
            check_number("--horizon-s", self.horizon_s, at_least=0.2, at_most=1000.0, unit="s")
        check_numbers("--proximity", self.proximity, 2, at_least=0.0)
        for count in self._counts:
            check_integer("--drones", count, at_least=1)
        for name in ("hidden", "set_hidden"):
            widths = getattr(self, name)
            if not isinstance(widths, tuple) or not widths:
                raise ValueError(f"{_option(name)} is {widths!r}, but must be one or more widths")
            for width in widths:
                check_integer(_option(name), width, at_least=1)
        check_name("--encoder", self.encoder, get_args(Encoder))
        check_name("--action", self.action, get_args(Action))
        for name in ("observe_force", "observe_setpoint", "progress"):
            check_bool(_option(name), getattr(self, name))

    def _check_teams(self) -> None:
        given = {*self._counts}
        if self.team and given != {RunOptions.drones} and given != {*self.team_sizes}:
            raise ValueError(
                f"--drones is {self.drones}, but --team {' '.join(self.team)} has "
                f"{', '.join(map(str, self.team_sizes))}; give one of them"
            )
        named = [str(team) for team in self.teams]
        if not named or len({*named}) < len(named):
            raise ValueError(
                f"--drones is {self.drones} and --team {self.team}; name teams, each once"
            )
        if self.fewest is not None and not 1 <= self.fewest <= min(self.team_sizes):
            raise ValueError(
                f"--fewest is {self.fewest}, but must be from 1 to {min(self.team_sizes)}, the "
                "smallest team that is trained"
            )
        if self.most is not None and self.most < max(self.team_sizes):
            raise ValueError(
                f"--most is {self.most}, but must be at least {max(self.team_sizes)}, the largest "
                "team that is trained"
            )

    def _check_belongs(self) -> None:
        """Refuse algorithms that do not exist, and options that this one does not have."""
        if "." not in self.algo:
            check_name("--algo", self.algo, ALGORITHMS)
        foreign = ("set", "proximity") if self.imitates else ("start", "dagger")
        for option in fields(self):
            if option.name in foreign and getattr(self, option.name) != option.default:
                name = "--dagger.*" if option.name == "dagger" else _option(option.name)
                raise ValueError(f"{name} was given, but --algo {self.algo} has no such option")

    def _check_sizes(self) -> None:
        teams = len(self.team_sizes)
        if self.environments % teams:
            raise ValueError(
                f"--environments is {self.environments}, but must be a multiple of the {teams} "
                "teams that fly side by side"
            )
        if self.imitates and self.dagger.batch_size > self.dagger.buffer_size:
            raise ValueError(
                f"--dagger.batch-size is {self.dagger.batch_size}, but must be at most "
                f"{self.dagger.buffer_size}, the --dagger.buffer-size that it is drawn from"
            )

    @property
    def imitates(self) -> bool:
        """True if the algorithm is DAgger."""
        return self.algo == DAGGER

    @property
    def teams(self) -> tuple[dict[str, Any], ...]:
        """Every team that learns, as options of its environments."""
        if self.team:
            return tuple({"team": team} for team in self.team)
        return tuple({"num_drones": count} for count in self._counts)

    @property
    def team_sizes(self) -> tuple[int, ...]:
        """Number of drones of every team."""
        return tuple(len(parse_team(team)) for team in self.team) or self._counts

    @property
    def _counts(self) -> tuple[int, ...]:
        return self.drones if isinstance(self.drones, tuple) else (self.drones,)

    @property
    def decisions(self) -> int:
        """Decisions of single drones at one decision of all environments."""
        return self.environments // len(self.team_sizes) * sum(self.team_sizes)

    @property
    def rollouts(self) -> int:
        """Rollouts of a run of DAgger."""
        return math.ceil(self.steps / (self.decisions * self.dagger.train_freq))
