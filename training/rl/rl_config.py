"""Options of a training run; this module does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from swarm_envs.envs.setting import WorldOptions
from swarm_envs.errors import (
    check_integer,
    check_name,
    check_number,
)
from swarm_envs.vehicles import parse_team

__all__ = ["RlConfig"]

Encoder = Literal["mlp", "deep-set"]
Action = Literal["acceleration", "velocity", "ctbr", "rotors"]
DAGGER = "dagger"  # The algorithm of `--dagger.*`; others are Stable-Baselines3's
_COUNTS = (
    *("steps", "environments", "threads"),
    *("checkpoint_rollouts", "evaluations", "evaluation_episodes"),
)
"""Options that are positive integers."""
ALGORITHMS = ("ppo", "sac", "td3", DAGGER)  # Those that need no import path


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class DaggerConfig:
    """Options of `--algo dagger`: the teachers, and the gradient steps."""

    teacher: tuple[str, ...] = ("roundabout",)
    """Teachers: names or files of agents, which may observe the true state. A teacher may be
    restricted to a layout, a number of drones or both, such as `circle=NAME` or `random,16=NAME`;
    each team is taught by the last teacher that matches it."""
    train_freq: int = 10
    """Decisions of each drone in a rollout, which is followed by gradient steps."""
    gradient_steps: int = 12
    """Gradient steps after each rollout, each on a random batch from the replay buffer."""
    batch_size: int = 1024
    """Decisions of single drones per gradient step."""
    learning_rate: float = 2e-3
    """Initial learning rate of Adam; it is annealed along a cosine."""
    buffer_size: int = 400_000
    """Size of the replay buffer in decisions of single drones; checkpoints contain it."""
    guided: float = 0.125
    """Fraction of the run over which the probability that the teacher's action is executed falls
    from 1 to 0."""
    avoiding: float = 3.0
    """Loss weight of decisions in which other drones change the teacher's action; others have 1."""

    def __post_init__(self) -> None:
        """Raise ValueError if a number is out of range."""
        for name in ("train_freq", "gradient_steps", "batch_size", "buffer_size"):
            check_integer(_option(f"dagger.{name}"), getattr(self, name), at_least=1)
        check_number("--dagger.learning-rate", self.learning_rate, at_least=1e-7, at_most=1.0)
        check_number("--dagger.guided", self.guided, at_least=0.0, at_most=1.0)
        check_number("--dagger.avoiding", self.avoiding, at_least=0.0, at_most=100.0)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The main options of a run, which come first in the help."""

    out: Path
    """Folder of the run: policy.safetensors, progress.csv, report.json, checkpoints and event files
    of TensorBoard."""
    task: str = "swap"
    """Task, such as `swap`, or with a version, such as `swap_v1`; or path/to/file.py:Class."""
    layout: str | None = None
    """Layout of the task. If None: `random` for swap, `shuffle` for formation, `stack` for columns,
    and `all` for pursuit and crowd, which needs DAgger. Others are `circle`, `cube`, `tour` and
    `sprint`. Training on `random` of swap mixes starts that `evaluate` does not: half of the
    episodes are crowded, a quarter is on the circle."""
    algo: str = "ppo"
    """Algorithm: `ppo`, `sac` or `td3` of Stable-Baselines3; the import path of another algorithm
    of it or of sb3-contrib, such as `sb3_contrib.TQC`, or `file.py:Class` of your own; or `dagger`,
    which imitates a teacher in the states that the policy visits. All drones share one policy."""
    start: str | None = None
    """Name, file or folder of the trained policy from which DAgger starts. If None, the initial
    weights are random."""
    drones: int | tuple[int, ...] | None = None
    """Number of drones. With several numbers, such as `4 8`, each is used in an equal share of the
    environments. The policy supports teams from the smallest to the largest number. If None, the
    task's default team."""
    fewest: int | None = None
    """Size of the smallest team that the policy supports. If None, the smallest in training."""
    most: int | None = None
    """Size of the largest team that the policy supports. If None, the largest in training."""
    team: tuple[str, ...] = ()
    """Vehicle types of one or more teams, such as `SSLL`; they replace --drones."""
    steps: int = 3_000_000
    """Training steps, counted in decisions of single drones and rounded up to whole rollouts."""
    seed: int = 0
    """Random seed of the initial weights, episodes and exploration. The same seed gives the same
    policy."""
    json: Path | None = None
    """Also write the report to this file."""


