"""The core of all environments: a batch of E environments of one task.

Every interface (PettingZoo, Gymnasium, Stable-Baselines3) wraps `SwarmCore`. docs/architecture.md
describes a step.
"""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import compilation, entry_point
from swarm_envs.envs.actions import ACTIONS, apply_actions, as_actions, check_actions
from swarm_envs.envs.communication import Communication
from swarm_envs.envs.config import EnvConfig, check_mask, check_reset_options, check_seeds
from swarm_envs.envs.evaluation import evaluate, metrics, success_rules
from swarm_envs.envs.observation import (
    Float32Array,
    observation_width,
    sense,
    shaper,
    write_observations,
)
from swarm_envs.envs.own_rules import apply_own_rules, has_own_rules, write_own_terms
from swarm_envs.envs.randomization import draw_vehicles, scale_hall
from swarm_envs.errors import check_integer
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.forces import all_forces
from swarm_envs.neighbors import FEW
from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics
from swarm_envs.physics.base import without_ended
from swarm_envs.physics.hall_lanes import sense_in_hall
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import SENSED_TYPE, World, as_columns
from swarm_envs.tasks.base import Placement, Task, place
from swarm_envs.tasks.rewards import check_reward_weights, weigh
from swarm_envs.vehicles import Team

__all__ = ["SwarmCore"]


class StepResult(NamedTuple):
    """The result of a step of E environments of N drones: buffers, valid until the next step."""

    observations: Float32Array
    """(E, N, width) rows; see `observation_layout`."""
    rewards: FloatArray  # (E, N)
    reward_terms: FloatArray
    """(T, E, N) bounded terms without their weights, in the order of the task's `reward_names`.
    Terms of an environment whose episode has ended keep their last values."""
    terminated: BoolArray  # (E,) ended by a crash or by success
    truncated: BoolArray  # (E,) ended by the time limit
    active: BoolArray
    """(E, N) drones that took part in this decision. The episodes of the others ended before it:
    their rewards, terms and observations are 0, and their actions are not used."""
    ended: BoolArray
    """(E, N) drones whose episode was terminated in this decision, alone or with the team's."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The whole state of E environments at one instant, as `get_state()` returns it; picklable.

    `set_state` restores it in any environment with the same options, which then continues
    bitwise identically.
    """

    kind: dict[str, object]
    """The options that it requires: task, team, engine, numbers of environments and stages, ..."""
    world: World  # The tables of drones and environments, and the goals
    observations: Float32Array  # (E, N, width) the last rows
    generators: tuple[Any, ...]  # States of the environments' random generators
    teams: tuple[Team, ...]
    """The team of each environment: the constructor's, or that of its last reset."""
    messages: tuple[npt.NDArray[Any], ...] = ()
    """Messages in transit and keys of losses, if communication is limited."""


class _Part(NamedTuple):
    """The arguments of the kernels that follow the physics, for a part of the environments."""

    actions: FloatArray
    state: tuple[Any, ...]  # Records of drones and environments, goals, settings
    flown: BoolArray
    terms: FloatArray
    scored: tuple[Any, ...]  # The arguments of `weigh`


class _Kernels(NamedTuple):
    """The kernels of a decision, compiled for the types of one core's arrays."""

    apply: Callable[..., bool]  # `apply_actions`
    refer: Callable[..., None]  # The task's `write_reference`
    evaluate: Callable[..., None]  # `evaluate`
    advance: Callable[..., None] | None  # The task's `advance`, where it has one
    write_terms: Callable[..., None]  # The task's `write_reward_terms`
    weigh: Callable[..., None]  # `weigh`
    observe: Callable[..., None]  # `write_observations`


