"""Kill commands at random moments: `python -m tests.robustness.kills --command fit --times 10`.

A command is run once in peace. Then it is begun, killed with SIGKILL after a random time, and begun
again in the same folder, until it ends; and anew, until it was killed so many times. What it has
written at each end must be what the run in peace wrote, except for the times that runs took, and
nothing may lie about.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import io
import json
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs import cli
from swarm_envs.cli import main as command_line

Run = Callable[[Path], int]  # Does a job into a folder; its exit code
RL = ["--drones", "2", "--environments", "8", "--hidden", "8", "--num-neighbors", "1"]
RL += ["--interactions", "none", "--judge-every", "2", "--judge-episodes", "4"]
RL += ["--no-tensorboard", "--no-progress", "--seed", "5"]
ON_POLICY = [*RL, "--n-steps", "8", "--batch-size", "64", "--n-epochs", "2", "--steps", "5000"]
ON_POLICY += ["--checkpoint-rollouts", "3"]
OFF_POLICY = [*RL, "--steps", "3000", "--checkpoint-rollouts", "6", "--sac.gradient-steps", "4"]
OFF_POLICY += ["--sac.learning-starts", "200", "--sac.buffer-size", "1000"]
OFF_POLICY += ["--sac.batch-size", "32", "--sac.train-freq", "4"]
DAGGER = [*RL, "--steps", "3000", "--checkpoint-rollouts", "6", "--dagger.gradient-steps", "2"]
DAGGER += ["--dagger.batch-size", "32", "--dagger.buffer-size", "500", "--dagger.train-freq", "4"]
DAGGER += ["--dagger.teacher", "fast-line", "circle=roundabout"]
FLY = ["fly", "--agent", "hover", "--drones", "2", "--horizon-s", "0.5", "--physics", "batch"]
SHOW = ["show", "--shapes", "sphere", "star", "--drones", "6", "--hold-s", "0.5"]
FIT = ["--steps", "40", "--batch-size", "64", "--checkpoint-every", "10", "--no-progress"]
QUIET = re.compile(
    r"(^|_)(s|ms|us|seconds|time|times|wall|rate|per_s|command|act_ms|cpu_s|p50|p99|manifest)(_least|_most)?$"
)
"""Keys of JSON, and columns, whose values say how long a run took, or what it was called with."""
TRACES = re.compile(r"^manifest\.json$|\.lock$|events\.out|\.(png|html|md|mp4)$")
"""Files that are not compared: locks, event logs, a record of the runs; what shows the others."""


def run(*arguments: str) -> Run:
    """A command line with `--out`."""
    return lambda out: command_line([*arguments, "--out", str(out)])


@cache
def _inputs() -> Path:
    """A folder, the same for all runs, of what commands read."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _fit(out: Path) -> int:
    from swarm_envs.training.interaction_rows import save_rows
    from tests.helpers.tiny_fits import rows_of

    data = _inputs() / "rows.npz"
    if not data.exists():
        save_rows(data, rows_of())
    return run("fit", "--data", str(data), *FIT)(out)


def _grade(out: Path) -> int:
    work = _inputs() / "work"
    if not work.exists():
        command_line(["assignment", "start", "controller", str(work)])
    agent, table = f"{work / 'controller.py'}:MyController", str(out / "grades.csv")
    grade = ["grade", "--assignment", "controller", "--agent", agent, "--episodes", "4"]
    return command_line([*grade, "--out", table])


def _curriculum(out: Path) -> int:
    from tests.training.test_curriculum import TINY

    with mock.patch.object(cli, "_read", lambda *_: replace(TINY, out=out)):  # has no such options
        return command_line(["curriculum"])


COMMANDS: Mapping[str, Run] = {
    "collect": run("collect", "--teams", "S", "SL", "--duration-s", "4", "--no-progress"),
    "curriculum": _curriculum,
    "fit": _fit,
    "train ppo": run("train", *ON_POLICY),
    "train mappo": run("train", "--algo", "mappo", *ON_POLICY),
    "train sac": run("train", "--algo", "sac", *OFF_POLICY),
    "train dagger": run("train", "--algo", "dagger", *DAGGER),
    "evaluate": run(
        *("evaluate", "--drones", "2", "--horizon-s", "1", "--agent", "hover", "tracking"),
        *("--episodes", "60", "--workers", "2"),
    ),
    "benchmark": run(
        *("benchmark", "--agent", "hover", "straight-line", "--task", "swap-*-2-v2"),
        *("--episodes", "24", "--table", "csv", "--no-replays"),
    ),
    "grade": _grade,
    "assignment": lambda out: command_line(["assignment", "start", "controller", str(out / "kit")]),
    "export": lambda out: command_line(["export", "force", "--out", str(out / "learned.h")]),
    "fly": lambda out: command_line([*FLY, "--trajectory", str(out / "flight.npz")]),
    "show": lambda out: command_line([*SHOW, "--skyc", str(out / "show.skyc")]),
    "demo": run("demo", "--swaps", "1", "--no-video"),
    "reproduce": run("reproduce", "rth3d", "--figure", "5", "--runs", "2", "--largest", "2000"),
}
"""Commands to kill, as small as they can be. To add one is a line."""


