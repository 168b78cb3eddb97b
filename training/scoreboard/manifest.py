"""What a benchmark's folder was made by: options, versions, machine; and whether they match."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import swarm_envs
from swarm_envs.baselines.neural_swarm.flights import versions
from swarm_envs.files import write_json
from swarm_envs.training.scoreboard.tasks import COMMON

__all__ = ["OtherBenchmark"]

FILE = "manifest.json"
"""Its name in a benchmark's folder."""
_SHOWN = 8


class OtherBenchmark(ValueError):
    """A folder holds what other options made. The message says which."""


class Manifest:
    """The manifest of a folder: written when a run begins, and again when it ends.

    Runs that were killed are in it with the time at which they began, and no more. The config is
    everything that the results depend on, ready for JSON.

    Raises:
        OtherBenchmark: the folder holds the benchmark of another config.
        ValueError: the folder's manifest is damaged.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self._path, self._config = folder / FILE, dict(config)
        self._runs: list[dict[str, Any]] = []
        if self._path.is_file():
            self._runs = self._of_before()
        self._began, self._cpu = time.monotonic(), _cpu_s()

    def _of_before(self) -> list[dict[str, Any]]:
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            config, runs = dict(found["config"]), list(found["runs"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{str(self._path)!r} is damaged ({error!r}); delete it") from error
        different = list(differences(config, self._config))
        if different:
            more = f" and {len(different) - _SHOWN} more" if len(different) > _SHOWN else ""
            raise OtherBenchmark(
                f"{str(self._path.parent)!r} holds another benchmark: "
                f"{'; '.join(different[:_SHOWN])}{more}. Choose another folder by --out, or give "
                "the options with which this one was begun"
            )
        return runs

    def begin(self, command: Sequence[str]) -> None:
        """Note that a run begins, by this command."""
        self._runs.append({"started": datetime.now(UTC).isoformat(timespec="seconds")})
        self._about = {"command": shlex.join(command), **_surroundings()}
        write_json(self._path, self.content())

    def end(self) -> None:
        """Note that the run is done, and what it took."""
        spent = {"wall_s": time.monotonic() - self._began, "cpu_s": _cpu_s() - self._cpu}
        self._runs[-1] |= {name: round(value, 1) for name, value in spent.items()}
        write_json(self._path, self.content())

    def content(self) -> dict[str, Any]:
        """All of it, ready for JSON; `wall_s` and `cpu_s` add up runs that came to their end."""
        done = [run for run in self._runs if "wall_s" in run]
        totals = {name: sum(run[name] for run in done) for name in ("wall_s", "cpu_s")}
        shown = json.dumps(self._config, sort_keys=True)
        return {
            **self._about,
            "started": self._runs[0]["started"],
            **totals,
            "runs": self._runs,
            "seed": self._config["seed"],
            "force_rate": COMMON["force_rate"],
            "config": self._config,
            "config_hash": hashlib.sha256(shown.encode()).hexdigest(),
        }


def differences(old: Mapping[str, Any], new: Mapping[str, Any], where: str = "") -> Iterator[str]:
    """What two configs differ in, each as a clause of its own."""
    for name in dict.fromkeys((*old, *new)):
        place = f"{where}{name}"
        if name not in old or name not in new:
            yield f"{place} is only {'asked for now' if name in new else 'in the folder'}"
        elif isinstance(old[name], Mapping) and isinstance(new[name], Mapping):
            yield from differences(old[name], new[name], f"{place}: ")
        elif old[name] != new[name]:
            yield f"{place} was {old[name]!r:.60}, and is {new[name]!r:.60}"


def _surroundings() -> dict[str, Any]:
    found = versions()
    for package in ("torch", "pyarrow", "ray"):
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    allowed = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    machine = {"cpu": _processor(), "cores": len(allowed(0)), "system": platform.platform()}
    return {"versions": found, "machine": machine, "commit": _commit()}


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _commit() -> str | None:
    """Of the checkout that is imported, if it is one; `+` behind it says that files differ."""
    root = Path(swarm_envs.__file__).parent.parent
    if not (root / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(root), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
        return done.stdout.strip()

    try:
        return git("rev-parse", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _cpu_s() -> float:
    """CPU time of this process and of its workers that have ended, s."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system