class SwarmCore:
    """E environments of one task.

    Its attribute `world` is their state (`swarm_envs.tables.World`): records of the drones (E, N),
    with vehicles as drawn for the episode, and of the environments (E,), and goals.

    Args:
        task: the task, with its team.
        config: the options.
        num_envs: E.
    """

    def __init__(self, task: Task, config: EnvConfig, num_envs: int = 1) -> None:
        self.task, self.config, self.num_envs = task, config, num_envs
        self.num_drones = len(task.team)
        self.tasks = [task] * num_envs
        self.mode = ACTIONS[config.action]
        self.physics = _make_physics(task, config, num_envs)
        self.world, self.settings = self.physics.world, self.physics.settings
        self.num_obstacles = config.obstacles_observed(len(self.physics.obstacles))
        self.generators = [np.random.default_rng() for _ in range(num_envs)]
        self._set_rules()
        weights = [task.reward_weights.get(name, 0.0) for name in task.reward_names]
        self._weights: FloatArray = np.array(weights, dtype=np.float64)
        self._flown: BoolArray = np.zeros(num_envs, dtype=np.bool_)
        self._everywhere: BoolArray = np.ones(num_envs, dtype=np.bool_)
        self._actions: FloatArray = np.zeros((num_envs, self.num_drones, self.mode.width))
        ranges = self.ranges = config.ranges
        self._noisy = ranges is not None and ranges.noisy
        sensed = self._noisy or config.hall is not None
        drones = self.world.drones
        self._seen = np.zeros(drones.shape, SENSED_TYPE) if sensed else drones
        self._substeps = PHYSICS_RATE // config.decision_rate
        self._state = (*self.world, self.settings)
        self._force_model: InteractionModel | None = None
        self._predicted: FloatArray = np.zeros((0, self.num_drones, 3))
        if config.observe_force is not None:
            self._force_model = load(config.observe_force).with_precision(config.precision)
            self._force_types = np.tile(self._force_model.type_indices(task.team), (num_envs, 1))
            self._predicted = np.zeros((num_envs, self.num_drones, 3))
        self._observed = self._what_is_observed()
        self._communication = self._make_communication() if config.communicates else None
        self._own_rules = has_own_rules(task)
        self._result = StepResult(
            observations=self.rows,
            rewards=np.zeros(drones.shape),
            reward_terms=np.zeros((len(weights), *drones.shape)),
            terminated=np.zeros(num_envs, np.bool_),
            truncated=np.zeros(num_envs, np.bool_),
            active=np.zeros(drones.shape, np.bool_),
            ended=np.zeros(drones.shape, np.bool_),
        )
        whole = (0, num_envs)
        self._parts = {part: self._part(*part) for part in (*self.physics.workers.parts, whole)}

    def _part(self, first: int, last: int) -> _Part:
        """Return views of the arrays of the environments first to last - 1; made once."""
        here = slice(first, last)
        drones, environments, goals = (table[here] for table in self.world)
        flown, (_, rewards, all_terms, *flags) = self._flown[here], self._result
        terms, written = all_terms[:, here], (rewards[here], *(flag[here] for flag in flags))
        return _Part(
            actions=self._actions[here],
            state=(drones, environments, goals, self.settings),
            flown=flown,
            terms=terms,
            scored=(terms, self._weights, flown, drones, environments, *written),
        )

    def _what_is_observed(self) -> list[tuple[Any, ...]]:
        """Return the arguments of `write_observations` for each thread; made once."""
        k, (drones, environments, _) = self.config.num_neighbors, self.world
        width = observation_width(*self.form[1:])
        self.rows: Float32Array = np.zeros((*drones.shape, width), np.float32)
        seen = (self._seen, as_columns(self._seen), drones, environments, self.settings)
        load, setpoint = bool(self.config.observe_load), bool(self.config.observe_setpoint)
        form = (self.num_obstacles, load, self._predicted, setpoint)
        given = (self.rows, *form, *seen, *self._searched(self.num_obstacles))
        threads = range(self.physics.workers.threads)
        return [(*given, np.zeros(k, np.int64), np.zeros(k)) for _ in threads]

    def _searched(self, num_obstacles: int) -> tuple[IntArray | None, FloatArray | None]:
        """Return `order` and `obstacles` of `write_observations`, None if they are not needed."""
        order = self.physics.order if self.num_drones > FEW else None
        return order, self.physics.obstacles if num_obstacles else None

    def _make_communication(self) -> Communication:
        """Return the model of limited communication, which writes into the rows."""
        config = self.config
        parts = shaper("dict", *self.form[1:])(self.rows)  # views of them
        delay = math.ceil(config.observe_delay_s * config.decision_rate - 1e-6)
        range_m = np.inf if config.observe_range_m is None else config.observe_range_m
        views = parts["neighbors"], parts["mask"]
        return Communication(*views, range_m, delay, config.observe_loss)

    def _set_rules(self) -> None:
        """Write the rules of episodes, from task and options, into the settings."""
        task, config = self.task, self.config
        horizon_s = task.episode_s if config.horizon_s is None else config.horizon_s
        ranges = config.ranges
        rules = {
            **success_rules(task.success),
            "bounded": self.mode.bounded,
            "end_on_success": bool(config.end_on_success),
            "decision_rate": config.decision_rate,
            "decision_s": config.decision_s,
            "horizon_s": float(horizon_s),
            **task.motion.settings(),
            **task.rules,
            "noise": (0.0,) * 4 if ranges is None else ranges.noise,
        }
        for name, value in rules.items():
            self.settings[name] = value

    @cached_property
    def _kernels(self) -> _Kernels:
        """The compiled kernels of a decision.

        Kernels look up the types of their arguments at each call. These entry points do not, which
        saves a fifth of a single environment's step.
        """
        task, part = self.task, self._parts[0, self.num_envs]
        drones, environments, _, settings = part.state
        terms = np.zeros((2, 2, self.num_drones))[:, :1]  # not contiguous, as in parts of a batch
        advance = None if inspect.ismethod(task.advance) else task.advance
        given = self._actions, 1.0, drones, environments, settings, self._flown
        with compilation(len(_Kernels._fields) + 1 - (advance is None)):
            self.physics.compile()
            return _Kernels(
                entry_point(apply_actions, 0, *given),
                entry_point(task.write_reference, *part.state),
                entry_point(evaluate, self._actions, *part.state),
                None if advance is None else entry_point(advance, self._flown, *part.state),
                entry_point(task.write_reward_terms, drones, environments, settings, terms),
                entry_point(weigh, terms, *part.scored[1:]),
                entry_point(write_observations, 0, 0, self._flown, *self._observed[0]),
            )

    @property
    def most_decisions(self) -> int:
        """The time limit of an episode in decisions."""
        decisions = float(self.settings["horizon_s"][0]) * self.config.decision_rate
        return math.ceil(decisions - 1e-6)

    @property
    def form(self) -> tuple[str, int, int, bool, bool, bool]:
        """The form of observations, K, M, and flags of observed loads, forces and set-points."""
        config, force = self.config, self._force_model is not None
        extra = (bool(config.observe_load), force, bool(config.observe_setpoint))
        return config.observation, config.num_neighbors, self.num_obstacles, *extra

    @property
    def time(self) -> FloatArray:
        """The time (E,) since the beginning of each episode, s."""
        return self.world.environments["time"]

    @property
    def running(self) -> BoolArray:
        """True (E,) where an episode has not ended."""
        return self.world.environments["running"]

    def close(self) -> None:
        """Release the physics engine. May be called more than once."""
        self.physics.close()

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        mask: BoolArray | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> Float32Array:
        """Begin new episodes in the environments of the mask.

        Args:
            seeds: one per environment; None continues with that environment's generator.
            mask: (E,) environments to reset; None for all.
            options: `start`, `goal` and `team` of these episodes; see `SwarmParallelEnv.reset`.

        Returns:
            (E, N, width) observations.

        Raises:
            ValueError: an option is unknown, or a start, goal or team is impossible. Nothing was
                changed.
        """
        where = self._everywhere if mask is None else check_mask(mask, self.num_envs)
        check_seeds(seeds, self.num_envs)
        team, given = check_reset_options(options, self.num_drones)
        task, (begun,) = self._task_for(team), where.nonzero()
        for e, placement in self._draw(task, begun.tolist(), seeds, given).items():
            drawn = placement.team
            self._fly_task(e, task if drawn is None else task.with_team(drawn))
            place(self.world, e, placement)
        for e in begun.tolist():
            if self.ranges is not None:
                draw_vehicles(self.generators[e], self.ranges, e, self.world)
            if self.physics.hall is not None:
                self.physics.hall.draw(self.generators[e], e, self.world)
                scale_hall(self.generators[e], self.ranges, e, self.world)
            if self._communication is not None:
                self._communication.begin(e, self.generators[e])
        self.physics.begin(begun)
        self._kernels.refer(*self.world, self.settings)
        self._observe(0, self.num_envs, where, 0)
        return self.rows

    def step(self, actions: npt.ArrayLike) -> StepResult:
        """Simulate every running environment until its next decision.

        Args:
            actions: (E, N, width of the action).

        Raises:
            ValueError: actions have a wrong shape, are not finite or exceed their bounds. Nothing
                was changed.
        """
        mode, flown = self.mode, self._flown
        drones, environments, _, settings = self._state
        given = as_actions(mode, actions, self._actions.shape, self.config.clip_actions)
        self._actions[...] = given
        applied = self._actions, mode.limit, drones, environments, settings, flown
        if not self._kernels.apply(mode.code, *applied):
            check_actions(mode, given)
        if self._own_rules:  # methods of the task take all environments at once
            self.physics.fly(self._substeps, flown)
            self._finish(0, self.num_envs, 0)
        else:
            self.physics.fly(self._substeps, flown, self._finish)
        return self._result

    def _finish(self, first: int, last: int, thread: int) -> None:
        """Evaluate, reward and observe a decision in the environments first to last - 1."""
        kernels, (actions, state, flown, terms, scored) = self._kernels, self._parts[first, last]
        drones, environments, _, settings = state
        kernels.refer(*state)
        kernels.evaluate(actions, *state)
        if kernels.advance is not None:
            kernels.advance(flown, *state)
        if self._own_rules:
            apply_own_rules(self.task, self.world, flown, self.config.end_on_success)
        kernels.write_terms(drones, environments, settings, terms)
        if self._own_rules:
            write_own_terms(self.task, self.world, terms)
        kernels.weigh(*scored)
        self._observe(first, last, self._flown, thread)

    def set_reward_weights(self, weights: Mapping[str, float]) -> None:
        """Change weights of reward terms from the next step on, for curricula of trainers.

        Args:
            weights: weights by term; terms left out keep theirs.

        Raises:
            ValueError: there is no such term, or a weight is not finite.
        """
        check_reward_weights(weights, self.task.reward_names)
        for name, weight in weights.items():
            self._weights[self.task.reward_names.index(name)] = weight

    def metrics(self, e: int = 0) -> dict[str, Any]:
        """Return the metrics of environment `e`'s episode so far; see `envs.evaluation.metrics`."""
        return self.metrics_of([e])[0]

    def metrics_of(self, environments: Sequence[int]) -> list[dict[str, Any]]:
        """Return the metrics of several environments, in their order."""
        return metrics(self.world, self.task, environments, self.config.on_contact)

    def team_state(self) -> Float32Array:
        """Return the `self` and `task` fields (E, N, width) of the true state, without noise."""
        return self.true_rows(0)

    def true_rows(
        self,
        num_neighbors: int,
        num_obstacles: int = 0,
        load: bool = False,
        force: bool = False,
        setpoint: bool = False,
    ) -> Float32Array:
        """Return observation rows (E, N, width) of any form, of the true state without noise."""
        width = observation_width(num_neighbors, num_obstacles, load, force, setpoint)
        rows = np.zeros((*self.world.drones.shape, width), np.float32)
        drones, environments, _ = self.world
        predicted = self._predicted if force else self._predicted[:0]
        given = self._everywhere, rows, num_obstacles, load, predicted, setpoint
        state = drones, self.world.columns, drones, environments, self.settings
        scratch = np.zeros(num_neighbors, np.int64), np.zeros(num_neighbors)
        searched = self._searched(num_obstacles)
        write_observations(0, self.num_envs, *given, *state, *searched, *scratch)
        return rows

    def _observe(self, first: int, last: int, where: BoolArray, thread: int) -> None:
        """Write the rows of the environments first to last - 1 that are in the mask `where`."""
        if self.physics.hall is not None:
            sense_in_hall(first, last, self.world.drones, where, self._seen)
        if self._noisy:
            drones, environments, _ = self.world
            sense(first, last, drones, environments, self.settings, where, self._seen)
        if self._force_model is not None:
            here, seen = slice(first, last), self._seen[first:last]
            position = without_ended(seen["position"], self.world.drones["active"][here])
            motion = position, seen["velocity"].copy()
            types, out = self._force_types[here], self._predicted[here]
            all_forces(self._force_model.packed, types, *motion, out)
        self._kernels.observe(first, last, where, *self._observed[thread])
        if self._communication is not None:
            drones, environments, _ = self.world
            written = first + np.flatnonzero(where[first:last])
            state = self._seen, drones, environments["decisions"]
            self._communication.write(written, *state)

    def _task_for(self, team: Team | None) -> Task:
        """Return the task of new episodes with a team; None for the constructor's team.

        Raises:
            ValueError: the team does not fit this environment.
        """
        if team is None or team == self.task.team:
            return self.task
        if len(team) != self.num_drones:
            raise ValueError(
                f"reset option 'team' has {len(team)} vehicles, but this environment has "
                f"{self.num_drones} drones; make a new environment for another number of drones"
            )
        self.physics.interactions.type_indices(team)
        self.physics.feedforward.type_indices(team)
        if self.ranges is not None:
            self.ranges.check_team(team)
        return self.task.with_team(team)

    def _fly_task(self, e: int, task: Task) -> None:
        """Set the task of environment `e`, one of `_task_for`, and its team."""
        if self.tasks[e].team != task.team:
            self.physics.set_team(e, task.team)
            if self._force_model is not None:
                self._force_types[e] = self._force_model.type_indices(task.team)
        self.tasks[e] = task

    def _draw(
        self,
        task: Task,
        environments: Sequence[int],
        seeds: Sequence[int | None] | None,
        given: Mapping[str, FloatArray],
    ) -> dict[int, Placement]:
        """Sample placements; if one is refused, restore the states of all generators."""
        generators, placements = list(self.generators), {}
        before = {e: generators[e].bit_generator.state for e in environments}
        try:
            for e in environments:
                seed = None if seeds is None else seeds[e]
                if seed is not None:
                    generators[e] = np.random.default_rng(check_integer("seed", seed, 0))
                placements[e] = task.place(generators[e], **given)
        except Exception:
            for e, state in before.items():
                self.generators[e].bit_generator.state = state
            raise
        self.generators = generators
        return placements

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle as options and a snapshot: the copy has its own simulator."""
        made = type(self), self.task, self.config, self.num_envs
        return _rebuilt, (*made, self.get_state(), self.reward_weights)

    def get_state(self) -> Snapshot:
        """Return a copy of the whole state; see `Snapshot`."""
        return Snapshot(
            kind=self._kind(),
            world=self.world.copy(),
            observations=self.rows.copy(),
            generators=tuple(copy.deepcopy(g.bit_generator.state) for g in self.generators),
            teams=tuple(task.team for task in self.tasks),
            messages=tuple(kept.copy() for kept in self._messages()),
        )

    def _messages(self) -> tuple[npt.NDArray[Any], ...]:
        sent = self._communication
        return () if sent is None else (sent.messages, sent.keys)

    def set_state(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of this core, or of another with the same options.

        Raises:
            TypeError: it is no snapshot.
            ValueError: it was taken with other options.
        """
        if not isinstance(snapshot, Snapshot):
            raise TypeError(
                f"state is a {type(snapshot).__name__}, but must be what get_state() returned"
            )
        for name, value in self._kind().items():
            theirs = snapshot.kind.get(name)
            if theirs != value:
                raise ValueError(
                    f"the state is of an environment whose {name} is {theirs!r:.99}, but "
                    f"here it is {value!r:.99}; make an environment with the same options"
                )
        tasks = {team: self._task_for(team) for team in set(snapshot.teams)}
        for e, team in enumerate(snapshot.teams):
            self._fly_task(e, tasks[team])
        world = zip(self.world, snapshot.world, strict=True)
        for mine, kept in (*world, *zip(self._messages(), snapshot.messages, strict=True)):
            mine[...] = kept
        self.rows[...] = snapshot.observations
        for e, state in enumerate(snapshot.generators):
            self.generators[e] = np.random.default_rng(0)
            self.generators[e].bit_generator.state = copy.deepcopy(state)
        self.physics.place_bodies(np.arange(self.num_envs))

    def _kind(self) -> dict[str, object]:
        options = vars(self.config) | {
            "physics": self.physics.name,
            "interactions": self.physics.interactions,
            "world": "ideal" if self.physics.hall is None else "hall",
            "hall": self.physics.hall,
            "num_obstacles": self.num_obstacles,
            "observe_force": self._force_model,
            "horizon_s": float(self.settings["horizon_s"][0]),
        }
        return {
            "task": self.task.name,
            "team": tuple(vehicle.token for vehicle in self.task.team),
            "number of environments": self.num_envs,
            "number of stages": self.world.goals.shape[1],
            **{k: _comparable(v) for k, v in options.items() if k not in _FREE},
        }

    @property
    def reward_weights(self) -> dict[str, float]:
        """Weights of the reward terms by name."""
        return dict(zip(self.task.reward_names, self._weights.tolist(), strict=True))


