"""The process of a work: reads a student's file, asks it, and answers the grader with numbers.

`python -m swarm_envs.commands.grading.child`, with messages on its standard input and output. It
confines itself first. What runs here may be replaced by the student's code, so nothing that it
says is believed: it can only act badly.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from swarm_envs.commands.grading.confinement import (
    Limits,
    drop_capabilities,
    hide_files,
    keep_in_memory,
    limit_self,
    see_only,
    stay_alone,
)
from swarm_envs.commands.grading.messages import Array, Channel

_LONGEST = 2000  # characters of an error; the grader keeps fewer


def _twin(header: Mapping[str, Any], requires: Mapping[str, Any], channel: Channel) -> Any:
    """An environment of the same options as the grader's, where nothing flies.

    Its `view` is a copy of what the grader's shows now; the grader notes who asks for it.
    """
    from swarm_envs.envs.options import blueprint_of
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.envs.view import View

    class Twin(SwarmParallelEnv):
        @property
        def view(self) -> View:
            channel.send({"kind": "view"})
            tables = channel.receive()[1]
            for mine, given in zip(self.core.world, tables, strict=True):
                mine[...] = given.view(mine.dtype).reshape(mine.shape)
            return super().view

    twin = Twin(*blueprint_of(header["task"], **{**header["options"], **requires})[:2])
    twin.agents = list(twin.possible_agents)
    return twin


class _Flyer:
    """A work that flies."""

    def __init__(self, name: str, channel: Channel) -> None:
        from swarm_envs.agents.protocol import BatchAgent
        from swarm_envs.agents.registry import load_agent

        self._agent: Any = load_agent(name)
        self._requires = dict(self._agent.requires)
        self._privileged = bool(self._agent.privileged)
        self._channel = channel
        self._env: Any = None
        self.made = {
            "requires": json.loads(json.dumps(self._requires, default=_plain)),
            "privileged": self._privileged,
            "batched": isinstance(self._agent, BatchAgent),
        }

    def train(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Let the agent learn."""
        self._agent.train(header["seconds"])
        return []

    def reset(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Prepare the agent for an episode."""
        self._env = self._env or _twin(header, self._requires, self._channel)
        self._agent.reset(self._env, header["seed"])
        return []

    def act(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Actions (1, N, width) for rows (N, row width)."""
        env = self._env
        view = env.view if self._privileged else None
        return [env.join(self._agent.act(env.split(arrays[0][None]), view))]

    def batch(self, header: Mapping[str, Any], arrays: list[Array]) -> list[Array]:
        """Actions (E, N, width) for rows (E, N, row width)."""
        import numpy as np

        return [np.asarray(self._agent.act_batch(arrays[0])).astype(np.float64)]


def _plain(value: Any) -> Any:
    """What JSON cannot say, as a number or in words, which no option takes."""
    return value.item() if hasattr(value, "item") else repr(value)


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
    scratch, limits = Path(header["scratch"]), Limits(*header["limits"])
    if header["mounts"]:
        keep_in_memory(scratch, limits.disk)
    if header["kernels"] is not None:
        with suppress(OSError):  # another user's, which this one may not read
            shutil.copytree(header["kernels"], scratch / "kernels", dirs_exist_ok=True)
    if not (header["mounts"] or header["landlock"]):  # it could write where everybody may
        limits = limits._replace(file_size=0)
    limit_self(limits, header["tasks"])
    if header["mounts"]:
        see_only(header["readable"], scratch)
    drop_capabilities()
    if header["landlock"]:
        hide_files(header["landlock"], header["readable"], [str(scratch), os.devnull])
    stay_alone(header["core"])


if __name__ == "__main__":
    run_work()
    sys.stdout.flush()
