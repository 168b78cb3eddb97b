"""Control groups, which limit memory, processes, cores and CPU time of a submission.

A group is created in the system's tree if the user has permission (root), else by systemd. If
neither works, limits apply to each process, and CPU time is summed over existing processes.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

PROCESSES = 256
"""Largest number of processes and threads of a submission."""
_ROOT = Path("/sys/fs/cgroup")
_JOIN = 'for g in $0; do echo $$ > "$g/cgroup.procs" || exit 1; done; exec "$@"'
_SCOPE = ["systemd-run", "--user", "--scope", "--quiet", "--collect", "-p", "CPUQuota=100%"]
_CPU_TIME = {"cpuacct.usage": 1e-9, "cpu.stat": 1e-6}  # Files and their units, s
_numbers = itertools.count()


class ControlGroup:
    """A group of processes with limits, if the system supports it.

    Args:
        memory: the limit of their total memory, bytes.
    """

    def __init__(self, memory: int) -> None:
        self._places = _made(memory)
        scope = [*_SCOPE, "-p", f"MemoryMax={memory}", "-p", f"TasksMax={PROCESSES}"]
        join = ["sh", "-c", _JOIN, " ".join(map(str, self._places))]
        self.words = join if self._places else scope if runs(*scope, "true") else []
        """The prefix of a command that starts it in the group."""

    def cpu_s(self, process: int) -> float:
        """Return the CPU time of the group, s, or of a process and its children without one."""
        for file, place in itertools.product(_CPU_TIME, self._places):
            if (place / file).exists():
                values = (place / file).read_text().removeprefix("usage_usec").split()
                return _CPU_TIME[file] * int(values[0])
        return _tree_cpu_s(process)

    def remove(self) -> None:
        """Remove the group after its last processes have ended."""
        until = time.monotonic() + 5.0
        for place in filter(Path.exists, self._places):
            while (place / "cgroup.procs").read_text() and time.monotonic() < until:
                time.sleep(0.01)
            with suppress(OSError):
                place.rmdir()


@cache
def runs(*command: str) -> bool:
    """Return True if a command exists and succeeds."""
    with suppress(OSError):
        quiet = subprocess.DEVNULL
        return not subprocess.run(command, stdin=quiet, capture_output=True).returncode
    return False


def _made(memory: int) -> list[Path]:
    """Create groups of version 2 or 1 with limits, or none without permission."""
    limits = {"memory.max": memory, "memory.swap.max": 0, "pids.max": PROCESSES, "cpu.max": 100_000}
    if not (_ROOT / "cgroup.controllers").exists():
        limits = {"memory/memory.limit_in_bytes": memory, "pids/pids.max": PROCESSES}
        limits |= {"cpu/cpu.cfs_quota_us": 100_000, "cpuacct/cgroup.clone_children": 0}
    name = f"swarm-envs-{os.getpid()}-{next(_numbers)}"
    files = {_ROOT / Path(each).parent / name / Path(each).name: n for each, n in limits.items()}
    places = [*dict.fromkeys(file.parent for file in files)]
    try:
        for place in places:
            place.mkdir()
        for file, value in files.items():
            file.write_text(str(value))
    except OSError:
        for place in filter(Path.exists, places):
            place.rmdir()
        return []
    return places


def _tree_cpu_s(process: int) -> float:
    """Return the CPU time of a process and its descendants, ended ones included, s."""
    spent: dict[int, tuple[int, int]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):
            values = file.read_text(errors="replace").rpartition(")")[2].split()
            spent[int(file.parent.name)] = int(values[1]), sum(map(int, values[11:15]))
    ticks, ahead = 0, {process}
    while ahead:
        ticks += sum(spent[each][1] for each in ahead if each in spent)
        ahead = {child for child, (parent, _) in spent.items() if parent in ahead}
    return ticks / os.sysconf("SC_CLK_TCK") if ticks else 0.0
