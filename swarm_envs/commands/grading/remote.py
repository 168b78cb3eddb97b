"""A work as the grader sees it: an agent that answers from a process of its own."""

from __future__ import annotations

import hashlib
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

import swarm_envs
from swarm_envs.agents import Actions, Observations
from swarm_envs.commands.grading.confinement import (
    Confined,
    Limits,
    Protections,
    guarded,
    probe,
    tasks_of,
)
from swarm_envs.commands.grading.grades import printable
from swarm_envs.commands.grading.messages import Array, BadMessage, Channel, TooLate
from swarm_envs.compiled import kernel_folder
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer, check_name

KEPT = 256  # Decisions of a work that are kept, to be compared with those of agents that ship
OPTIONS = (
    *("action", "decision_rate", "observation"),
    *("num_neighbors", "num_obstacles", "observe_load", "observe_setpoint"),
)
"""Options that a work may require. All others say what is flown and when it is a success."""
MOST_SEEN = 64  # Neighbours, or obstacles, that it may ask to observe
_MODULE = "swarm_envs.commands.grading.child"
_SETUP_S = 60.0  # for imports and compilation, before a work trains
_DECISIONS = ("act", "batch", "plan")
_SPARE = 1 << 20  # bytes by which an answer may be too long and still be understood


class WorkFailed(RuntimeError):
    """A work raised, answered nonsense, took too long or ended. The message says which."""


class WorkRefused(ValueError):
    """A work raised a ValueError, which in `reset` refuses an episode."""


class RemoteWork:
    """A work in its process, which is asked and answers. Make one with `opened`.

    Args:
        process: where it runs.
        limits: on it.
    """

    def __init__(self, process: Confined, limits: Limits) -> None:
        self._process, self._limits = process, limits
        self._channel = Channel(*process.descriptors)
        self._left_s = limits.work_s
        self._known: set[str] = set()
        self._why = ""

    def tell(self, header: Mapping[str, Any]) -> None:
        """Send the first message, which is not answered yet."""
        self._exchange(lambda until: self._channel.send(header, (), until), math.inf)

    def ask(
        self,
        kind: str,
        header: Mapping[str, Any] | None = None,
        arrays: Sequence[Array] = (),
        most: int = 0,
        questions: Mapping[str, Callable[[dict[str, Any]], Any]] | None = None,
        limit_s: float = math.inf,
    ) -> tuple[dict[str, Any], list[Array]]:
        """Ask, and wait for the answer. Only this waiting counts against the work's time.

        Args:
            kind: of what is asked; "" for the answer to the first message.
            header: what is said with it.
            arrays: likewise.
            most: bytes of the answer's numbers.
            questions: what it may ask back, by kind: header and arrays of the reply.
            limit_s: on this answer, s.

        Raises:
            WorkFailed: it failed.
            WorkRefused: it raised a ValueError.
        """
        decides = kind in _DECISIONS and kind in self._known
        limit = self._limits.decision_s if decides else limit_s

        def converse(until: float) -> tuple[dict[str, Any], list[Array]]:
            if kind:
                self._channel.send({"kind": kind, **(header or {})}, arrays, until)
            while True:
                answer, given = self._channel.receive(most + _SPARE, until)
                reply = (questions or {}).get(answer["kind"])
                if reply is None:
                    return answer, given
                said, shown = reply(answer)
                self._channel.send(said, shown, until)

        answer, given = self._exchange(converse, limit)
        if answer["kind"] == "error":
            words = printable(str(answer.get("words")))
            raise WorkRefused(words) if answer.get("refused") is True else WorkFailed(words)
        if kind in _DECISIONS:
            if not self._known:  # from here on nothing is compiled
                self._left_s = self._limits.work_s
            self._known.add(kind)
        return answer, given

    def _exchange(self, converse: Callable[[float], Any], limit: float) -> Any:
        """Talk until it is over, or too late; then the work is ended, and says no more."""
        if self._why:
            raise WorkFailed(self._why)
        begun = time.monotonic()
        try:
            return converse(begun + min(limit, self._left_s))
        except TooLate:
            slow = f"an answer took longer than {limit:g} s"
            whole = f"took longer than {self._limits.work_s:g} s"
            self._end(slow if limit < self._left_s else whole)
        except BadMessage as error:
            self._end(f"answered nonsense: {error}")
        except (EOFError, OSError):
            self._end("")
        finally:
            self._left_s -= time.monotonic() - begun
        raise WorkFailed(self._why)

    def _end(self, why: str) -> None:
        # Whose pipe is closed is about to end, and to say why.
        code, said = self._process.end(0.0 if why else 1.0)
        self._why = printable(why or f"ended with exit code {code}: {said or 'no message'}")


