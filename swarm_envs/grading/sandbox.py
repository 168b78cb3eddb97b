"""The sandbox of a submission: bubblewrap, or a command of the teacher.

A submission has read-only access to the system and a copy of its own folder, and no access to other
processes, keyrings or the network (github.com/containers/bubblewrap).
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import swarm_envs
from swarm_envs.compiled import kernel_folder
from swarm_envs.grading.groups import ControlGroup, runs

HOME = "/submission"
"""Folder of a submission in its sandbox."""
_ALONE = ["bwrap", "--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL"]
_SYSTEM = ["/usr", "/bin", "/sbin", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/alternatives"]
_COMPUTER = ("/proc/cpuinfo", "/sys/devices/system/cpu")  # Information that libraries need


class Sandbox(NamedTuple):
    """The isolation of submissions from the system and from each other."""

    command: str | None = None
    """The command prefix, where `{work}` is the submission's folder; None for bubblewrap."""
    unprotected: bool = False  # True to run submissions without isolation
    memory: int = 8 << 30  # Largest memory of a submission, bytes
    weights: bool = False  # True if submissions may read the included weights


class Confined:
    """The process of a submission in a sandbox, with pipes for its input and output.

    Args:
        sandbox: the sandbox.
        home: its working directory, a copy of the submission's folder.
        errors: the file for its stderr.
        flies: True if it needs the force models of environments.
    """

    def __init__(self, sandbox: Sandbox, home: Path, errors: IO[bytes], flies: bool) -> None:
        self._group: ControlGroup | None = None
        variables = dict(os.environ)
        words = [sys.executable, "-P", "-m", "swarm_envs.grading.work"]
        if sandbox.command is not None:
            given = [word.replace("{work}", str(home)) for word in shlex.split(sandbox.command)]
            words = [*given, "python3", *words[1:]]
        elif sandbox.unprotected:
            variables |= _variables()
        else:
            self._group = ControlGroup(sandbox.memory)
            hidden = [] if sandbox.weights else _weights(flies)
            words = [*self._group.words, *_bubble(home, hidden), *_clean(), *words]
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            words, **pipes, env=variables, cwd=home, start_new_session=True
        )
        self.sink = cast(IO[bytes], self._process.stdin)  # for requests
        self.source = cast(IO[bytes], self._process.stdout)  # for answers

    def cpu_s(self) -> float:
        """Return the CPU time of the process and its descendants, s."""
        return self._group.cpu_s(self._process.pid) if self._group else 0.0

    def kill(self) -> None:
        """Kill the process and its descendants without waiting."""
        with suppress(ProcessLookupError, PermissionError, AttributeError):  # Windows has none
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def end(self, patience_s: float = 0.0) -> int:
        """Wait for the process for a time, s, then kill it; return its exit code."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience_s)
        self.kill()
        code = self._process.wait()
        if self._group:
            self._group.remove()
        return code


def has_bubblewrap() -> bool:
    """Return True if bubblewrap is installed and works."""
    return runs("bwrap", "--unshare-all", "--ro-bind", "/", "/", "true")


def _weights(flies: bool) -> list[str]:
    """Return the folders of included weights that are hidden from a submission."""
    hidden = {"agents": "weights", "baselines": "neural_swarm/weights"}
    hidden |= {} if flies else {"interactions": "weights"}
    package = Path(swarm_envs.__file__).parent
    return [str((package / part).resolve() / place) for part, place in hidden.items()]


def _bubble(home: Path, hidden: list[str]) -> list[str]:
    """Return the command prefix of bubblewrap, with a new session keyring if possible.

    Args:
        home: the submission's folder.
        hidden: folders that appear empty.
    """
    package = Path(swarm_envs.__file__).parent
    parts = [package, *(part.resolve() for part in package.iterdir() if part.is_symlink())]
    seen = [*_SYSTEM, *_COMPUTER, str(kernel_folder()), sys.base_prefix, sys.prefix, *_installed()]
    binds = [word for path in [*seen, *parts] for word in ("--ro-bind-try", str(path), str(path))]
    keyring = ["keyctl", "session", "-"] if shutil.which("keyctl") else []
    empty = ["--dev", "/dev", "--tmpfs", "/tmp"]  # first: the package may be installed below it
    binds += [word for path in hidden for word in ("--tmpfs", path)]
    return [*keyring, *_ALONE, *empty, *binds, "--ro-bind", str(home), HOME, "--chdir", HOME]


def _clean() -> list[str]:
    """Return the command prefix that replaces the grader's environment variables."""
    own = {**_variables(), "PATH": "/usr/bin:/bin", "HOME": "/tmp", "TMPDIR": "/tmp"}
    own |= {"NUMBA_CACHE_DIR": "/tmp/kernels", "KERNELS": str(kernel_folder() or "")}
    own |= {"USER": "work", "LANG": "C.UTF-8"}
    return ["/usr/bin/env", "-i", *(f"{name}={value}" for name, value in own.items())]


def _installed() -> list[str]:
    return [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]


def _variables() -> dict[str, str]:
    libraries = ("OMP", "OPENBLAS", "MKL", "NUMBA")
    paths = os.pathsep.join([str(Path(swarm_envs.__file__).parents[1]), *_installed()])
    threads = {f"{library}_NUM_THREADS": "1" for library in libraries}
    return {**threads, "MPLBACKEND": "Agg", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": paths}