def begun(job: Run, out: Path) -> BaseProcess:
    """A process that does the job, in a group of its own with its workers."""
    process = multiprocessing.get_context("fork").Process(target=_work, args=(job, out))
    process.start()
    return process


def _work(job: Run, out: Path) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    sys.exit(job(out))


def killed(job: Run, folder: Path, times: int, seed: int = 0) -> dict[str, Any]:
    """Run a job in peace, and killed so many times; what became of it.

    Raises:
        AssertionError: it did not end, left something behind, or wrote something else.
    """
    draws = np.random.default_rng(seed)
    # The name of a folder may stand in what is written into it.
    warm, whole, out = (folder / part / "run" for part in ("warm", "whole", "killed"))
    with contextlib.redirect_stdout(io.StringIO()):
        assert job(warm) == 0  # loads and compiles what the processes inherit
    begin = time.monotonic()
    ended = begun(job, whole)
    ended.join()
    assert ended.exitcode == 0, f"without a kill it ended with {ended.exitcode}"
    took, kills, finished = time.monotonic() - begin, 0, 0
    while kills < times or out.exists():
        process = begun(job, out)
        process.join(draws.uniform(0.0, 0.7) * took if kills < times else None)
        if process.is_alive():
            process.kill()
            process.join()
            kills += 1
            continue
        assert process.exitcode == 0, f"after {kills} kills it ended with {process.exitcode}"
        left = sorted(p.name for p in folder.rglob("*") if ".partial" in p.name)
        assert not left, f"after {kills} kills left behind: {left}"
        different = differences(whole, out)
        assert not different, f"after {kills} kills differ: {different}"
        shutil.rmtree(out)
        finished += 1
    return {"kills": kills, "finished": finished, "in peace, s": round(took, 2)}


def contents(folder: Path) -> dict[str, Any]:
    """What is in each file of a folder, but for what says how long it took."""
    found = {}
    for file in sorted(folder.rglob("*")):
        if file.is_file() and not TRACES.search(file.name):
            found[str(file.relative_to(folder))] = _content(file, folder)
    return found


def _content(file: Path, folder: Path) -> Any:
    raw = file.read_bytes().replace(os.fsencode(folder), b"OUT")
    if file.suffix == ".json":
        return _without_times(json.loads(raw))
    if file.suffix == ".safetensors":
        return _tensors(raw)
    if file.suffix == ".jsonl":
        lines = [json.loads(line) for line in raw.splitlines()]
        return sorted(json.dumps(_without_times(line), sort_keys=True) for line in lines)
    if file.suffix == ".csv":
        rows = [line.split(",") for line in raw.decode().splitlines()]
        kept = [k for k, name in enumerate(rows[0]) if not QUIET.search(name)]
        return [[row[k] for k in kept if k < len(row)] for row in rows]
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {name: _array(array) for name, array in arrays.items() if not QUIET.search(name)}
    return raw


def _array(array: npt.NDArray[Any]) -> Any:
    """An array's bytes; of JSON in one, what it says."""
    if array.dtype.kind == "U" and array.ndim == 0:
        with contextlib.suppress(ValueError):
            return _without_times(json.loads(str(array)))
    return array.tobytes()


def _tensors(raw: bytes) -> Any:
    """What is in weights, the words about them included."""
    size = int.from_bytes(raw[:8], "little")
    head = json.loads(raw[8 : 8 + size])
    words = {}
    for name, text in head.pop("__metadata__", {}).items():
        try:
            words[name] = _without_times(json.loads(text))
        except ValueError:
            words[name] = text
    return _without_times(words), head, raw[8 + size :]


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if not QUIET.search(k)}
    return [_without_times(part) for part in value] if isinstance(value, list) else value


def differences(one: Path, two: Path) -> list[str]:
    """Names of files that are in one folder alone, or differ."""
    return different(contents(one), contents(two))


def different(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[str]:
    """Names of files that are among the `contents` of one folder alone, or differ."""
    return sorted(n for n in {*first, *second} if n not in first or first[n] != second.get(n))


def main() -> int:
    """Kill what was asked for, and print what became of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--command", nargs="+", required=True, help=f"all, {', '.join(COMMANDS)}")
    parser.add_argument("--times", type=int, default=10, help="how often each is killed")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    tqdm.monitor_interval = 0  # its thread may hold a lock at the moment of a fork
    names = list(COMMANDS) if options.command == ["all"] else options.command
    worst = 0
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = killed(COMMANDS[name], Path(folder), options.times, options.seed)
            except AssertionError as error:
                found, worst = {"FAILED": str(error)}, 1
        print(name, found, flush=True)
    return worst


if __name__ == "__main__":
    sys.exit(main())