@contextmanager
def opened(
    name: str,
    what: str,
    others: Sequence[str] = (),
    limits: Limits | None = None,
    beside: bool = True,
) -> Iterator[tuple[RemoteWork, dict[str, Any]]]:
    """Start the process of a work, and end it and all that it began.

    Args:
        name: of the work, as of `swarm_envs.agents.load`.
        what: `fly`, `fit` for a force model, or `plan` for a planner.
        others: names of all works; it sees none of these.
        limits: on it; None for the usual.
        beside: whether it may read what lies beside its file.

    Returns:
        The work, and what it says of itself; nothing of it is checked.

    Raises:
        WorkFailed: it cannot be made.
    """
    limits, offered = limits or Limits(), probe()
    name = absolute(name)
    kernels = kernel_folder()
    with tempfile.TemporaryDirectory(prefix="swarm-envs-grade-") as folder, guarded():
        scratch = Path(folder).resolve()
        process = Confined(_MODULE, _import_paths(), scratch, offered)
        user = os.getuid() if offered.unshare or offered.user is None else offered.user
        try:
            work = RemoteWork(process, limits)
            work.tell(
                {
                    "kind": "begin",
                    "what": what,
                    "work": name,
                    "scratch": str(scratch),
                    "limits": limits,
                    "tasks": tasks_of(user),
                    "core": os.getpid(),
                    "mounts": bool(offered.unshare),
                    "landlock": offered.landlock,
                    "readable": [*_readable(offered), *files_of(name, others, beside)],
                    "kernels": None if kernels is None else str(kernels),
                }
            )
            try:
                made, _ = work.ask("")
            except WorkRefused as error:
                raise WorkFailed(str(error)) from error
            yield work, made
        finally:
            with suppress(OSError):
                process.end()


def absolute(name: str) -> str:
    """A work's name with the whole path of its file or folder."""
    path, colon, rest = name.rpartition(":") if ".py:" in name else (name, "", "")
    return f"{Path(path).resolve()}{colon}{rest}" if Path(path).exists() else name


def path_of(name: str) -> Path:
    """File or folder of a work."""
    return Path(name.rpartition(":")[0] if ".py:" in name else name)


def files_of(name: str, others: Sequence[str], beside: bool) -> list[str]:
    """What a work may read of its own: its folder, or its file where others lie in the folder."""
    path = path_of(name)
    if not path.exists():
        return []
    folder = path.parent if path.is_file() else path
    rest = [path_of(absolute(other)) for other in others if path_of(absolute(other)) != path]
    shared = not beside or any(folder in other.parents for other in rest)
    return [str(path if shared else folder)]


def package_state() -> dict[str, str]:
    """Digests of the package's files, by path: they change if anybody changes one.

    Times are not compared, because a hard link to a file, as builds make them, changes its time;
    nor caches, which other processes may fill meanwhile.
    """
    package, found = Path(swarm_envs.__file__).parent, {}
    for part in [package, *(part for part in package.iterdir() if part.is_symlink())]:
        for folder, within, files in os.walk(part.resolve()):
            within[:] = [name for name in within if name != "__pycache__"]
            found.update({f"{folder}/{name}": _digest(Path(folder, name)) for name in files})
    return found


