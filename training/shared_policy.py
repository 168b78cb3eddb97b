"""Vectorized environment of Stable-Baselines3, with every drone as a sub-environment.

One policy controls all drones (parameter sharing), and each step is one batched call.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from swarm_envs.agents.features import feature_sizes, features_of
from swarm_envs.envs.config import check_num_envs
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import split_teams
from swarm_envs.envs.observation import Float32Array, observation_space, shaper
from swarm_envs.envs.options import Blueprint, batch_of
from swarm_envs.errors import check_bool, check_integer
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import Task

__all__ = ["SharedPolicyVecEnv"]

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        "SharedPolicyVecEnv needs Stable-Baselines3; install it by: pip install 'swarm-envs[train]'"
    ) from error

Infos = list[dict[str, Any]]  # The infos of a step, one for each sub-environment


class SharedPolicyVecEnv(VecEnv):  # type: ignore[misc]  # SB3's base has no types here
    """E environments of N drones as E * N sub-environments: e * N + i is drone i of environment e.

    All drones of an environment end together, and restart in the same step. The info of a
    sub-environment at the end has `terminal_observation`, `TimeLimit.truncated` (True at the time
    limit, where the value must be bootstrapped), `episode_metrics` of the environment and
    `is_success`, which Stable-Baselines3 logs as `rollout/success_rate`.

    With `on_contact="end_pair"` the episode of a drone may end before that of its team: the
    sub-environment then ends without metrics. Until the team's end its observations are zeros, its
    rewards are 0, its actions are ignored, and `info["active"]` is False, so that a learner can
    skip these steps, as `swarm-envs train` does. At the team's end, a new episode of every drone
    begins.

    Copies and pickles have their own simulators and continue from the same state.

    Args:
        task: name of the task, such as `swap_v1`, or a class; or a blueprint; or several
            blueprints, whose sub-environments follow one another.
        num_envs: E, for each team; or one number for each blueprint.
        seed: the seed of environment 0; environment e has `seed` + e.
        features: observe the features of `swarm_envs.agents.features`, as policies of
            `swarm-envs train` do, instead of observation rows.
        **options: options of the task's `parallel_env()`; the default engine is `batch`. None with
            a blueprint, which has them already.

    Raises:
        TypeError: an option does not exist, or has a wrong type.
        ValueError: there is no such task, an option has an invalid value, or teams have different
            observation or action spaces.
    """

    def __init__(
        self,
        task: str | type[Task] | Blueprint | Sequence[Blueprint],
        num_envs: int | Sequence[int] = 1,
        seed: int | None = None,
        *,
        features: bool = False,
        **options: Any,
    ) -> None:
        blueprints = _blueprints(task, options)
        counts = num_envs if isinstance(num_envs, Sequence) else [num_envs] * len(blueprints)
        if len(counts) != len(blueprints):
            raise ValueError(
                f"num_envs is {num_envs!r}, but must be a number, or one for each of "
                f"{len(blueprints)} teams"
            )
        check_bool("features", features)
        observed = blueprints[0].config.observation
        if features and observed != "flat":
            raise ValueError(
                f"features=True replaces the row, but observation is {observed!r}; give one of them"
            )
        self.cores = tuple(
            SwarmCore(found.task, found.config, check_num_envs(count))
            for found, count in zip(blueprints, counts, strict=True)
        )
        self.features = features
        for k, core in enumerate(self.cores):
            if (core.form, core.mode) != (self.core.form, self.core.mode):
                raise ValueError(
                    f"team {k} has observation {core.form} and action {core.mode.name!r}, but team "
                    f"0 has {self.core.form} and {self.core.mode.name!r}; make them with the same "
                    "options, but for the team"
                )
        self._make_shape()
        sizes = [core.num_envs * core.num_drones for core in self.cores]
        self._begins = list(accumulate(sizes, initial=0))
        self._team_of = np.repeat(np.arange(len(sizes)), sizes)
        self.render_mode = None
        edge = 1.0 if self.core.mode.bounded else np.inf
        actions = spaces.Box(-edge, edge, (self.core.mode.width,), np.float32)
        super().__init__(sum(sizes), self._observed_space(), actions)
        self._actions: list[FloatArray] = []
        self._next_seeds: list[list[int] | None] = [None] * len(self.cores)
        self._begun = self._closed = False
        if seed is not None:
            self.seed(seed)

    @property
    def core(self) -> SwarmCore:
        """The environments of the first team."""
        return self.cores[0]

    def observe(self, rows: Float32Array) -> Any:
        """Return observations of rows (..., width), in the environment's form or as features."""
        return self._shape(rows)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset: environment e, with all its drones, gets `seed` + e.

        The first environment of a further team gets `seed` plus the number of sub-environments
        before it.
        """
        if seed is None:
            self._next_seeds = [None] * len(self.cores)
            return [None] * self.num_envs
        first = check_integer("seed", seed, 0)
        seeds = [
            [first + begin + e for e in range(core.num_envs)]
            for core, begin in zip(self.cores, self._begins, strict=False)
        ]
        self._next_seeds = [*seeds]
        drones = [core.num_drones for core in self.cores]
        return [s for own, n in zip(seeds, drones, strict=True) for s in own for _ in range(n)]

    def reset(self) -> Any:
        """Begin new episodes in all environments, with the seeds and options that were set.

        Raises:
            RuntimeError: the environment is closed.
            ValueError: an option is unknown or invalid, or differs within an environment.
        """
        self._check_open("reset")
        self._place()
        self._next_seeds, self._begun = [None] * len(self.cores), True
        self._reset_options()
        self.reset_infos: Infos = [{} for _ in range(self.num_envs)]
        return self._observations()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Store the actions (E * N, width) for `step_wait`.

        Raises:
            RuntimeError: no episode has begun, or the environment is closed.
            ValueError: they have another shape, or are no numbers.
        """
        self._check_open("step")
        if not self._begun:
            raise RuntimeError("step() was called, but no episode has begun; call reset() first")
        # np.split gives the last team all remaining rows, so that too many are refused there
        parts = np.split(actions, self._begins[1:-1]) if len(self.cores) > 1 else [actions]
        self._actions = [
            split_teams(part, (core.num_envs * core.num_drones, core.mode.width), core)
            for core, part in zip(self.cores, parts, strict=True)
        ]

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Simulate until the next decision, and begin new episodes where one has ended.

        Raises:
            ValueError: an action is not finite or outside its bounds; the state is unchanged.
        """
        rewards, dones = [], []
        infos: Infos = []
        for core, actions, begin in zip(self.cores, self._actions, self._begins, strict=False):
            result = core.step(actions)
            over = result.terminated | result.truncated
            done = result.ended | over[:, None]
            flew = result.active.reshape(-1).tolist()
            infos += [{"TimeLimit.truncated": False, "active": active} for active in flew]
            if done.any():
                cut = result.truncated[:, None] & result.active & ~result.ended
                self._report_ends(core, done, over, cut, infos[begin:])
                core.rows[done] = 0.0  # the next observation, unless the reset replaces it
            if over.any():
                core.reset(mask=over)
            rewards.append(result.rewards.reshape(-1).astype(np.float32))
            dones.append(done.reshape(-1))
        return self._observations(), np.concatenate(rewards), np.concatenate(dones), infos

    def _report_ends(
        self, core: SwarmCore, done: BoolArray, over: BoolArray, cut: BoolArray, infos: Infos
    ) -> None:
        """Write the infos of a team's drones that are done (E, N); `over` (E,), `cut` (E, N)."""
        drones, places = core.num_drones, np.flatnonzero(done).tolist()
        shown = self._seen(core, places)
        ends = np.flatnonzero(over).tolist()
        metrics = dict(zip(ends, core.metrics_of(ends), strict=True))
        for row, place in enumerate(places):
            info, e = infos[place], place // drones
            info["TimeLimit.truncated"] = bool(cut.flat[place])
            info["terminal_observation"] = _row(shown, row)
            info["is_success"] = e in metrics and metrics[e]["success"]
            if e in metrics:
                info["episode_metrics"] = dict(metrics[e])

    def _seen(self, core: SwarmCore, places: list[int]) -> Any:
        """Return the observations of a core's drones with these indices."""
        return self.observe(core.rows.reshape(-1, core.rows.shape[-1])[places])

    def _observations(self) -> Any:
        width = self.core.rows.shape[-1]
        return self.observe(np.concatenate([core.rows.reshape(-1, width) for core in self.cores]))

    def close(self) -> None:
        """Free the resources of the physics engine."""
        self._closed = True
        for core in self.cores:
            core.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of each sub-environment's core."""
        if attr_name == "render_mode":
            return [None for _ in self._get_indices(indices)]
        values = [getattr(core, attr_name) for core in self.cores]
        return [values[self._team_of[k]] for k in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise AttributeError, as sub-environments share one core."""
        raise AttributeError(
            f"cannot set {attr_name!r} on single drones of a batch; make another "
            "SharedPolicyVecEnv with the options you want"
        )

    def env_method(
        self, method_name: str, *arguments: Any, indices: Any = None, **options: Any
    ) -> list[Any]:
        """Call a method once on each selected core; return the result of each sub-environment."""
        teams = [int(self._team_of[k]) for k in self._get_indices(indices)]
        values = {
            team: getattr(self.cores[team], method_name)(*arguments, **options)
            for team in sorted(set(teams))
        }
        return [values[team] for team in teams]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each: wrappers such as `VecMonitor` wrap this environment instead."""
        return [False for _ in self._get_indices(indices)]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the observation function, which cannot be pickled."""
        self._check_open("pickling")
        return {name: value for name, value in vars(self).items() if name != "_shape"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._make_shape()

    def _make_shape(self) -> None:
        form = self.core.form
        self._shape = shaper(*form)
        if self.features:
            self._shape = lambda rows: features_of(rows, *form[1:])

    def _observed_space(self) -> spaces.Space[Any]:
        if not self.features:
            return observation_space(*self.core.form)
        width = feature_sizes(*self.core.form[1:]).width
        return spaces.Box(-np.inf, np.inf, (width,), np.float32)

    def _check_open(self, what: str) -> None:
        if self._closed:
            raise RuntimeError(f"{what}() was called on a closed environment; make a new one")

    def _place(self) -> None:
        if len(self._options) != self.num_envs:
            raise ValueError(
                f"options has {len(self._options)} entries, but must have {self.num_envs}: one for "
                "each drone of each environment, or be one dictionary for all"
            )
        before = [core.get_state() for core in self.cores] if any(self._options) else []
        try:
            for core, begin, seeds in zip(self.cores, self._begins, self._next_seeds, strict=False):
                if not before:
                    core.reset(seeds)
                for e in range(core.num_envs if before else 0):
                    options = self._options_of(core.num_drones, begin + e * core.num_drones)
                    core.reset(seeds, np.arange(core.num_envs) == e, options)
        except Exception:  # if one reset fails, no episode begins
            for core, state in zip(self.cores, before, strict=False):
                core.set_state(state)
            raise

    def _options_of(self, drones: int, begin: int) -> dict[str, Any]:
        """Return the reset options of an environment, which must be the same for its drones."""
        first, *others = self._options[begin : begin + drones]
        if not all(other is first or _equal(first, other) for other in others):
            raise ValueError(
                f"options of sub-environments {begin} to {begin + drones - 1} differ, but they are "
                "the drones of one environment; give all of them the same"
            )
        return dict(first)


def _blueprints(task: Any, options: dict[str, Any]) -> tuple[Blueprint, ...]:
    if isinstance(task, str | type):
        return (batch_of(task, **options),)
    found = (task,) if isinstance(task, Blueprint) else task
    if not isinstance(found, list | tuple) or not all(isinstance(b, Blueprint) for b in found):
        rule = "must be a task's name, such as 'swap_v1', its class, or a blueprint"
        raise TypeError(f"task is {task!r:.80}, but {rule}")
    if not found:
        raise ValueError("task is empty; give at least one blueprint")
    if options:
        raise TypeError(f"{', '.join(options)}: give options to the blueprint alone")
    return tuple(found)


def _row(batch: Any, k: int) -> Any:
    """Return observation k of a batch, which may be a dictionary of arrays."""
    if isinstance(batch, dict):
        return {name: part[k] for name, part in batch.items()}
    return batch[k]


def _equal(first: dict[str, Any], second: dict[str, Any]) -> bool:
    return first.keys() == second.keys() and all(
        np.array_equal(value, second[name]) for name, value in first.items()
    )
