"""PettingZoo environments: parallel, with dictionaries by drone, and AEC, one drone at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress, repeat
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import logger, spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from swarm_envs.envs.actions import ActionMode, as_actions, check_actions
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import Snapshot, StepResult, SwarmCore
from swarm_envs.envs.observation import (
    Float32Array,
    Observation,
    ObservationField,
    observation_layout,
    observation_space,
    observation_width,
    shaper,
)
from swarm_envs.envs.view import View
from swarm_envs.errors import check_name, unknown_name
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE, Contacts
from swarm_envs.tasks.base import Task

__all__ = ["SwarmParallelEnv"]

RENDER_MODES = ("rgb_array", "human")


class SwarmParallelEnv(ParallelEnv[str, Observation, npt.NDArray[np.float32]]):
    """A swarm as a PettingZoo parallel environment. Make it with a task's `parallel_env()`.

    Agents are `drone_0` ... in the order of the team. Their episodes end together; with
    `on_contact="end_pair"`, drones that touch something leave `agents` before the others.
    `infos[agent]` has `reward_terms` (without their weights), on the last step `episode_metrics`,
    and `contact` if the drone touched something in this decision: its `drone` (a name), `floor` and
    `wall` (True) and `obstacle` (an index), as far as they were touched.
    """

    def __init__(
        self, task: Task, config: EnvConfig | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode is not None:
            check_name("render_mode", render_mode, RENDER_MODES)
        self.core = SwarmCore(task, config or EnvConfig())
        self.render_mode = render_mode
        self.metadata = {
            "name": task.name,
            "render_modes": list(RENDER_MODES),
            "render_fps": self.core.config.decision_rate,
            "is_parallelizable": True,
        }
        self.possible_agents = [f"drone_{i}" for i in range(self.core.num_drones)]
        self.agents: list[str] = []
        self._screen: Any = None
        self._live: Any = None
        self._closed = False
        form = self.core.form
        space, self._shape = observation_space(*form), shaper(*form)
        self.observation_spaces = dict.fromkeys(self.possible_agents, space)
        size = (self.core.num_drones * observation_width(0),)
        self.state_space = spaces.Box(-np.inf, np.inf, size, np.float32)
        mode = self.core.mode
        edge = 1.0 if mode.bounded else np.inf
        self.action_spaces = {
            agent: spaces.Box(-edge, edge, (mode.width,), np.float32)
            for agent in self.possible_agents
        }

    @property
    def physics_name(self) -> str:
        """The name of the physics engine: `bullet` or `batch`."""
        return self.core.physics.name

    @property
    def observation_layout(self) -> tuple[ObservationField, ...]:
        """The name, slice, unit and scale of each field of an observation."""
        return observation_layout(*self.core.form[1:])

    @property
    def np_random(self) -> np.random.Generator:
        """The random generator of the episodes, seeded by `reset`; some wrappers use it too."""
        return self.core.generators[0]

    @property
    def view(self) -> View:
        """The true state, for privileged agents and for plots."""
        return View(self.core)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space, the same for every agent."""
        self._index(agent)
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """Return an agent's action space; each agent's space has its own random generator."""
        self._index(agent)
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin an episode.

        Args:
            seed: seed of the environment's random generator; None continues with the generator.
            options: options of this episode. `start`, `goal`: (N, 3) positions, m, in tasks in
                which they can be set. `team`: N vehicles, or a string, instead of the constructor's
                team; spaces and agents do not change.

        Raises:
            ValueError: an option is unknown, or a start, goal or team is impossible. Nothing was
                changed.
        """
        self._check_open("reset")
        rows = self.core.reset([seed], options=options)
        self.agents = list(self.possible_agents)
        if self.render_mode == "human":
            self.render()
        return self.split(rows), {agent: {} for agent in self.agents}

    def step(
        self, actions: Mapping[str, npt.ArrayLike]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Simulate until the next decision.

        Args:
            actions: one for each of `agents`; those of agents that have left are not used.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent. All are empty if
            the episode has ended and `actions` is empty, since black-death wrappers step once more.

        Raises:
            RuntimeError: no episode is running: `reset()` was not called, or the episode has ended.
            ValueError: an action is missing, superfluous, of wrong shape, not finite or outside
                its bounds. Nothing was changed.
        """
        if not self.agents:
            if isinstance(actions, Mapping) and not actions and self._has_ended():
                return {}, {}, {}, {}, {}
            self.check_running()
        result, agents = self.core.step(self.join(actions)), self.agents
        over, cut = bool(result.terminated[0] | result.truncated[0]), bool(result.truncated[0])
        infos = infos_by_agent(self.core, self.possible_agents, result, over)
        observations = self.split(result.observations)
        rewards = dict(zip(self.possible_agents, result.rewards[0].tolist(), strict=True))
        ends = dict(zip(self.possible_agents, result.ended[0].tolist(), strict=True))
        if len(agents) < len(ends):  # some have left in earlier decisions
            observations, rewards, ends, infos = (
                {agent: by_agent[agent] for agent in agents}
                for by_agent in (observations, rewards, ends, infos)
            )
        cuts = dict.fromkeys(agents, cut)
        if over or True in ends.values():
            cuts = {agent: cut and not end for agent, end in ends.items()}
            self.agents = [] if over else [agent for agent, end in ends.items() if not end]
        if self.render_mode == "human":
            self.render()
        return observations, rewards, ends, cuts, infos

    def state(self) -> Float32Array:
        """Return the true state of the whole team, without noise, for centralized critics.

        It consists of the `self` and `task` fields of each drone, in the order of the team; see
        `observation_layout` with no neighbors.
        """
        self._check_open("state")
        return self.core.team_state().reshape(-1).copy()

    def get_state(self) -> Snapshot:
        """Return a snapshot of the whole state, for `set_state`."""
        self._check_open("get_state")
        return self.core.get_state()

    def set_state(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of this environment, or of another with the same options.

        The environment then continues bitwise as the first one did.

        Raises:
            TypeError: it is no snapshot.
            ValueError: it is of an environment with other options.
        """
        self._check_open("set_state")
        self.core.set_state(snapshot)
        active = self.core.world.drones["active"][0] * self.core.running[0]
        self.agents = list(compress(self.possible_agents, active.tolist()))

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return an RGB picture (height, width, 3) of the swarm, drawn on the CPU.

        With `render_mode="human"`, every reset and step shows the flight in a browser, in real
        time; the address is printed. Without a render mode, it returns None with a warning.
        """
        self._check_open("render")
        if self.render_mode == "rgb_array":
            if self._screen is None:
                from swarm_envs.viewing.camera import Screen

                self._screen = Screen(self.core.task)
            return self._screen.render(self.view)
        if self.render_mode == "human":
            if self._live is None:
                from swarm_envs.viewing.live import LiveViewer

                self._live = LiveViewer(self.core)
            self._live.show()
        if self.render_mode is None:
            warn_without_mode()
        return None

    def close(self) -> None:
        """Release the physics engine and the viewer. May be called more than once."""
        self._closed = True
        self.agents = []
        self.core.close()
        if self._live is not None:
            self._live.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle as options and a snapshot: the copy has its own simulator."""
        self._check_open("pickling")
        options = (type(self), self.core.task, self.core.config, self.render_mode)
        return _rebuilt, (*options, self.core.get_state(), self.core.reward_weights)

    def check_running(self) -> None:
        """Check that an episode is running.

        Raises:
            RuntimeError: the environment is closed, or no episode is running.
        """
        self._check_open("step")
        if not self.agents:
            why = "the episode has ended" if self._has_ended() else "no episode has begun"
            raise RuntimeError(f"step() was called, but {why}; call reset() first")

    def _has_ended(self) -> bool:
        return not (self._closed or self.agents) and bool(self.core.time[0] > 0)

    def _check_open(self, what: str) -> None:
        if self._closed:
            raise RuntimeError(f"{what}() was called on a closed environment; make a new one")

    def _index(self, agent: str) -> int:
        check_name("agent", agent, self.possible_agents)
        return self.possible_agents.index(agent)

    def join(self, actions: Mapping[str, npt.ArrayLike]) -> npt.NDArray[np.float64]:
        """Return the agents' actions as an array (1, N, width); raises as `step` does.

        Actions of drones whose episodes have ended are zeros.
        """
        if len(self.agents) == self.core.num_drones:
            return join_actions(self.core.mode, self.agents, actions)
        left = set(self.possible_agents) - set(self.agents)
        if isinstance(actions, Mapping):  # TorchRL also gives actions of agents that have left
            actions = {agent: action for agent, action in actions.items() if agent not in left}
        joined = join_actions(self.core.mode, self.agents, actions)
        padded = np.zeros((1, self.core.num_drones, self.core.mode.width))
        padded[0, [self._index(agent) for agent in self.agents]] = joined[0]
        return padded

    def split(self, rows: Float32Array) -> dict[str, Observation]:
        """Return the observations of all drones, by agent, from rows (1, N, width)."""
        own: Any = rows[0].copy()
        if self.core.config.observation != "flat":
            own = map(self._shape, own)
        # Not strict: the iterator of an array ends by an exception, which takes as long as the rest
        return dict(zip(self.possible_agents, own, strict=False))


def warn_without_mode() -> None:
    """Warn that `render()` shows nothing without a mode, in Gymnasium's words."""
    logger.warn(
        "You are calling render method without specifying any render mode. Specify it when the "
        'environment is made, e.g. render_mode="human"'
    )


def _rebuilt(
    kind: type[SwarmParallelEnv],
    task: Task,
    config: EnvConfig,
    render_mode: str | None,
    snapshot: Snapshot,
    weights: Mapping[str, float],
) -> SwarmParallelEnv:
    """Return an environment in the state of another, for `pickle` and `copy`."""
    env = kind(task, config, render_mode)
    env.core.set_reward_weights(weights)
    env.set_state(snapshot)
    return env


def join_actions(
    mode: ActionMode, agents: Sequence[str], actions: Mapping[str, npt.ArrayLike]
) -> npt.NDArray[np.float64]:
    """Return the agents' actions as an array (1, N, width).

    Raises:
        TypeError: they are no mapping.
        ValueError: one is missing, superfluous, of wrong shape or no numbers.
    """
    if not isinstance(actions, Mapping):
        raise TypeError(
            f"actions are {type(actions).__name__}, but must be a dict with an action for each of "
            "env.agents"
        )
    rows = [actions[agent] for agent in agents if agent in actions]
    if not len(rows) == len(agents) == len(actions):
        _refuse_agents(agents, actions)
    try:
        joined = np.array(rows)
    except (ValueError, TypeError):
        joined = np.empty(0)
    if joined.shape != (len(rows), mode.width):
        for agent, row in zip(agents, rows, strict=True):
            if np.shape(row) != (mode.width,):
                raise ValueError(
                    f"action of {agent!r} has shape {np.shape(row)}, but action {mode.name!r} "
                    f"takes {mode.width} numbers: shape ({mode.width},)"
                )
    if joined.dtype.kind not in "fiu":
        raise ValueError(
            f"actions are of type {joined.dtype}, but must be numbers, such as float32"
        )
    return joined[None]


def _refuse_agents(agents: Sequence[str], actions: Mapping[str, npt.ArrayLike]) -> None:
    for agent in actions:
        if agent not in agents:
            raise ValueError(unknown_name("agent", agent, agents, "in actions"))
    missing = [agent for agent in agents if agent not in actions]
    raise ValueError(f"actions lack {missing}; give one for each of env.agents")


def infos_by_agent(
    core: SwarmCore, agents: Sequence[str], result: StepResult, ended: bool
) -> dict[str, dict[str, Any]]:
    """Return the infos of a step of a core's only environment, by agent.

    Args:
        core: the core.
        agents: names of all agents, in the order of the team.
        result: the result of the core's last step.
        ended: True if the episode has ended; the infos then have the metrics.
    """
    named = map(zip, repeat(core.task.reward_names), result.reward_terms[:, 0].T.tolist())
    infos: dict[str, dict[str, Any]] = {
        agent: {"reward_terms": terms}
        for agent, terms in zip(agents, map(dict, named), strict=True)
    }
    if ended or core.config.on_contact != "end_team":  # else a contact ends the episode
        contacts = core.physics.contacts
        for i in contacts.any()[0].nonzero()[0].tolist():
            infos[agents[i]]["contact"] = _contact(contacts, i, agents)
    if ended:
        for info in infos.values():
            info["episode_metrics"] = core.metrics()
    return infos


def _contact(contacts: Contacts, i: int, agents: Sequence[str]) -> dict[str, Any]:
    """Return what drone `i` touched in its last decision."""
    touched: dict[str, Any] = {}
    if contacts.drone[0, i] != NO_DRONE:
        touched["drone"] = agents[contacts.drone[0, i]]
    if contacts.floor[0, i]:
        touched["floor"] = True
    if contacts.wall[0, i]:
        touched["wall"] = True
    if contacts.obstacle[0, i] != NO_OBSTACLE:
        touched["obstacle"] = int(contacts.obstacle[0, i])
    return touched


class SwarmTurnEnv(parallel_to_aec_wrapper[str, Any, Any]):
    """A swarm as a PettingZoo AEC environment. Make it with a task's `env()`.

    The simulation advances when the last drone has acted; until then all drones observe the same
    instant. An invalid action raises in the turn of its agent. `unwrapped` is the
    `SwarmParallelEnv`.
    """

    env: SwarmParallelEnv  # The wrapped parallel environment

    def step(self, action: npt.ArrayLike | None) -> None:
        """Take an action for the agent whose turn it is; None if its episode has ended.

        Raises:
            RuntimeError: the environment is closed.
            ValueError: the action has a wrong shape, is not finite or outside its bounds, or is
                not None after the end. Nothing was changed.
        """
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            if action is not None:
                raise ValueError(
                    f"the episode of {agent!r} has ended; its only action is None, until reset()"
                )
        else:
            self._check(agent, action)
        super().step(action)

    def _check(self, agent: str, action: npt.ArrayLike | None) -> None:
        self.env.check_running()
        core = self.env.core
        others = np.zeros(core.mode.width, dtype=np.bool_)  # so that the action decides the dtype
        actions: dict[str, Any] = dict.fromkeys(self.env.agents, others)
        joined = self.env.join(actions | {agent: action})
        shape = (1, core.num_drones, core.mode.width)
        clip = core.config.clip_actions
        check_actions(core.mode, as_actions(core.mode, joined, shape, clip))
