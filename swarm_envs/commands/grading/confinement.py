"""What the process of a work may do: limits, namespaces, Landlock, and an end for all it began.

On Linux the process has a network, processes, users and mounts of its own (`unshare` of
util-linux); it sees Python, the package and its own files, and writes into a folder in memory
(mounts, and Landlock: docs.kernel.org/userspace-api/landlock.html). Each of these may be missing.
Without mounts it runs, of root, as another user. What holds everywhere are POSIX's limits, an empty
environment, and that only numbers come back. Nothing here imports more than the standard library:
the work's process confines itself before it imports more.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, NamedTuple

LINUX = sys.platform == "linux"  # Whether the kernel offers namespaces and Landlock
_DROP_FROM_BOUNDS, _CAPABILITIES_3 = 24, 0x20080522
_GET_DUMPABLE, _SET_DUMPABLE, _SET_NO_NEW_PRIVS = 3, 4, 38  # of prctl(2)
_SET_CHILD_SUBREAPER = 36
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # Landlock's, on every architecture
_UNSHARE = ("--map-root-user", "--net", "--ipc", "--mount")
_PIDS = ("--pid", "--fork", "--kill-child", "--mount-proc")
_READ = (1 << 0) | (1 << 2) | (1 << 3)  # execute, read a file, read a folder
_ON_FILES = (1 << 0) | (1 << 1) | (1 << 2) | (1 << 14)
_SIGNALS_STAY = 6  # the version of Landlock from which on signals do not leave it
_MANY_PIDS = 301  # the system itself keeps the first 300
_NOBODY = 65534
_PIPE = 1 << 20
"""Bytes that a pipe holds: with fewer, grader and work wait for each other more often."""
_MOUNT_SETATTR, _BIND, _WITH_ALL_BELOW = 442, 4096, 16384  # of mount_setattr(2) and mount(2)
_SECCOMP = 22  # of prctl(2)
_MACHINES = {
    "x86_64": (0xC000003E, 72, (203, 73, 253, 294, 300)),
    "aarch64": (0xC00000B7, 25, (122, 32, 26, 262)),
}
"""By machine: its number in linux/audit.h, that of fcntl(2), and those of calls that are refused:
sched_setaffinity, flock, inotify_init, inotify_init1 and fanotify_init."""
_LOCKS = (5, 6, 7, 36, 37, 38, 1024, 1026)  # what fcntl(2) is not asked: fcntl.h


class Limits(NamedTuple):
    """What a work may use."""

    work_s: float = 600.0  # Time until its first decision, and again for all others, s
    decision_s: float = 30.0
    """Time for a decision after the first, of one team or of many at once, s."""
    memory: int = 8 << 30  # Address space of each of its processes, bytes
    processes: int = 128  # Processes and threads
    files: int = 256  # Open files of each process
    file_size: int = 64 << 20  # Size of each file that it writes, bytes
    disk: int = 512 << 20  # Size of all of them, bytes


class Protections(NamedTuple):
    """What this system offers."""

    unshare: tuple[str, ...]
    """The command that makes the namespaces, with its options; empty if there is none."""
    landlock: int  # Version of Landlock; 0 if there is none

    user: int | None = None  # Another user that may write nothing of this one's; None for the same

    @property
    def own_processes(self) -> bool:
        """Whether a work sees its own processes alone."""
        return "--pid" in self.unshare

    @property
    def can_rename(self) -> bool:
        """Whether nothing keeps a work from replacing this user's files, Python's among them."""
        return not self.unshare and not self.landlock and self.user is None

    @property
    def missing(self) -> list[str]:
        """What a work may do here that it should not, in words."""
        found = []
        if not self.unshare:
            found.append("it can use the network, and fill the disk")
        if not self.own_processes and self.landlock < _SIGNALS_STAY and self.user is None:
            found.append("it can end other processes of this user")
        if not self.unshare and not self.landlock:
            whose = "this user's files" if self.user is None else "files that any user may read"
            found.append(f"it can read {whose}")
        if self.can_rename:
            found.append("it can rename and remove this user's files, and so ruin the system")
        few_processes = self.own_processes and _pids_can_be_few()
        if LINUX and os.getuid() == 0 and self.user is None and not few_processes:
            found.append("it can start any number of processes, as root")
        if not LINUX:
            found.append("what it began may outlive it in a session of its own")
        return found


@cache
def probe() -> Protections:
    """What this system offers, tried out."""
    if not LINUX:
        return Protections((), 0)
    command = shutil.which("unshare", path="/usr/bin:/bin:/usr/sbin:/sbin")
    wanted = [(command, *_UNSHARE, *_PIDS), (command, *_UNSHARE)] if command else []
    works = [each for each in wanted if _is_at_least(5, 12) and _runs([*map(str, each), "true"])]
    version = int(_libc().syscall(_CREATE_RULESET, None, 0, 1))
    return Protections(tuple(map(str, works[0])) if works else (), max(version, 0), _other_user())


def _other_user() -> int | None:
    """Of root, a user that can read the package."""
    reads = [sys.executable, "-c", "import swarm_envs"]
    return _NOBODY if os.getuid() == 0 and _runs(reads, user=_NOBODY) else None


def _runs(command: list[str], user: int | None = None) -> bool:
    try:
        quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "capture_output": True}
        return subprocess.run(command, user=user, timeout=60, **quiet).returncode == 0
    except OSError:
        return False


def _pids_can_be_few() -> bool:
    """Whether each space of processes has a limit of its own: before 6.14 it was the system's."""
    return _is_at_least(6, 14)


