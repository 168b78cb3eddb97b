"""The one implementation of the environments: E of them at once, of one task and team.

Every interface (PettingZoo, Gymnasium, Stable-Baselines3) is a thin view of this class.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.borrowed import lend
from swarm_envs.compiled import entry_point
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.actions import ACTIONS, check_actions
from swarm_envs.envs.checks import check_mask, check_reset_options, check_seeds
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.engine import make_physics
from swarm_envs.envs.episodes import draw_placements, randomize
from swarm_envs.envs.flight import Flight
from swarm_envs.envs.judge import Rules, begin, judge, new_verdict, success_rules, tick
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.observer import Aims, Observer
from swarm_envs.envs.report import Reporter
from swarm_envs.envs.snapshot import Snapshot, rebuild, restore_snapshot, take_snapshot
from swarm_envs.envs.teams import fly_task, task_for
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.metrics import new_record
from swarm_envs.tasks.mission import new_mission
from swarm_envs.tasks.motion import Motion, new_reference
from swarm_envs.tasks.rewards import check_reward_weights, weigh


class StepResult(NamedTuple):
    """What a step gives, for E environments of N drones."""

    observations: Float32Array
    """(E, N, width) rows; see `observation_layout`. A buffer, valid until the next step."""
    rewards: FloatArray
    """(E, N)."""
    reward_terms: FloatArray
    """(T, E, N) each bounded term before its weight, in the order of the task's `reward_names`."""
    terminated: BoolArray
    """(E,) ended by a crash or by success."""
    truncated: BoolArray
    """(E,) ended by the clock."""


