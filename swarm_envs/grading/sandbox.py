"""The sandbox of a work: bubblewrap, or a command of the teacher's.

The work sees the system read-only, a copy of its own folder, and no other process, keyring or
network (github.com/containers/bubblewrap).
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
"""Folder of a work in its sandbox."""
_ALONE = ["bwrap", "--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL"]
_SYSTEM = ["/usr", "/bin", "/sbin", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/alternatives"]
_COMPUTER = ("/proc/cpuinfo", "/sys/devices/system/cpu")  # what libraries ask about it


class Sandbox(NamedTuple):
    """The separation of works from the system and from each other."""

    command: str | None = None
    """A command that runs what follows it, where `{work}` is the work's folder; None for bwrap."""
    unprotected: bool = False  # Whether works run as any other program of the grader's
    memory: int = 8 << 30  # Most memory of a work, bytes
    weights: bool = False  # Whether works may read the weights that ship


class Confined:
    """The process of a work in a sandbox, with pipes for its input and output.

    Args:
        sandbox: what keeps it apart.
        home: its working directory, a copy of the work's folder.
        errors: file for what it says on stderr.
        flies: whether it needs the forces of environments.
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
        self.sink = cast(IO[bytes], self._process.stdin)  # where to write what it is asked
        self.source = cast(IO[bytes], self._process.stdout)  # where to read what it answers

    def cpu_s(self) -> float:
        """CPU time of the process and of all that it began, s."""
        return self._group.cpu_s(self._process.pid) if self._group else 0.0

    def kill(self) -> None:
        """End the process and all that it began, without waiting."""
        with suppress(ProcessLookupError, PermissionError, AttributeError):  # Windows has none
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def end(self, patience_s: float = 0.0) -> int:
        """End the process, which may do so by itself for a while, s; return its exit code."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience_s)
        self.kill()
        code = self._process.wait()
        if self._group:
            self._group.remove()
        return code


def has_bubblewrap() -> bool:
    """Return whether bubblewrap is installed, and may do its work."""
    return runs("bwrap", "--unshare-all", "--ro-bind", "/", "/", "true")


def _weights(flies: bool) -> list[str]:
    """Folders of weights that ship; those of the forces, too, of a work that needs none."""
    hidden = {"agents": "weights", "baselines": "neural_swarm/weights"}
    hidden |= {} if flies else {"interactions": "weights"}
    package = Path(swarm_envs.__file__).parent
    return [str((package / part).resolve() / place) for part, place in hidden.items()]


def _bubble(home: Path, hidden: list[str]) -> list[str]:
    """Words of bubblewrap, and of the program that gives a session keyring of its own.

    Args:
        home: folder of the work.
        hidden: folders that are empty for it.
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
    """Words that leave nothing of the grader's environment."""
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
