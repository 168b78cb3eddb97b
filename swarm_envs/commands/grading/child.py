"""The process of a work: reads a student's file, asks it, and answers the grader with numbers.

`python -m swarm_envs.commands.grading.child`, with messages on its standard input and output. It
confines itself first. What runs here may be replaced by the student's code, so nothing that it
says is believed: it can only act badly.
"""

from __future__ import annotations

import os
import shutil
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from swarm_envs.commands.grading.confinement import (
    LINUX,
    Limits,
    drop_capabilities,
    hide_files,
    keep_in_memory,
    limit_self,
)
from swarm_envs.commands.grading.messages import Array, Channel

if TYPE_CHECKING:
    from swarm_envs.commands.grading.views import ViewCopy
    from swarm_envs.trajectories import Reference

_LONGEST = 2000  # characters of an error; the grader keeps fewer


class StandIn:
    """What a work is given for an environment: names, spaces and layout; nothing flies.

    Args:
        header: of the grader's message.
        requires: options that the agent requires.
        channel: to ask the grader for the truth.
    """

    physics_name = "batch"
    """The engine that flies at the grader's."""

    def __init__(
        self, header: Mapping[str, Any], requires: Mapping[str, Any], channel: Channel
    ) -> None:
        from swarm_envs.envs.actions import ACTIONS
        from swarm_envs.envs.config import EnvConfig
        from swarm_envs.envs.observation import observation_layout, shaper
        from swarm_envs.vehicles import parse_team

        config, team = EnvConfig(**requires), parse_team(header["team"])
        obstacles = config.obstacles_observed(0)
        self.possible_agents = [f"drone_{i}" for i in range(len(team))]
        self.agents = list(self.possible_agents)
        extra = (bool(config.observe_load), config.observe_force is not None)
        self._form = (config.num_neighbors, obstacles, *extra)
        self.observation_layout = observation_layout(*self._form)
        self.core = SimpleNamespace(
            config=config,
            mode=ACTIONS[config.action],
            num_drones=len(team),
            num_obstacles=obstacles,
            task=SimpleNamespace(name=header["task"], team=team, obstacles=()),
        )
        self.metadata = {"name": header["task"], "render_fps": config.decision_rate}
        self.shape = shaper(config.observation, *self._form)
        self._channel = channel

    @property
    def observation_spaces(self) -> dict[str, Any]:
        """The space of each agent's observation."""
        from swarm_envs.envs.observation import observation_space

        space = observation_space(self.core.config.observation, *self._form)
        return dict.fromkeys(self.possible_agents, space)

    @property
    def action_spaces(self) -> dict[str, Any]:
        """The Box of each agent's action."""
        import numpy as np
        from gymnasium import spaces

        mode = self.core.mode
        edge = 1.0 if mode.bounded else np.inf
        return {
            agent: spaces.Box(-edge, edge, (mode.width,), np.float32)
            for agent in self.possible_agents
        }

    def observation_space(self, agent: str) -> Any:
        """The space of an agent's observation."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """The Box of an agent's action."""
        return self.action_spaces[agent]

    @property
    def view(self) -> ViewCopy:
        """A copy of the truth as it is now; the grader notes who asks for it."""
        from swarm_envs.commands.grading.views import ViewCopy

        self._channel.send({"kind": "view"})
        header, arrays = self._channel.receive()
        return ViewCopy(header, arrays, self._reference)

    def _reference(self, time: float) -> Reference:
        from swarm_envs.trajectories import Reference

        self._channel.send({"kind": "reference", "time": float(time)})
        return Reference(*self._channel.receive()[1])