def _rebuilt(
    kind: type[SwarmCore],
    task: Task,
    config: EnvConfig,
    num_envs: int,
    snapshot: Snapshot,
    weights: Mapping[str, float],
) -> SwarmCore:
    """Return a core in the state of another, for `pickle` and `copy`."""
    core = kind(task, config, num_envs)
    core.set_state(snapshot)
    core.set_reward_weights(weights)
    return core


_FREE = ("threads", "clip_actions", "observation")  # Options that do not affect the state


def _comparable(value: Any) -> object:
    """Return an option in a form that equals a copy's: models compare by name and fingerprint."""
    if isinstance(value, InteractionModel):
        return value.name, value.fingerprint
    if is_dataclass(value):
        return type(value).__name__, {k: _comparable(v) for k, v in vars(value).items()}
    return value


def _make_physics(task: Task, config: EnvConfig, num_envs: int) -> Physics:
    """Return the physics engine for a task and its options.

    Raises:
        ValueError: vehicles could not hover with the domain randomization.
        ImportError: Bullet is requested, but pybullet is not installed.
    """
    gusts, ranges = None, config.ranges
    if ranges is not None:
        ranges.check_team(task.team)
        gusts = (ranges.gust_acceleration, ranges.gust_time_s)
    return (BulletPhysics if config.engine == "bullet" else BatchPhysics)(
        task.team,
        num_envs,
        load(config.interactions).with_precision(config.precision),
        arena=task.arena,
        battery=config.battery,
        force_rate=config.force_rate,
        gusts=gusts,
        hall=config.hall,
        interaction_torque=config.interaction_torque,
        obstacles=task.obstacle_rows,
        level=ACTIONS[config.action].level,
        controller=config.controller,
        threads=config.threads_for(num_envs * len(task.team)),
        num_stages=task.num_stages,
        force_bounds_g=config.force_bounds_g,
        on_contact=config.on_contact,
    )