def _digest(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _import_paths() -> list[str]:
    """Where the work imports from: the package, and what is installed."""
    installed = [path for path in sys.path if _is_installed(path)]
    return [str(Path(swarm_envs.__file__).parents[1]), *installed]


def _is_installed(path: str) -> bool:
    roots = {sys.prefix, sys.base_prefix}
    beneath = any(Path(root) in Path(path).parents for root in roots)
    return beneath or Path(path).name in ("site-packages", "dist-packages")


def _readable(offered: Protections) -> list[str]:
    """What every work may read."""
    package = Path(swarm_envs.__file__).parent
    parts = [str(part.resolve()) for part in (package, *package.iterdir()) if part.is_dir()]
    system = ["/usr", "/bin", "/lib", "/lib64", "/etc", "/sys/devices/system", "/dev/urandom"]
    process = "/proc" if offered.own_processes else "/proc/cpuinfo"
    installed = [path for path in sys.path if _is_installed(path)]
    return [*parts, *installed, *system, process, sys.prefix, sys.base_prefix, "/dev/zero"]


def train_work(work: RemoteWork, seconds: float) -> None:
    """Let a work train for some seconds of its own process; half as much again, and it is ended.

    Raises:
        WorkFailed: it raised, or took longer.
    """
    work.ask("train", {"seconds": seconds}, limit_s=1.5 * seconds + _SETUP_S)


def _checked(requires: Any) -> dict[str, Any]:
    """What a work requires of the environment.

    Raises:
        ValueError: it is no mapping, or requires what it may not choose.
        TypeError: a number of drones or obstacles is none.
    """
    if not isinstance(requires, dict):
        raise ValueError(f"requires is {requires!r:.80}, but must be a mapping of options")
    for name, value in requires.items():
        check_name("required option", name, OPTIONS)
        if name.startswith("num_") and value is not None:
            check_integer(name, value, 0, MOST_SEEN)
    return requires


class RemoteAgent:
    """A work that flies, as an agent of the grader.

    Args:
        work: its process.
        made: what it says of itself.
        flown: the task's name and the options of the environment, which it is told.

    Raises:
        ValueError: it requires what it may not.
        TypeError: likewise.
    """

    def __init__(self, work: RemoteWork, made: Mapping[str, Any], flown: Mapping[str, Any]) -> None:
        self.requires: Mapping[str, Any] = _checked(made.get("requires"))
        self.privileged = made.get("privileged") is True
        self.asked = self.privileged
        """Whether it has asked for the truth."""
        self.kept: list[tuple[Float32Array, Array]] = []
        """Some of its decisions: rows (N, row width), and actions (N, width)."""
        self._work, self._flown = work, flown
        self._resets = self._decisions = 0
        self._rng = np.random.default_rng(0)
        self._env: SwarmParallelEnv | None = None

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare the work for an episode; of its seed it learns nothing, it is given another."""
        self._env = env
        if not self._resets:  # the seed is of the episode, which the work does not know
            self._rng = np.random.default_rng(seed)
        header = {"seed": self._resets, **self._flown}
        self._resets += 1
        self._ask("reset", header, [], 0)

    def act(self, observations: Observations, view: View | None) -> Actions:
        """The work's actions for what its drones observe."""
        env = self._env
        assert env is not None
        rows = env.core.rows[0].copy()
        shape = (1, len(observations), env.core.mode.width)
        actions = self._ask("act", {}, [rows], 8 * math.prod(shape), shape)
        self._keep(rows[None], actions)
        return dict(zip(observations, actions[0], strict=True))

    def _ask(
        self,
        kind: str,
        header: Mapping[str, Any],
        arrays: list[Array],
        most: int,
        shape: tuple[int, ...] | None = None,
    ) -> Array:
        _, given = self._work.ask(kind, header, arrays, most, {"view": self._show_view})
        if shape is None:
            return np.zeros(0)
        if len(given) != 1 or given[0].dtype != np.float64:
            raise WorkFailed("answered nonsense: no array of actions")
        if kind == "act" and given[0].shape != shape:
            raise WorkFailed(f"answered actions of shape {given[0].shape}, not {shape}")
        return given[0]

    def _show_view(self, header: Mapping[str, Any]) -> tuple[dict[str, Any], list[Array]]:
        self.asked = True
        assert self._env is not None
        tables = self._env.core.world
        return {"kind": "view"}, [np.frombuffer(table.tobytes(), np.uint8) for table in tables]

    def _keep(self, rows: Float32Array, actions: Array) -> None:
        """Keep decisions of all flights evenly, of one team each: which, no work can foresee."""
        self._decisions += 1
        place, team = self._rng.integers((self._decisions, len(rows)))
        kept = rows[team].copy(), actions[team].copy()
        if len(self.kept) < KEPT:
            self.kept.append(kept)
        elif place < KEPT:
            self.kept[place] = kept


class RemoteBatchAgent(RemoteAgent):
    """A work that flies many episodes at once."""

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """The work's actions for the rows of many teams."""
        assert self._env is not None
        width = self._env.core.mode.width
        shape = (*rows.shape[:-1], width)
        actions: Any = self._ask("batch", {}, [rows], 8 * math.prod(shape), shape)
        self._keep(rows, actions)
        return actions


def remote_agent(
    work: RemoteWork, made: Mapping[str, Any], flown: Mapping[str, Any]
) -> RemoteAgent:
    """A work as an agent, by what it says of itself; the arguments are those of `RemoteAgent`.

    Raises:
        WorkFailed: it requires what it may not.
    """
    kind = RemoteBatchAgent if made.get("batched") is True else RemoteAgent
    try:
        return kind(work, made, flown)
    except (ValueError, TypeError) as error:
        raise WorkFailed(printable(f"cannot be flown: {error}")) from error