class SwarmCore:
    """E environments of one task.

    Args:
        task: what is flown, by whom.
        config: how.
        num_envs: E.
    """

    def __init__(self, task: Task, config: EnvConfig, num_envs: int = 1) -> None:
        self.task, self.config, self.num_envs = task, config, num_envs
        self.tasks = [task] * num_envs
        self.mode = ACTIONS[config.action]
        self.physics = make_physics(task, config, num_envs)
        controller = config.controller or ControllerConfig()
        bounds, threads = config.force_bounds_g, config.threads_for(num_envs * len(task.team))
        self.flight = Flight(self.physics, controller, self.mode.level, bounds, threads)
        drones = len(task.team)
        self.motion: Motion = task.motion
        self.mission = new_mission(num_envs, drones, task.num_stages)
        self.record = new_record(num_envs, drones)
        self.decisions: IntArray = np.zeros(num_envs, dtype=np.int64)
        self.time: FloatArray = np.zeros(num_envs)
        self.running: BoolArray = np.zeros(num_envs, dtype=np.bool_)
        self.verdict = new_verdict(num_envs, drones)
        self.generators = [np.random.default_rng() for _ in range(num_envs)]
        self._substeps = PHYSICS_RATE // config.decision_rate
        clock = task.episode_s if config.horizon_s is None else config.horizon_s
        self._rules = Rules(
            *success_rules(task.success),
            stage_s=self.motion.stage_s,
            decision_s=config.decision_s,
            horizon_s=float(clock),
            end_on_success=bool(config.end_on_success),
            bounded=self.mode.bounded,
        )
        weights = [task.reward_weights.get(name, 0.0) for name in task.reward_names]
        self._weights: FloatArray = np.array(weights, dtype=np.float64)
        self._reference = new_reference(num_envs, drones)
        aims = Aims(self.mission.goal, self._reference, self.time, self._rules.horizon_s)
        self.observer = Observer(self.flight, config, aims)
        self.rows = self.observer.rows
        self._apply = self.mode.bind(self.flight.pilot, config.decision_s)
        self._flown = self.running.copy()
        self._reporter = Reporter(self)
        self._lend()
        self._begin: Callable[..., None] | None = None
        self._tick: Callable[..., None] | None = None
        self._refer: Callable[..., None] | None = None
        self._judge: Callable[..., None] | None = None
        self._write_terms: Callable[..., None] | None = None
        self._weigh: Callable[..., None] = weigh

    def _lend(self) -> None:
        """Put together what kernels take at every decision, all of which stays."""
        contacts, rules, mission = self.physics.contacts, self._rules, lend(self.mission)
        situation = self.verdict.situation(self.mission, contacts)
        self._clock = (int(self.config.decision_rate), self.decisions, self.time)
        self._referred = (mission, lend(self.motion), self.time, lend(self._reference))
        kept = (mission, lend(self.record), lend(self.verdict))
        self._begun = (rules.radius, self.decisions, self.time, self.running, *kept)
        self._judged: tuple[Any, ...] = (
            self.time,
            self.physics.state.position,
            self._reference.position,
            lend(contacts),
            lend(rules),
            *kept,
            self.running,
        )
        self._rewarded = (lend(situation), rules.decision_s, rules.horizon_s)

    @property
    def form(self) -> tuple[str, int, int]:
        """Form of observations, K neighbours, M obstacles: what their shape follows from."""
        return self.config.observation, self.config.num_neighbors, self.num_obstacles

    @property
    def num_obstacles(self) -> int:
        """M, how many obstacles a drone observes."""
        return self.observer.num_obstacles

    @property
    def num_drones(self) -> int:
        """N."""
        return len(self.task.team)

    def close(self) -> None:
        """Free what physics holds. May be called more than once."""
        self.flight.close()
        self.physics.close()

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        mask: BoolArray | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> Float32Array:
        """Begin new episodes in the environments of the mask.

        Args:
            seeds: one per environment; None goes on with that environment's generator.
            mask: (E,) which to reset; None for all.
            options: for these episodes alone. What the task allows of `start` and `goal`, (N, 3)
                m, fixes what would be drawn; `team`, N vehicles or their string, flies in place of
                the constructor's.

        Returns:
            (E, N, width) observations.

        Raises:
            ValueError: an option is unknown, or a start, goal or team impossible; nothing has
                changed then.
        """
        where = check_mask(mask, self.num_envs)
        check_seeds(seeds, self.num_envs)
        told = {} if options is None else options
        team, given = check_reset_options(told, self.num_drones)
        task, environments = task_for(self, team), np.flatnonzero(where).tolist()
        for e, placement in draw_placements(self, task, environments, seeds, given).items():
            fly_task(self, e, task)
            self.mission.place(e, placement)
        self.flight.start.position[...] = self.mission.start
        if self.config.randomization is not None:
            randomize(self, self.config.randomization, environments)
        self.flight.reset(where)
        self._begin = self._begin or entry_point(begin, where, *self._begun)
        self._begin(where, *self._begun)
        self._look_up_reference()
        return self.observer.observe(where, self.decisions)

    def step(self, actions: npt.ArrayLike) -> StepResult:
        """Fly every running environment from this decision to the next.

        Args:
            actions: (E, N, width of the action).

        Raises:
            ValueError: actions of a wrong shape, not finite, or outside their bounds; nothing
                has changed then.
        """
        shape = (self.num_envs, self.num_drones, self.mode.width)
        checked = check_actions(self.mode, actions, shape)
        flown = self._flown
        flown[:] = self.running
        self._apply(checked, flown)
        self.flight.fly(self._substeps, flown)
        self._decide(checked, flown)
        rewards, terms = self._reward(flown)
        return StepResult(
            self.observer.observe(flown, self.decisions),
            rewards,
            terms,
            self.verdict.terminated.copy(),
            self.verdict.truncated.copy(),
        )

    def set_reward_weights(self, weights: Mapping[str, float]) -> None:
        """Weigh reward terms otherwise from the next step on: for curricula of trainers.

        Args:
            weights: by term; terms left out keep theirs.

        Raises:
            ValueError: there is no such term, or a weight is not finite.
        """
        check_reward_weights(weights)
        for name, weight in weights.items():
            self._weights[self.task.reward_names.index(name)] = weight

    def metrics(self, e: int = 0) -> dict[str, Any]:
        """What environment `e`'s episode is judged by, so far; see `Reporter.metrics`."""
        return self._reporter.metrics([e])[0]

    def metrics_of(self, environments: Sequence[int]) -> list[dict[str, Any]]:
        """The same of several environments, in their order."""
        return self._reporter.metrics(environments)

    def _look_up_reference(self) -> None:
        self._refer = self._refer or entry_point(self.task.write_reference, *self._referred)
        self._refer(*self._referred)

    def _decide(self, actions: FloatArray, flown: BoolArray) -> None:
        """Tell the time, and judge what was flown."""
        if self._tick is None or self._judge is None:
            self._tick = entry_point(tick, flown, *self._clock)
            self._judge = entry_point(judge, actions, *self._judged)
        self._tick(flown, *self._clock)
        self._look_up_reference()
        self._judge(actions, *self._judged)

    def _reward(self, flown: BoolArray) -> tuple[FloatArray, FloatArray]:
        shape = (self.num_envs, self.num_drones)
        rewards: FloatArray = np.empty(shape)
        terms: FloatArray = np.empty((len(self._weights), *shape))
        if self._write_terms is None:
            write = self.task.write_reward_terms
            self._write_terms = entry_point(write, *self._rewarded, terms)
            self._weigh = entry_point(weigh, terms, self._weights, flown, rewards)
        self._write_terms(*self._rewarded, terms)
        self._weigh(terms, self._weights, flown, rewards)
        return rewards, terms

    def team_state(self) -> Float32Array:
        """(E, N, width) the true state of every drone: its `self` and `task` fields, no noise."""
        return self.observer.team_state()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle as options and a snapshot: the copy has a simulator of its own."""
        return rebuild, (type(self), self.task, self.config, self.num_envs, self.get_state())

    def get_state(self) -> Snapshot:
        """Everything that changes, copied: see `Snapshot`."""
        return take_snapshot(self)

    def set_state(self, snapshot: Snapshot) -> None:
        """Go to where a snapshot was taken, in this core or in another with the same options.

        Raises:
            TypeError: it is no snapshot.
            ValueError: it does not fit these options.
        """
        restore_snapshot(self, snapshot)
        self._look_up_reference()