def _is_at_least(*release: int) -> bool:
    return tuple(map(int, re.findall(r"\d+", os.uname().release)[:2])) >= release


@cache
def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)


# ---- In the grader


@contextmanager
def guarded() -> Iterator[None]:
    """Nobody of the same user reads the grader's memory, and orphans become its children."""
    if not LINUX or not _libc().prctl(_GET_DUMPABLE, 0, 0, 0, 0):  # guarded already
        yield
        return
    _hide_command_line()
    _libc().prctl(_SET_DUMPABLE, 0, 0, 0, 0)
    _libc().prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        _libc().prctl(_SET_CHILD_SUBREAPER, 0, 0, 0, 0)
        _libc().prctl(_SET_DUMPABLE, 1, 0, 0, 0)


def _hide_command_line() -> None:
    """Write zeros over what others read in /proc/PID/cmdline: there is the seed of the mark."""
    numbers = Path("/proc/self/stat").read_text(errors="replace").rpartition(")")[2].split()
    start, end = map(int, numbers[45:47])  # of the arguments in memory, proc(5)
    if 0 < start < end:
        ctypes.memset(start, 0, end - start)


class Confined:
    """A process of a module, in a session of its own; all that it begins ends with it.

    Args:
        module: what runs.
        paths: where it imports from.
        scratch: a folder of its own.
        protections: of this system.
    """

    def __init__(
        self, module: str, paths: Sequence[str], scratch: Path, protections: Protections
    ) -> None:
        self._before = descendants()
        user = None if protections.unshare else protections.user
        if user is not None:
            os.chown(scratch, user, user)
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            [*protections.unshare, sys.executable, "-P", "-m", module],
            env=_environment(paths, scratch),
            cwd=scratch,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            pipesize=_PIPE,
            start_new_session=True,
            user=user,
            group=user,
            extra_groups=None if user is None else (),
        )
        assert self.process.stderr is not None
        self._said = _Tail(self.process.stderr)

    @property
    def descriptors(self) -> tuple[int, int]:
        """Where to read what it answers, and to write what it is asked."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        return self.process.stdout.fileno(), self.process.stdin.fileno()

    def end(self, patience_s: float = 0.0) -> tuple[int, str]:
        """End it and all that it began; its exit code, and the last line that it said.

        Args:
            patience_s: time in which it may end by itself, s.
        """
        assert self.process.stdin is not None
        if self.process.stdin.closed:
            return self.process.returncode, ""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(patience_s)
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        _end_all_but(self._before)
        said = self._said.text()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            assert pipe is not None
            pipe.close()
        return self.process.returncode, said


class _Tail:
    """The end of what a process says; the rest is forgotten as it comes."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self._end = pipe, b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with suppress(OSError, ValueError):
            while part := self._pipe.read(1 << 16):
                self._end = (self._end + part)[-8192:]

    def text(self) -> str:
        """The last line, once the process has ended."""
        self._thread.join(5.0)
        lines = self._end.decode(errors="replace").strip().split("\n")
        return lines[-1]