class _Flyer:
    """A work that flies."""

    def __init__(self, name: str, channel: Channel) -> None:
        from swarm_envs.agents.protocol import BatchAgent
        from swarm_envs.agents.registry import load_agent
        from swarm_envs.commands.grading.requirements import to_plain

        self._agent: Any = load_agent(name)
        self._requires = dict(self._agent.requires)
        self._privileged = bool(self._agent.privileged)
        self._channel = channel
        self._env: StandIn | None = None
        self.made = {
            "requires": to_plain(self._requires),
            "privileged": self._privileged,
            "batched": isinstance(self._agent, BatchAgent),
        }

    def train(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Let the agent learn."""
        self._agent.train(header["seconds"])
        return []

    def reset(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Prepare the agent for an episode."""
        self._env = self._env or StandIn(header, self._requires, self._channel)
        self._agent.reset(self._env, header["seed"])
        return []

    def act(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Actions (1, N, width) for rows (N, row width)."""
        from swarm_envs.envs.parallel import join_actions

        env: Any = self._env
        rows = map(env.shape, arrays[0])
        view = env.view if self._privileged else None
        given = self._agent.act(dict(zip(env.agents, rows, strict=True)), view)
        return [join_actions(env.core.mode, env.agents, given)]

    def batch(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Actions (E, N, width) for rows (E, N, row width)."""
        import numpy as np

        return [np.asarray(self._agent.act_batch(arrays[0])).astype(np.float64)]


class _Model:
    """A work that predicts forces."""

    def __init__(self, name: str, channel: Channel) -> None:
        from swarm_envs.agents.registry import load_class

        self._model: Any = load_class(name)()
        self.made: dict[str, Any] = {}

    def fit(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Fit the model to rows."""
        self._model.fit(_rows(header, arrays))
        return []

    def predict(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Vertical forces (R,) of rows, gram-force."""
        import numpy as np

        return [np.asarray(self._model.predict(_rows(header, arrays)), np.float64)]


class _Planner:
    """A work that plans for one drone of the assignment `distributed-mpc`."""

    def __init__(self, name: str, channel: Channel) -> None:
        from swarm_envs.agents.registry import load_class

        self._planner: Any = load_class(name)()
        self.made: dict[str, Any] = {}

    def reset(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Begin an episode."""
        self._planner.reset(header["drone"], arrays[0])
        return []

    def plan(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Accelerations (HORIZON, 3) of the drone, m/s^2."""
        import numpy as np

        return [np.asarray(self._planner.plan(*arrays), np.float64)]


def _rows(header: Mapping[str, Any], arrays: list[Array]) -> Any:
    from swarm_envs.training.interaction_rows import InteractionRows

    given: dict[str, Any] = dict(zip(header["names"], arrays, strict=True))
    names: dict[str, Any] = {key: tuple(header[key]) for key in ("types", "scenario_names")}
    return InteractionRows(**given, **names)


def run_work() -> None:
    """Answer until the grader asks no more."""
    channel = Channel(os.dup(0), os.dup(1))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    header, _ = channel.receive()
    _confine(header)
    try:
        kinds: dict[str, Any] = {"fly": _Flyer, "fit": _Model, "plan": _Planner}
        work = kinds[header["what"]](header["work"], channel)
    except (Exception, SystemExit) as error:
        channel.send(_described(error, header["work"]))
        return
    channel.send({"kind": "made", **work.made})
    with suppress(EOFError):
        while True:
            _answer(channel, work, header["work"])


def _answer(channel: Channel, work: Any, name: str) -> None:
    header, arrays = channel.receive()
    try:
        answer = getattr(work, header["kind"])(header, arrays)
    except (Exception, SystemExit) as error:
        channel.send(_described(error, name))
        return
    channel.send({"kind": "answer"}, answer)


def _described(error: BaseException, name: str) -> dict[str, Any]:
    """An error's kind and words, and where in the student's file it came from."""
    file = name.rpartition(":")[0]
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    place = f" (line {lines[-1]} of {Path(file).name})" if lines else ""
    try:
        words = f"{type(error).__name__}: {error}"[:_LONGEST]
    except (Exception, SystemExit):  # the error's own words are the student's code too
        words = f"{type(error).__name__[:_LONGEST]}, which cannot say why"
    return {"kind": "error", "refused": isinstance(error, ValueError), "words": words + place}


def _confine(header: Mapping[str, Any]) -> None:
    scratch = Path(header["scratch"])
    limits = Limits(*header["limits"])
    if header["mounts"]:
        keep_in_memory(scratch, limits.disk)
    if header["kernels"] is not None:
        shutil.copytree(header["kernels"], scratch / "kernels", dirs_exist_ok=True)
    if not header["landlock"]:  # it could write into any file of this user
        limits = limits._replace(file_size=0)
    limit_self(limits, header["tasks"])
    if LINUX:
        drop_capabilities()
    if header["landlock"]:
        hide_files(header["landlock"], header["readable"], [str(scratch), os.devnull])


if __name__ == "__main__":
    run_work()
    sys.stdout.flush()
