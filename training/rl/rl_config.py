"""Options of a training run, and its schedules: readable where torch is not installed."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from swarm_envs.agents.features import FEATURE_SETS
from swarm_envs.arguments import NOT_NEGATIVE, Count, Divides, OneOf, Range, Seed, typed
from swarm_envs.envs.setting import AirOptions
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.vehicles import parse_team

__all__ = ["RlConfig"]

Share = Annotated[float, Range(0.0, 1.0)]  # A number from 0 to 1
Rate = Annotated[float, Range(1e-7, 1.0)]  # A small positive number


@partial(typed, owner="--sac.")
@dataclass(frozen=True)
class SacConfig:
    """Of `--algo sac`: how often it learns from what it remembers."""

    train_freq: Count = 8
    """decisions of each drone between two rounds of gradient steps"""
    gradient_steps: Count = 64
    """of a round; each takes a batch from all that is remembered"""
    batch_size: Count = 256
    """decisions per gradient step"""
    learning_rate: Rate = 2e-3
    """of Adam at the start, for actor, critics and temperature; it falls linearly"""
    last_rate: Rate = 0.1
    """final learning rate, as a share of the initial one"""
    lookahead: Count = 3
    """rewards that are counted before the critic estimates what follows (n-step returns)"""
    learning_starts: Annotated[int, Range(0)] = 8192
    """decisions of single drones, drawn at random, before the first gradient step"""
    buffer_size: Count = 300_000
    """size of the replay buffer in steps of single drones; checkpoints contain it, 0.6 kB each"""
    tau: Rate = 0.02
    """share by which target critics follow the critics at each gradient step"""
    ent_coef: Rate = 0.02
    """weight of entropy relative to reward at the start; it is learned. Far above what a decision's
    reward is, the policy is rewarded for jitter"""


@partial(typed, owner="--dagger.")
@dataclass(frozen=True)
class DaggerConfig:
    """Of `--algo dagger`: the teachers, and the gradient steps."""

    teacher: tuple[str, ...] = ("roundabout",)
    """the teachers: names or files of agents, which may be privileged, each optionally after a
    layout, a number of drones or both, such as `circle=NAME` or `random,16=NAME`; the last that
    fits a team teaches it"""
    train_freq: Count = 10
    """decisions of each drone between two rounds of gradient steps"""
    gradient_steps: Count = 12
    """of a round; each takes a batch from all that is remembered"""
    batch_size: Count = 1024
    """decisions per gradient step"""
    learning_rate: Rate = 2e-3
    """of Adam at the start; it falls as a cosine"""
    last_rate: Rate = 0.02
    """final learning rate, as a share of the initial one"""
    buffer_size: Count = 400_000
    """size of the replay buffer in steps of single drones; checkpoints contain it, 0.6 kB each"""
    guided: Share = 0.125
    """share of the run during which the teacher flies too; its share of the decisions falls from 1
    to 0"""
    noise: Share = 0.1
    """standard deviation of noise on the actions of a third of the environments"""
    avoiding: Annotated[float, Range(0.0, 100.0)] = 3.0
    """weight of decisions in which other drones change the teacher's action; others have 1"""
    huber: Annotated[float, Range(1e-3, 10.0)] = 0.1
    """error of an action from which on the loss grows linearly"""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What is trained, and where it is kept: these come first in the help."""

    out: Path
    """folder of the run: policy.safetensors, curve.csv, report.json, checkpoint, event files"""
    task: str = "swap"
    """the task, such as `swap`, or with its version, `swap_v1`"""
    layout: str | None = None
    """of the task; that of its recipe if not given: `random` for swap (half of the episodes are
    crowded, a quarter on the circle; or `circle`), `shuffle` for formation (or `cube`, `tour`),
    `stack` for columns (or `sprint`), `all` for pursuit and crowd, by DAgger"""
    algo: Literal["ppo", "mappo", "sac", "dagger"] = "ppo"
    """one policy for all drones by: `ppo`, proximal policy optimisation; `mappo`, with a critic
    that sees the whole team; `sac`, soft actor-critic, which learns from every decision often;
    `dagger`, which imitates another agent where the policy itself has flown"""
    start: str | None = None
    """a trained policy, by name, file or folder, from which the actor begins"""
    start_kl: Annotated[float, Range(0.0, 1e4)] = 0.0
    """weight in the loss of the policy's divergence from that policy (Kullback-Leibler)"""
    drones: Count | tuple[Count, ...] = 4
    """number of drones; of several numbers, such as `4 8`, each has an equal share of the
    environments; the policy will fly in teams from the smallest to the largest"""
    fewest: int | None = None
    """smallest team in which the policy will fly; that of its training if not given"""
    most: int | None = None
    """largest team in which the policy will fly; that of its training if not given"""
    team: tuple[str, ...] = ()
    """the vehicles, such as `SSLL`, one team or more; overrides --drones"""
    steps: Count = 3_000_000
    """decisions of single drones, rounded up to whole rollouts"""
    seed: Seed = 0
    """random seed of initial weights, episodes and exploration; the same seed gives the same
    policy"""
    json: Path | None = None
    """write the report to this file too"""


@partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class RlConfig(AirOptions, RunOptions):
    """Train one policy for all drones by reinforcement learning.

    Interrupted or killed at any moment, the same command resumes from the last checkpoint, and ends
    with the policy that an uninterrupted run would have. A finished run is not overwritten.
    """

    environments: Count = 128
    """teams that fly at once, of all sizes together"""
    threads: Count = 2
    """of the environments; their number changes nothing of what is learned"""
    n_steps: Count = 32
    """decisions of each drone between two updates of the policy"""
    batch_size: Count = 2048
    """decisions per gradient step"""
    n_epochs: Count = 5
    """epochs over each rollout"""
    learning_rate: Rate = 1e-3
    """initial learning rate of Adam; it decays linearly"""
    last_rate: Share = 0.02
    """final learning rate, as a share of the initial one"""
    gamma: Share | None = None
    """discount factor; default: the task's, and 0.9 with `--algo sac`"""
    gae_lambda: Share = 0.95
    """lambda of generalised advantage estimation"""
    clip_range: Annotated[float, Range(1e-3, 1.0)] = 0.2
    """how far a decision's probability may move per update, as a ratio"""
    ent_coef: Share = 0.003
    """weight of the policy's entropy in the loss: keeps it exploring"""
    hidden: tuple[Count, ...] = (64, 64)
    """widths of the hidden layers of actor and critic, which share none"""
    activation: Literal["tanh", "relu"] = "tanh"
    """what follows every hidden layer of the actor"""
    encoder: Literal["mlp", "deep-set", "attention"] = "mlp"
    """how neighbours are encoded: `mlp`, one after another, nearest first; `deep-set`, each with
    the drone's own numbers through a small network, then pooled; `attention`, the same, pooled by
    weights that are learned"""
    pooling: Literal["mean", "max", "sum", "max-sum"] = "mean"
    """of a deep set; `max-sum` is both"""
    set_hidden: tuple[Count, ...] = (32, 32)
    """widths of the network that a set gives each neighbour to"""
    per_type: bool = False
    """a policy of its own for each type of vehicle in the team"""
    log_std_init: Annotated[float, Range(-7.0, 2.5)] | None = None
    """logarithm of the actions' standard deviation at the start; the same in every state, and
    learned; default: the task's"""
    second_stage: Annotated[float, Range(0.0, 0.9)] = 0.25
    """share of the steps that are trained again from what the others gave: with a fresh Adam, and
    more exploration again; 0 for one stage"""
    second_rate: Rate = 7e-4
    """of Adam at the start of the second stage"""
    second_deviation: Annotated[float, Range(0.0, 10.0)] = 0.3
    """least standard deviation of actions at its start"""

    horizon_s: Annotated[float, Range(0.2, 1000.0, unit="s")] | None = None
    """time limit of training, s; default: the task's: shorter than the task's, since failures
    come early; the time-out is bootstrapped"""
    action: Literal["acceleration", "velocity", "ctbr", "rotors"] = "acceleration"
    """what the policy's numbers mean: set-points' `acceleration` or `velocity`, collective thrust
    and body rates (`ctbr`), or each of the `rotors`; it will fly with this one alone"""
    decision_rate: Annotated[int, Divides(PHYSICS_RATE)] = 10
    """decisions per second, in training and in flight"""
    force_rate: Annotated[int, Divides(PHYSICS_RATE)] = 48
    """evaluations of the interaction force per second in training"""
    num_neighbors: Annotated[Count, tyro.conf.arg(aliases=["--neighbors"])] = 3
    """K, the number of observed neighbors"""
    num_obstacles: Annotated[int, Range(0)] | None = None
    """M, the number of observed obstacles; default: 3 where there are any"""
    observe_load: bool | None = None
    """observe thrust margins, masses and charges; default: the task's"""
    observe_force: bool = False
    """observe the force that the shipped belief predicts for the drone"""
    features: Annotated[str, OneOf(tuple(FEATURE_SETS))] | None = None
    """what the network sees of an observation row; default: the task's, and `full-1` with
    obstacles, loads or forces"""
    controller: str | None = None
    """the shipped agent whose tracking controller flies the policy's set-points, such as
    `air-aware`; the default controller if not given"""
    interactions: str = "learned"
    """interaction forces: `none`, `wake`, `learned`, or a weights file"""
    hard_starts: bool = True
    """with the layout `random`: crowded starts and circles among the episodes"""
    proximity: tuple[Annotated[float, NOT_NEGATIVE], Annotated[float, NOT_NEGATIVE]] = (4.0, 2.0)
    """cost of being near another drone, from the first quarter to the last of the first stage; too
    much for too long, and drones hover next to their goals"""
    crash: Annotated[float, Range(0.0, 1e6)] = 1.0
    """cost of a collision, which also ends the episode"""
    time_cost: Annotated[float, Range(0.0, 1e3)] = 0.0
    """cost of every second until the episode ends"""
    reward_scale: Annotated[float, Range(1e-6, 1e6)] = 1.0
    """all rewards times this"""

    checkpoint_rollouts: Count = 20
    """rollouts between checkpoints"""
    judge_every: Count = 3
    """checkpoints between evaluations; the last is always evaluated"""
    judge_episodes: Count = 256
    """episodes of an evaluation, on each layout, on seeds that are the same in every run and never
    trained on; the policy that does best on them is kept"""
    tensorboard: bool = True
    """write event files, where the package tensorboard is installed"""
    progress: bool = True
    """show a progress bar"""
    sac: SacConfig = SacConfig()
    """only with `--algo sac`: replaces the PPO options above"""
    dagger: DaggerConfig = DaggerConfig()
    """only with `--algo dagger`: replaces the PPO options above"""

    def __post_init__(self) -> None:
        """Refuse options that do not fit each other."""
        self._check_teams()
        for name in ("hidden", "set_hidden"):
            if not getattr(self, name):
                raise ValueError(f"{_option(name)} is (), but must be one or more widths")
        self._check_belongs()
        self._check_sizes()

    def _check_teams(self) -> None:
        given = {*self._counts}
        if self.team and given != {RunOptions.drones} and given != {*self.team_sizes}:
            raise ValueError(
                f"--drones is {self.drones}, but --team {' '.join(self.team)} has "
                f"{', '.join(map(str, self.team_sizes))}; give one of them"
            )
        named = [str(team) for team in self.teams]
        if not named or len(set(named)) < len(named):
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
        if self.start is None and self.start_kl:
            raise ValueError("--start-kl was given, but no --start from which to diverge")

    def _check_belongs(self) -> None:
        for name, value in _changed(self):
            if not self.uses(name):
                nested = [(f"{name}.{n}", v) for n, v in _changed(value)]
                named, given = (nested or [(name, value)])[0]
                raise ValueError(
                    f"{_option(named)} was given ({given}), but --algo {self.algo} has no such "
                    "option"
                )
            encoders = _OF_ENCODERS.get(name, (self.encoder,))
            if self.encoder not in encoders:
                raise ValueError(
                    f"{_option(name)} was given, but only --encoder {' or '.join(encoders)} has it"
                )

    def _check_sizes(self) -> None:
        teams, size = len(self.team_sizes), self.rollout_steps
        if self.environments % teams:
            raise ValueError(
                f"--environments is {self.environments}, but must be a multiple of the {teams} "
                "teams that fly side by side"
            )
        if self.on_policy and size % self.batch_size:
            raise ValueError(
                f"--batch-size is {self.batch_size}, but must divide the {size} decisions of a "
                f"rollout: drones of all environments x --n-steps, such as {size}"
            )
        held, batch = self._off_policy.buffer_size, self._off_policy.batch_size
        if not self.on_policy and batch > held:
            raise ValueError(
                f"--{self.algo}.batch-size is {batch}, but must be at most {held}, the "
                f"--{self.algo}.buffer-size that it is drawn from"
            )

    @property
    def on_policy(self) -> bool:
        """Whether each decision is learned from once, after its rollout: with stages and clips."""
        return self.algo in ("ppo", "mappo")

    @property
    def _off_policy(self) -> SacConfig | DaggerConfig:
        return self.sac if self.algo == "sac" else self.dagger

    def uses(self, option: str) -> bool:
        """Whether the run's algorithm depends on an option."""
        return option not in _FOREIGN[self.algo]

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
    def rollout_steps(self) -> int:
        """Decisions of single drones in a rollout."""
        decisions = self.n_steps if self.on_policy else self._off_policy.train_freq
        return self.environments // len(self.team_sizes) * sum(self.team_sizes) * decisions

    @property
    def rollouts(self) -> int:
        """Rollouts of the whole run."""
        return math.ceil(self.steps / self.rollout_steps)

    @property
    def first_stage(self) -> int:
        """Rollouts of the first stage."""
        share = self.second_stage if self.on_policy else 0.0
        return max(1, self.rollouts - round(share * self.rollouts))

    def segments(self) -> list[range]:
        """The rollouts between checkpoints; none belongs to both stages."""
        found = []
        for first, last in ((0, self.first_stage), (self.first_stage, self.rollouts)):
            for begin in range(first, last, self.checkpoint_rollouts):
                found.append(range(begin, min(begin + self.checkpoint_rollouts, last)))
        return found

    def segment_seed(self, segment: range) -> int:
        """Seed of a segment's episodes and draws: the run's, and the segment's place."""
        words = np.random.SeedSequence([self.seed, segment.start]).generate_state(1)
        return int(words[0]) >> 1

    def learning_rate_after(self, rollouts: int) -> float:
        """Adam's rate: it falls linearly over each stage, or over the whole run of SAC.

        Of DAgger it falls as a cosine.
        """
        if not self.on_policy:
            start, last = self._off_policy.learning_rate, self._off_policy.last_rate
            done = rollouts / self.rollouts
            if self.algo == "dagger":
                done = 0.5 - 0.5 * math.cos(math.pi * done)
        elif rollouts < self.first_stage:
            start, done, last = self.learning_rate, rollouts / self.first_stage, self.last_rate
        else:
            done = (rollouts - self.first_stage) / max(self.rollouts - self.first_stage, 1)
            start, last = self.second_rate, self.last_rate
        return start * max(1.0 - done, last)

    def proximity_weight_after(self, rollouts: int) -> float:
        """Weight of the term `proximity`, a cost: it changes in the middle of the first stage."""
        first, last = self.proximity
        share = np.clip(2.0 * rollouts / self.first_stage - 0.5, 0.0, 1.0)
        return -self.reward_scale * float(first + share * (last - first))


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _changed(settings: object) -> list[tuple[str, Any]]:
    """Fields of settings that are not their defaults; none of what is no dataclass."""
    if not is_dataclass(settings):
        return []
    given = ((field, getattr(settings, field.name)) for field in fields(settings))
    return [(field.name, value) for field, value in given if value != field.default]


_ON_POLICY = (
    *("n_steps", "batch_size", "n_epochs", "learning_rate", "last_rate", "gae_lambda"),
    *("clip_range", "ent_coef", "log_std_init", "second_stage", "second_rate"),
    "second_deviation",
)
_REWARDS = ("gamma", "proximity", "crash", "time_cost", "reward_scale")
_FOREIGN = {
    "ppo": ("sac", "dagger"),
    "mappo": ("sac", "dagger"),
    "sac": (*_ON_POLICY, "start", "start_kl", "activation", "dagger"),
    "dagger": (*_ON_POLICY, "start_kl", *_REWARDS, "sac"),
}
"""Options that an algorithm has not."""
_OF_ENCODERS = {"pooling": ("deep-set",), "set_hidden": ("deep-set", "attention")}
"""Encoders that have an option."""
