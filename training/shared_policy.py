"""Stable-Baselines3's interface: every drone of E environments as an environment of its own.

One policy flies all of them (parameter sharing), and they fly in one batched call.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from swarm_envs.envs.config import check_num_envs
from swarm_envs.envs.core import StepResult, SwarmCore
from swarm_envs.envs.joint import split_teams
from swarm_envs.envs.observation import observation_space, shaper
from swarm_envs.envs.options import Blueprint, batch_of
from swarm_envs.errors import check_integer
from swarm_envs.state import FloatArray

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        "SharedPolicyVecEnv needs Stable-Baselines3; install it by: pip install 'swarm-envs[train]'"
    ) from error

Infos = list[dict[str, Any]]
"""What a step adds for each sub-environment."""


class SharedPolicyVecEnv(VecEnv):  # type: ignore[misc]  # SB3's base has no types here
    """E environments of N drones as E * N sub-environments: number e * N + i is drone i of e.

    All drones of an environment end together, and begin anew in the same step. A sub-environment's
    info has at the end `terminal_observation`, `TimeLimit.truncated` (cut by the clock: what
    follows still has a value) and `episode_metrics`, the same for all drones of an environment.
    Where no episode has ended, sub-environments share one info: copy it to write into it.

    Its copies and pickles have simulators of their own, and fly on as it would.

    Args:
        task: name of the task, such as `swap_v0`; or a blueprint, made with a task of one's own.
        num_envs: E.
        seed: of environment 0, counted up for the others.
        **options: as the task's `parallel_env()` takes them; the batched engine flies unless
            `physics` says otherwise. None with a blueprint, which has them already.

    Raises:
        TypeError: an option does not exist, or has a wrong type.
        ValueError: there is no such task, or an option has an impossible value.
    """

    def __init__(
        self, task: str | Blueprint, num_envs: int = 1, seed: int | None = None, **options: Any
    ) -> None:
        count = check_num_envs(num_envs)
        if not isinstance(task, str | Blueprint):
            rule = "must be a task's name, such as 'swap_v0', or a blueprint"
            raise TypeError(f"task is {task!r:.80}, but {rule}")
        if not isinstance(task, str) and options:
            raise TypeError(f"{', '.join(options)}: give options to the blueprint, not beside it")
        blueprint = batch_of(task, **options) if isinstance(task, str) else task
        self.core = SwarmCore(blueprint.task, blueprint.config, count)
        drones, edge = self.core.num_drones, 1.0 if self.core.mode.bounded else np.inf
        self._shape = shaper(*self.core.form)
        self.render_mode = None
        super().__init__(
            count * drones,
            observation_space(*self.core.form),
            spaces.Box(-edge, edge, (self.core.mode.width,), np.float32),
        )
        self._actions: FloatArray = np.zeros((count, drones, self.core.mode.width))
        self._next_seeds: list[int | None] | None = None
        self._begun = self._closed = False
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset: environment e by `seed` + e; every drone of it alike."""
        if seed is None:
            self._next_seeds = None
            return [None] * self.num_envs
        first = check_integer("seed", seed, 0)
        self._next_seeds = [first + e for e in range(self.core.num_envs)]
        return [seed for seed in self._next_seeds for _ in range(self.core.num_drones)]

    def reset(self) -> Any:
        """Begin new episodes everywhere, with what `seed()` and `set_options()` were given.

        Raises:
            RuntimeError: the environment is closed.
            ValueError: an option is unknown or impossible, or differs within an environment.
        """
        self._check_open("reset")
        self._place()
        self._next_seeds, self._begun = None, True
        self._reset_options()
        self.reset_infos: Infos = [{} for _ in range(self.num_envs)]
        return self._observations()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keep the actions (E * N, width) for `step_wait`.

        Raises:
            RuntimeError: no episode has begun, or the environment is closed.
            ValueError: they are of another shape, or no numbers.
        """
        self._check_open("step")
        if not self._begun:
            raise RuntimeError("step() was called, but no episode has begun; call reset() first")
        self._actions = split_teams(actions, (self.num_envs, self.core.mode.width), self.core)

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Fly to the next decision, and begin new episodes where one has ended.

        Raises:
            ValueError: an action is not finite or outside its bounds; nothing has changed then.
        """
        result = self.core.step(self._actions)
        ended = result.terminated | result.truncated
        infos: Infos = [{"TimeLimit.truncated": False}] * self.num_envs
        if ended.any():
            self._report_ends(result, ended, infos)
            self.core.reset(mask=ended)
        rewards = result.rewards.reshape(-1).astype(np.float32)
        return self._observations(), rewards, np.repeat(ended, self.core.num_drones), infos

    def _report_ends(self, result: StepResult, ended: npt.NDArray[np.bool_], infos: Infos) -> None:
        drones = self.core.num_drones
        over = np.flatnonzero(ended)
        environments, last = over.tolist(), self.core.rows[over]
        told = self.core.metrics_of(environments)
        for e, rows, metrics in zip(environments, last, told, strict=True):
            for i in range(drones):
                infos[e * drones + i] = {
                    "TimeLimit.truncated": bool(result.truncated[e]),
                    "terminal_observation": self._shape(rows[i]),
                    "episode_metrics": metrics,
                }

    def _observations(self) -> Any:
        return self._shape(self.core.rows.reshape(self.num_envs, -1).copy())

    def close(self) -> None:
        """Free what physics holds."""
        self._closed = True
        self.core.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """No pictures: fly an episode with `parallel_env(render_mode="rgb_array")` for those."""
        return [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The core's attribute, once for each sub-environment."""
        value = getattr(self.core, attr_name) if attr_name != "render_mode" else None
        return [value] * len(self._indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: sub-environments are views of one core.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"cannot set {attr_name!r} on single drones of a batch; make another "
            "SharedPolicyVecEnv with the options you want"
        )

    def env_method(
        self, method_name: str, *arguments: Any, indices: Any = None, **options: Any
    ) -> list[Any]:
        """Call a method of the core once, and give its result for each sub-environment."""
        value = getattr(self.core, method_name)(*arguments, **options)
        return [value] * len(self._indices(indices))

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No sub-environment is wrapped: wrap this one, as with `VecMonitor`."""
        return [False] * len(self._indices(indices))

    def __getstate__(self) -> dict[str, Any]:
        """All but the function that shapes observations, which cannot be pickled."""
        self._check_open("pickling")
        return {name: value for name, value in vars(self).items() if name != "_shape"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what a pickle holds, and make the rest anew."""
        self.__dict__.update(state)
        self._shape = shaper(*self.core.form)

    def _check_open(self, what: str) -> None:
        if self._closed:
            raise RuntimeError(f"{what}() was called on a closed environment; make a new one")

    def _place(self) -> None:
        envs, drones = self.core.num_envs, self.core.num_drones
        if len(self._options) != self.num_envs:
            raise ValueError(
                f"options has {len(self._options)} entries, but must have {self.num_envs}: one for "
                "each drone of each environment, or be one dictionary for all"
            )
        if not any(self._options):
            self.core.reset(self._next_seeds)
            return
        for e in range(envs):
            first, *others = self._options[e * drones : (e + 1) * drones]
            if not all(other is first or _equal(first, other) for other in others):
                raise ValueError(
                    f"options of environment {e} differ between its drones; give all "
                    f"{drones} of them the same"
                )
        before = self.core.get_state()
        try:
            for e in range(envs):
                self.core.reset(self._next_seeds, np.arange(envs) == e, self._options[e * drones])
        except Exception:  # one is refused: none has begun
            self.core.set_state(before)
            raise

    def _indices(self, indices: Any) -> list[int]:
        return list(self._get_indices(indices))


def _equal(first: dict[str, Any], second: dict[str, Any]) -> bool:
    """Whether two reset options say the same."""
    return first.keys() == second.keys() and all(
        np.array_equal(value, second[name]) for name, value in first.items()
    )