@dataclass(frozen=True, kw_only=True)
class RlConfig(WorldOptions, RunOptions):
    """Train one policy for all drones with Stable-Baselines3, or with DAgger from a teacher.

    An interrupted or killed command resumes from the last checkpoint when it is run again. A
    complete run is not overwritten; with more --steps, one of Stable-Baselines3 continues.
    """

    set: tuple[str, ...] = ()
    """Arguments of the algorithm of Stable-Baselines3 as NAME=VALUE, such as `learning_rate=3e-4
    n_steps=64`; docs/rl.md lists the defaults."""
    environments: int = 128
    """Number of environments, of all teams together, that are simulated in parallel."""
    threads: int = 2
    """Number of threads that simulate the environments; it does not change the policy."""
    encoder: Encoder = "mlp"
    """Encoder of the neighbors: `mlp` concatenates their features, nearest first; `deep-set` passes
    each neighbor's features and the drone's own through a small network and pools the results."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of the actor."""
    set_hidden: tuple[int, ...] = (32, 32)
    """Widths of the hidden layers of the encoder `deep-set`."""
    horizon_s: float | None = None
    """Time limit of an episode in training, s. If None, the task's default."""
    action: Action = "acceleration"
    """Action space of the policy: `acceleration` or `velocity` of the set-point, collective thrust
    and body rates (`ctbr`), or the thrust of each rotor (`rotors`). The policy works with this
    action space only."""
    decision_rate: int = 10
    """Decisions per second, Hz, in training and afterwards."""
    num_neighbors: Annotated[int, tyro.conf.arg(name="neighbors")] = 3
    """Number of nearest neighbors that each drone observes."""
    num_obstacles: int | None = None
    """Number of nearest obstacles that each drone observes. If None, 3 if there are obstacles,
    else 0."""
    observe_load: bool | None = None
    """Observe thrust margins, masses and battery charges. If None, the task's default."""
    observe_force: bool = False
    """Observe the interaction force on the drone that the included controllers predict."""
    observe_setpoint: bool = False
    """Observe the velocity and acceleration of the set-point, which are exact even if the measured
    velocity is noisy."""
    controller: str | None = None
    """Included agent whose tracking controller follows the policy's set-points, such as
    `downwash-aware`. If None, the default controller."""
    interactions: str = "learned"
    """Model of the aerodynamic forces, between drones and from the ground: `none`, `wake`,
    `learned`, `deep-set`, a weights file, or path/to/file.py:function."""
    checkpoint_rollouts: int = 100
    """Number of rollouts between two checkpoints of DAgger."""
    evaluations: int = 5
    """Number of evaluations, evenly spaced; the last one is at the end of the training."""
    evaluation_episodes: int = 256
    """Episodes per evaluation and layout. Their seeds are the same in every run and never trained
    on; the policy that performs best on them is saved."""
    progress: bool = True
    """Show a progress bar."""
    dagger: DaggerConfig = DaggerConfig()
    """Options that apply to `--algo dagger` only."""

    def __post_init__(self) -> None:
        """Raise ValueError for numbers out of range and for contradictory options.

        Options of the environment are checked when it is made.
        """
        self._check_numbers()
        self._check_teams()
        self._check_belongs()
        self._check_sizes()

    def _check_numbers(self) -> None:
        for name in _COUNTS:
            check_integer(_option(name), getattr(self, name), at_least=1)
        check_integer("--seed", self.seed, at_least=0)
        for name in ("hidden", "set_hidden"):
            widths = getattr(self, name)
            if not isinstance(widths, tuple) or not widths:
                raise ValueError(f"{_option(name)} is {widths!r}, but must have at least one width")
            for width in widths:
                check_integer(_option(name), width, at_least=1)
        check_name("--encoder", self.encoder, get_args(Encoder))

    def _check_teams(self) -> None:
        if self.drones is None and not self.team:
            return  # checked with the task's default team
        if self.team and self.drones is not None and {*self._counts} != {*self.team_sizes}:
            raise ValueError(
                f"--drones is {self.drones}, but --team {' '.join(self.team)} has "
                f"{', '.join(map(str, self.team_sizes))}; give one of them"
            )
        named = [str(team) for team in self.teams]
        if not named or len({*named}) < len(named):
            raise ValueError(
                f"--drones is {self.drones} and --team is {self.team}, but they must name one or "
                "more teams, each once"
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
        """Raise ValueError if the algorithm does not exist or does not have a given option."""
        if "." not in self.algo:
            check_name("--algo", self.algo, ALGORITHMS)
        foreign = ("set",) if self.imitates else ("start", "dagger")
        for option in fields(self):
            if option.name in foreign and getattr(self, option.name) != option.default:
                name = "--dagger.*" if option.name == "dagger" else _option(option.name)
                needed = "one of Stable-Baselines3" if self.imitates else "--algo dagger"
                raise ValueError(
                    f"{name} was given, but --algo {self.algo} has no such option; use {needed}"
                )

    def _check_sizes(self) -> None:
        teams = max(len(self.team_sizes), 1)
        if self.environments % teams:
            raise ValueError(
                f"--environments is {self.environments}, but must be a multiple of {teams}, the "
                "number of teams"
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
        """The options of the environments of every team."""
        if self.team:
            return tuple({"team": team} for team in self.team)
        return tuple({"num_drones": count} for count in self._counts)

    @property
    def team_sizes(self) -> tuple[int, ...]:
        """The number of drones of every team; none if the team is the task's default."""
        return tuple(len(parse_team(team)) for team in self.team) or self._counts

    @property
    def _counts(self) -> tuple[int, ...]:
        if self.drones is None:
            return ()
        return self.drones if isinstance(self.drones, tuple) else (self.drones,)

    @property
    def decisions(self) -> int:
        """The number of decisions of single drones in one step of all environments."""
        return self.environments // len(self.team_sizes) * sum(self.team_sizes)

    @property
    def rollouts(self) -> int:
        """The number of rollouts of a run of DAgger."""
        return math.ceil(self.steps / (self.decisions * self.dagger.train_freq))