def _environment(paths: Sequence[str], scratch: Path) -> dict[str, str]:
    """Nothing of the grader's environment; what Python and its libraries need."""
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {
        **dict.fromkeys(threads, "1"),
        "HOME": str(scratch),
        "LANG": "C.UTF-8",
        "MPLBACKEND": "Agg",
        "NUMBA_CACHE_DIR": str(scratch / "kernels"),
        "PATH": "/usr/bin:/bin",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join(paths),
        "TMPDIR": str(scratch),
        "TQDM_DISABLE": "1",
    }


def descendants() -> set[int]:
    """Processes that this one has begun, and those that they have."""
    if not LINUX:
        return set()
    parents: dict[int, int] = {}
    for entry in os.listdir("/proc"):  # noqa: PTH208 names alone, and as fast as can be
        if entry.isdigit():
            with suppress(OSError, ValueError, IndexError):
                status = Path("/proc", entry, "stat").read_text(errors="replace")
                parents[int(entry)] = int(status.rpartition(")")[2].split()[1])
    found, ahead = set[int](), {os.getpid()}
    while ahead:
        ahead = {child for child, parent in parents.items() if parent in ahead} - found
        found |= ahead
    return found


def _end_all_but(spared: set[int]) -> None:
    """End every process that this one has begun, until there is none; orphans are its own."""
    while found := descendants() - spared:
        for process in found:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        for process in found:
            with suppress(ChildProcessError):
                os.waitpid(process, os.WNOHANG)


def tasks_of(user: int) -> int:
    """Processes and threads of a user, which the limit of theirs counts."""
    count = 0
    for process in Path("/proc").glob("[0-9]*") if LINUX else ():
        with suppress(OSError):
            if process.stat().st_uid == user:
                count += len(list((process / "task").iterdir()))
    return count


# ---- In the process of the work


