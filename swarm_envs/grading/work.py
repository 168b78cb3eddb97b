"""The process of a submission: loads a student's file and answers the grader's requests.

It is run as `python -m swarm_envs.grading.work` in the submission's folder, with messages on its
standard input and output. The student's code may replace anything in this process, so the grader
trusts nothing that it sends.
"""

from __future__ import annotations

import json
import os
import shutil
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from swarm_envs.grading.pipes import Array, receive, send

_MOST = 1 << 31  # Most bytes of a message from the grader
_LONGEST = 2000  # Most characters of an error; the grader shortens it further
_TRUTH = ("state", "goals", "setpoint", "reference", "oracle_force", "contacts", "time")
_LIMITS = {"FSIZE": 64 << 20, "NOFILE": 256, "CORE": 0}  # Resource limits of each process


class _Flyer:
    """A submission that is an agent; its methods answer requests of their names."""

    def __init__(self, name: str) -> None:
        from swarm_envs.agents import SafetyFilter
        from swarm_envs.agents.protocol import BatchAgent
        from swarm_envs.agents.registry import load_agent

        if ".py:" in name:
            setattr(SafetyFilter, "__init__", _refuse_filter)  # noqa: B010  for mypy
        self._agent: Any = load_agent(name)
        self._requires, self._env = dict(self._agent.requires), None
        self.made = {
            "requires": json.loads(json.dumps(self._requires, default=_plain)),
            "privileged": bool(self._agent.privileged),
            "batched": isinstance(self._agent, BatchAgent),
        }

    def train(self, header: Mapping[str, Any]) -> None:
        """Let the agent learn."""
        self._agent.train(header["seconds"])

    def reset(self, header: Mapping[str, Any]) -> None:
        """Prepare the agent for an episode with an environment that is not simulated."""
        self._env = self._env or _twin(header["task"], {**header["options"], **self._requires})
        self._agent.reset(self._env, header["seed"])

    def act(self, header: Mapping[str, Any], rows: Array) -> Array:
        """Return actions (1, N, width) for rows (N, row width)."""
        env: Any = self._env
        return env.join(self._agent.act(env.split(rows[None]), None))

    def batch(self, header: Mapping[str, Any], rows: Array) -> Array:
        """Return actions (E, N, width) for rows (E, N, row width)."""
        return np.asarray(self._agent.act_batch(rows))


def _refuse_filter(*_: object) -> None:
    raise RuntimeError(
        "SafetyFilter is not allowed in submissions; write your own collision avoidance"
    )


def _twin(task: str, options: Mapping[str, Any]) -> Any:
    from swarm_envs.envs.options import blueprint_of
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.envs.view import View

    class Shown(View):
        def __getattribute__(self, name: str) -> Any:
            if name in _TRUTH:
                raise RuntimeError(
                    f"env.view.{name} is part of the true state, which submissions do not "
                    "receive; use observations"
                )
            return super().__getattribute__(name)

    class Twin(SwarmParallelEnv):
        @property
        def view(self) -> View:
            return Shown(self.core)

    twin = Twin(*blueprint_of(task, **options)[:2])
    twin.agents = list(twin.possible_agents)
    return twin


def _plain(value: Any) -> Any:
    """Convert a value for JSON, to a number or to a text, which is refused as an option later."""
    return value.item() if hasattr(value, "item") else repr(value)


class _Made:
    """A submission whose class is called without arguments."""

    def __init__(self, name: str) -> None:
        from swarm_envs.user_files import load_from_file

        self._work, self.made = load_from_file(name)(), dict[str, Any]()

    def fit(self, header: Mapping[str, Any], *arrays: Array) -> None:
        """Fit a force model to rows."""
        self._work.fit(_rows(header, arrays))

    def predict(self, header: Mapping[str, Any], *arrays: Array) -> Array:
        """Return vertical forces (R,) of rows, gram-force."""
        return np.asarray(self._work.predict(_rows(header, arrays)))

    def reset(self, header: Mapping[str, Any], goal: Array) -> None:
        """Begin an episode of a planner."""
        self._work.reset(header["drone"], goal)

    def plan(self, header: Mapping[str, Any], *seen: Array) -> Array:
        """Return accelerations (HORIZON, 3) of the planner's drone, m/s^2."""
        return np.asarray(self._work.plan(*seen))


def _rows(header: Mapping[str, Any], arrays: tuple[Array, ...]) -> Any:
    from swarm_envs.training.interaction_rows import InteractionRows

    given: dict[str, Any] = dict(zip(header["names"], arrays, strict=True))
    names: dict[str, Any] = {key: tuple(header[key]) for key in ("types", "scenario_names")}
    return InteractionRows(**given, **names)


def run_work() -> None:
    """Answer requests until the grader closes the pipe."""
    with os.fdopen(os.dup(0), "rb") as source, os.fdopen(os.dup(1), "wb") as sink:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(2, 1)
        header, _ = receive(source, _MOST)
        name = header["work"]
        _prepare(header["memory"])
        try:
            kind: Any = _Flyer if header["flies"] else _Made
            work = kind(str(Path(name).absolute()))
        except (Exception, SystemExit) as error:
            return _complain(sink, error, name)
        send(sink, "made", work.made)
        with suppress(EOFError):
            while True:
                _answer(source, sink, work, name)


def _prepare(memory: int) -> None:
    """Set resource limits, and link compiled kernels into a writable cache."""
    if kernels := os.environ.get("KERNELS"):
        own = os.environ["NUMBA_CACHE_DIR"]
        shutil.copytree(kernels, own, copy_function=os.symlink, dirs_exist_ok=True)
    with suppress(ImportError):  # Windows
        import resource

        for kind, most in {**_LIMITS, "AS": memory}.items():
            with suppress(ValueError, OSError):  # macOS does not support all of them
                resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (most, most))


def _answer(source: IO[bytes], sink: IO[bytes], work: Any, name: str) -> None:
    header, arrays = receive(source, _MOST)
    try:
        answer = getattr(work, header["kind"])(header, *arrays)
        numbers = [] if answer is None else [np.asarray(answer).astype(np.float64)]
    except (Exception, SystemExit) as error:
        return _complain(sink, error, name)
    send(sink, "answer", {}, numbers)


def _complain(sink: IO[bytes], error: BaseException, name: str) -> None:
    """Send an error's type and message, and its line in the student's file."""
    file = Path(name.rpartition(":")[0]).resolve()
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == file]
    place = f" (line {lines[-1]} of {file.name})" if lines else ""
    try:
        words = f"{type(error).__name__}: {error}"[:_LONGEST]
    except (Exception, SystemExit):  # the error's `__str__` may be the student's code too
        words = f"{type(error).__name__[:_LONGEST]}, which has no readable message"
    send(sink, "error", {"words": words + place})


if __name__ == "__main__":
    run_work()
