"""Gymnasium vector environments: E teams in one batch, each as one agent or drone by drone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from swarm_envs.envs.config import RESET_OPTIONS, EnvConfig, check_num_envs
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import check_flat, joint_box, limited, split_teams
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.options import batch_of
from swarm_envs.envs.parallel import RENDER_MODES, warn_without_mode
from swarm_envs.envs.view import View
from swarm_envs.errors import check_bool, check_integer, check_name, check_type
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import Task

if TYPE_CHECKING:
    from swarm_envs.viewing.camera import Screen
    from swarm_envs.viewing.live import LiveViewer

Infos = dict[str, Any]  # Arrays by name, with an entry for each environment


class SwarmVectorEnv(VectorEnv[Float32Array, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """A batch of E teams. Make it with `gymnasium.make_vec("swarm_envs/Swap-v0", num_envs=E)`.

    Observations have shape (E, N * width), actions (E, N * width of the action); rewards (E,) are
    means over the team. `infos["rewards"]` (E, N) has each drone's reward, `infos["active"]`
    (E, N) is True for drones that took part in the decision, and `infos["episode_metrics"]` has
    the metrics of ended episodes, with Gymnasium's masks.

    With `per_agent=True`, every drone is a row, e * N + i for drone i of environment e:
    observations have shape (E * N, width), and actions, rewards and ends have a row for each drone
    too. All rows of a team are reset together. A row that ended earlier (`on_contact="end_pair"`)
    waits until then, with zero observations, reward 0 and `infos["active"]` False, and is
    terminated with the team again.

    Args:
        task: the task, with its team.
        config: the options; `observation` must be `flat`.
        num_envs: E.
        autoreset_mode: the reset after an episode's end: `NEXT_STEP` (the next step begins a new
            episode and ignores its action), `SAME_STEP` (the same step does; `final_obs` and
            `final_info` have the end), or `DISABLED` (`reset(options={"reset_mask": ...})`); or
            Gymnasium's names `"NextStep"`, `"SameStep"`, `"Disabled"`.
        per_agent: True for a row per drone instead of a row per team. Reset masks then have an
            entry for each team or for each row, equal within a team.
        render_mode: `rgb_array` (pictures), `human` (the first 16 environments in a browser, in
            real time) or None.
        max_episode_steps: number of decisions after which an episode is truncated, if `horizon_s`
            does not end it earlier. As with `gymnasium.wrappers.TimeLimit`, the observed remaining
            time does not change.
    """

    def __init__(
        self,
        task: Task,
        config: EnvConfig,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        per_agent: bool = False,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        if render_mode is not None:
            check_name("render_mode", render_mode, RENDER_MODES)
        check_num_envs(num_envs)
        modes = {mode.value: mode for mode in AutoresetMode}
        if not isinstance(autoreset_mode, AutoresetMode):
            check_name("autoreset_mode", autoreset_mode, modes)
        check_flat(config)
        self.mode = AutoresetMode(autoreset_mode)
        self.core = SwarmCore(task, config, num_envs)
        self.num_teams, drones = num_envs, self.core.num_drones
        check_bool("per_agent", per_agent)
        if max_episode_steps is not None:
            check_integer("max_episode_steps", max_episode_steps, 1)
        self._most_steps = max_episode_steps
        self.per_agent = per_agent
        self.num_envs = num_envs * drones if per_agent else num_envs
        self.metadata = {
            "autoreset_mode": self.mode,
            "render_modes": list(RENDER_MODES),
            "render_fps": config.decision_rate,
        }
        self.render_mode = render_mode
        self._pictures = Pictures(self.core, self.num_envs)
        self._entry: EnvSpec | None = None
        self._live: LiveViewer | None = None
        together = 1 if per_agent else drones
        width = self.core.rows.shape[-1]
        self.single_observation_space = joint_box((together, width), np.inf)
        edge = 1.0 if self.core.mode.bounded else np.inf
        self.single_action_space = joint_box((together, self.core.mode.width), edge)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended: BoolArray = np.ones(num_envs, dtype=np.bool_)
        self._begun: BoolArray = np.zeros(num_envs, dtype=np.bool_)

    @property
    def spec(self) -> EnvSpec | None:
        """The environment's entry in Gymnasium's registry, with the time limit in decisions."""
        return self._entry

    @spec.setter
    def spec(self, entry: EnvSpec | None) -> None:
        self._entry = limited(entry, self.core, self._most_steps)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Float32Array, Infos]:
        """Begin new episodes.

        Args:
            seed: the seed of environment 0, plus e for environment e; or a sequence of seeds.
            options: `start`, `goal` (N, 3), m, for every environment; `reset_mask` (E,) booleans,
                the environments to reset. With `per_agent`, seeds and mask may have an entry for
                each row instead, (E * N,), equal within a team.

        Raises:
            RuntimeError: the environment is closed.
            TypeError: seeds or options are of a wrong type.
            ValueError: an option is unknown, or a start or goal is impossible.
        """
        if self.closed:
            raise RuntimeError("reset() was called on a closed environment; make a new one")
        given = {} if options is None else options
        check_type("options", given, Mapping)
        given = dict(given)
        for name in given:
            check_name("reset option", name, (*RESET_OPTIONS, "reset_mask"))
        mask = given.pop("reset_mask", None)
        mask = None if mask is None else self._by_team("reset_mask", mask)
        self.core.reset(self._seeds(seed), mask, given)
        where = np.ones(self.num_teams, np.bool_) if mask is None else np.asarray(mask)
        self._ended[where] = False
        self._begun[where] = True
        if self.render_mode == "human":
            self.render()
        return self._observations(), {}

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[Float32Array, FloatArray, BoolArray, BoolArray, Infos]:
        """Simulate every environment until its next decision; resets follow `autoreset_mode`.

        Raises:
            RuntimeError: an environment has no running episode, or is closed.
            ValueError: actions have a wrong shape or an invalid number.
        """
        self._check_running()
        again = self._ended.copy()
        result = self.core.step(split_teams(actions, self.action_space.shape, self.core))
        if again.any():  # only with NEXT_STEP
            self.core.reset(mask=again)
        cut = result.truncated
        if self._most_steps is not None:
            cut = cut | (self.core.world.environments["decisions"] >= self._most_steps)
        over = (result.terminated | cut) & ~again
        self._ended[:] = over
        infos: Infos = {"active": result.active.copy()}
        if self.per_agent:
            ends = result.ended | (over[:, None] & ~result.active)  # waiting rows end again
            given = result.rewards, ends, cut[:, None] & ~ends
            again, infos = again[:, None], {"active": infos["active"].reshape(-1)}
        else:
            given = result.rewards.mean(axis=1), result.terminated, cut
            infos["rewards"] = result.rewards.copy()
        rewards = np.where(again, 0.0, given[0]).reshape(-1)
        terminated, truncated = ((part & ~again).reshape(-1) for part in given[1:])
        for e in np.flatnonzero(over).tolist():
            for row in self._rows_of(e):
                infos = self._add_info(infos, {"episode_metrics": self.core.metrics(e)}, row)
        if self.mode is AutoresetMode.SAME_STEP and over.any():
            infos = self._begin_again(over, infos)
        if self.render_mode == "human":
            self.render()
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> Any:
        """Return pictures of the rows' environments, each drawn when it is accessed.

        They are a sequence, as Gymnasium's wrappers expect: `envs.render()[0]` draws only the first
        environment. With `render_mode="human"`, the environments are shown in the browser. Without
        a render mode, it returns None with a warning.
        """
        if self.render_mode == "rgb_array":
            return self._pictures
        if self.render_mode is None:
            warn_without_mode()
            return None
        if self._live is None:
            from swarm_envs.viewing.live import LiveViewer

            self._live = LiveViewer(self.core)
        self._live.show()
        return None

    def _rows_of(self, e: int) -> range:
        """Return the rows of a team."""
        each = self.num_envs // self.num_teams
        return range(e * each, (e + 1) * each)

    def close_extras(self, **_: object) -> None:
        """Release the physics engine and the viewer."""
        if "core" in vars(self):  # Gymnasium 1.1 closes environments whose constructor raised
            self.core.close()
            if self._live is not None:
                self._live.close()

    def _begin_again(self, ended: BoolArray, infos: Infos) -> Infos:
        for e in np.flatnonzero(ended).tolist():
            rows = self._rows_of(e)
            ends = self.core.rows[e].reshape(len(rows), -1).copy()
            for row, last in zip(rows, ends, strict=True):
                final = {"episode_metrics": self.core.metrics(e)}
                infos = self._add_info(infos, {"final_obs": last, "final_info": final}, row)
        self.core.reset(mask=ended)
        self._ended[:] = False
        return infos

    def _check_running(self) -> None:
        if self.closed:
            raise RuntimeError("step() was called on a closed environment; make a new one")
        if not self._begun.all():
            raise RuntimeError("step() was called, but no episode has begun; call reset() first")
        if self.mode is AutoresetMode.DISABLED and self._ended.any():
            raise RuntimeError(
                f"step() was called, but the episodes of environments "
                f"{np.flatnonzero(self._ended).tolist()} have ended; reset them by "
                "reset(options={'reset_mask': ...})"
            )

    def _by_team(self, name: str, values: Any) -> npt.NDArray[Any]:
        """Return values (E,) of teams, given those of teams or of rows.

        Raises:
            ValueError: the rows of a team differ.
        """
        array = np.asarray(values)
        if not self.per_agent or array.shape != (self.num_envs,):
            return array
        rows = array.reshape(self.num_teams, -1)
        differ = np.flatnonzero((rows != rows[:, :1]).any(axis=1))
        if len(differ):
            raise ValueError(
                f"{name} is {rows[differ[0]].tolist()} for the drones of team {differ[0]}, but the "
                "rows of a team are reset together; give all of them the same"
            )
        return rows[:, 0]

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None] | None:
        if seed is None:
            return None
        if isinstance(seed, Sequence | np.ndarray):
            return list(self._by_team("seed", np.array(list(seed), dtype=object)))
        first = check_integer("seed", seed, 0)
        return [first + e for e in range(self.num_teams)]

    def _observations(self) -> Float32Array:
        return self.core.rows.reshape(self.num_envs, -1).copy()


class Pictures(Sequence[npt.NDArray[np.uint8]]):
    """The pictures of a batch, one for each row, drawn when it is accessed.

    Args:
        core: the environments.
        rows: number of rows; those of a team have the same picture.
    """

    def __init__(self, core: SwarmCore, rows: int) -> None:
        self._core, self._rows = core, range(rows)
        self._screens: dict[int, Screen] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, row: Any) -> Any:
        from swarm_envs.viewing.camera import Screen

        if isinstance(row, slice):
            return [self[r] for r in self._rows[row]]
        e = self._rows[row] * self._core.num_envs // len(self._rows)
        if e not in self._screens:
            self._screens[e] = Screen(self._core.task)
        return self._screens[e].render(View(self._core, e))


def make_vector(
    task: str,
    num_envs: int = 1,
    autoreset_mode: Any = "NextStep",
    per_agent: bool = False,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **options: Any,
) -> SwarmVectorEnv:
    """Return a batch of teams; options as for the task's `parallel_env()`."""
    made = batch_of(task, **options)
    views = autoreset_mode, per_agent, render_mode, max_episode_steps
    return SwarmVectorEnv(made.task, made.config, num_envs, *views)