def limit_self(limits: Limits, tasks: int) -> None:
    """Set the limits of this process and of all that it will begin.

    Args:
        limits: on it.
        tasks: those of its user, `tasks_of`, which the system counts too.
    """
    for kind, most in (
        (resource.RLIMIT_AS, limits.memory),
        (resource.RLIMIT_CPU, int(4.0 * limits.work_s) + 60),
        (resource.RLIMIT_FSIZE, limits.file_size),
        (resource.RLIMIT_NOFILE, limits.files),
        (resource.RLIMIT_NPROC, tasks + limits.processes),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        wanted = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with suppress(ValueError, OSError):  # macOS refuses some
            resource.setrlimit(kind, (wanted, wanted))
    if LINUX and os.getpid() == 1 and _pids_can_be_few():
        with suppress(OSError):  # root has no other limit
            few = str(_MANY_PIDS + limits.processes)
            Path("/proc/sys/kernel/pid_max").write_text(few, encoding="utf-8")


def drop_capabilities() -> None:
    """Be root no more in anything but name: capabilities(7); root would read any memory."""
    if not LINUX:
        return
    for capability in range(64):
        _libc().prctl(_DROP_FROM_BOUNDS, capability, 0, 0, 0)  # those that there are
    header = (ctypes.c_uint32 * 2)(_CAPABILITIES_3, 0)
    _checked(_libc().capset(header, (ctypes.c_uint32 * 6)()))
    _checked(_libc().prctl(_SET_NO_NEW_PRIVS, 1, 0, 0, 0))


def keep_in_memory(scratch: Path, size: int) -> None:
    """Put a folder into memory, of so many bytes; for a process with mounts of its own."""
    no_devices_no_setuid = 2 | 4
    options = f"size={size},mode=700".encode()
    _mount("tmpfs", scratch, no_devices_no_setuid, b"tmpfs", options)


def see_only(readable: Sequence[str], scratch: Path) -> None:
    """Let this process see these files and folders alone, read-only, and its own folder.

    For one with mounts of its own, which has called `keep_in_memory`.

    Raises:
        OSError: the system refuses.
    """
    root = scratch / "root"
    own = root / scratch.relative_to("/")
    own.mkdir(parents=True)
    _mount(root, root, _BIND)
    for path in sorted(map(Path, readable), key=lambda path: len(path.parts)):
        place = root / path.relative_to("/")
        if path.exists() and not place.exists():  # else it lies within another
            (place if path.is_dir() else place.parent).mkdir(parents=True, exist_ok=True)
            if not path.is_dir():
                place.touch()
            _mount(path, place, _BIND | _WITH_ALL_BELOW)
    read_only = struct.pack("4Q", 1, 0, 0, 0)
    here, all_below = -100, 0x8000
    _checked(_libc().syscall(_MOUNT_SETATTR, here, os.fsencode(root), all_below, read_only, 32))
    _mount(scratch, own, _BIND)
    os.chroot(root)
    os.chdir(scratch)


def _mount(
    source: str | Path, target: Path, flags: int, kind: bytes | None = None, data: bytes = b""
) -> None:
    _checked(_libc().mount(os.fsencode(source), os.fsencode(target), kind, flags, data))


def stay_alone(number: int) -> None:
    """Run on one core from now on, and say nothing to others by locks on files that both may read.

    What it begins neither: seccomp(2) refuses the calls. Call `drop_capabilities` before.

    Args:
        number: which core, counted among those that it may use, and around.
    """
    machine, fcntl, refused = _MACHINES.get(os.uname().machine, (0, 0, ()))
    if not LINUX or not machine:
        return
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[number % len(cores)]})
    load, equal, least, end = 0x20, 0x15, 0x35, 0x06  # of linux/filter.h
    allow, refuse = (end, 0, 0, 0x7FFF0000), (end, 0, 0, 0x00050001)  # with EPERM
    rules = [(load, 0, 0, 4), (equal, 1, 0, machine), refuse]
    rules += [(load, 0, 0, 0), (least, 0, 1, 1 << 30), refuse]  # from there on, calls have others
    for call in refused:
        rules += [(equal, 0, 1, call), refuse]
    rules += [(equal, 1, 0, fcntl), allow, (load, 0, 0, 24)]  # the lower half of what is asked
    for lock in _LOCKS:
        rules += [(equal, 0, 1, lock), refuse]
    code = b"".join(struct.pack("HBBI", *rule) for rule in [*rules, allow])
    held = ctypes.create_string_buffer(code)
    program = struct.pack("HxxxxxxP", len(rules) + 1, ctypes.addressof(held))
    _checked(_libc().prctl(_SECCOMP, 2, program, 0, 0))


class _Ruleset(ctypes.Structure):
    """`struct landlock_ruleset_attr`."""

    _fields_ = (("files", ctypes.c_uint64), ("net", ctypes.c_uint64), ("scoped", ctypes.c_uint64))


class _Beneath(ctypes.Structure):
    """`struct landlock_path_beneath_attr`."""

    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("folder", ctypes.c_int32))


def hide_files(version: int, readable: Sequence[str], writable: Sequence[str]) -> None:
    """Let this process see and write these files and folders alone, by Landlock.

    Call `drop_capabilities` before.

    Args:
        version: of Landlock, not 0.
        readable: what is missing of them is left out.
        writable: likewise; they are readable too.

    Raises:
        OSError: the system refuses; nothing is hidden.
    """
    everything = (1 << (13 if version < 2 else 14 if version < 3 else 15)) - 1
    rules = _Ruleset(everything, 3 if version >= 4 else 0, 3 if version >= _SIGNALS_STAY else 0)
    size = 8 if version < 4 else 16 if version < _SIGNALS_STAY else 24
    ruleset = _checked(_libc().syscall(_CREATE_RULESET, ctypes.byref(rules), size, 0))
    for paths, allowed in ((readable, _READ), (writable, everything)):
        for path in paths:
            _allow(ruleset, path, allowed)
    _checked(_libc().syscall(_RESTRICT_SELF, ruleset, 0))
    os.close(ruleset)


def _allow(ruleset: int, path: str, allowed: int) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    fits = allowed if Path(path).is_dir() else allowed & _ON_FILES
    rule = _Beneath(fits, descriptor)
    _libc().syscall(_ADD_RULE, ruleset, 1, ctypes.byref(rule), 0)
    os.close(descriptor)


def _checked(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), "the system refuses to confine this process")
    return result
