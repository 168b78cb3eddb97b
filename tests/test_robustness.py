"""Commands that are killed and run again, and commands whose files find no space."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

from swarm_envs.cli import main
from tests.helpers.sources import ROOT
from tests.helpers.tiny_fits import rows_of

resource = pytest.importorskip("resource")  # POSIX

FLY = "fly --agent hover --drones 2 --horizon-s 0.5 --physics batch --trajectory OUT/flight.npz"
EVALUATE = "evaluate --drones 2 --horizon-s 1 --agent hover --episodes 60 --out OUT"
BENCHMARK = "benchmark --agent hover --task swap-random-2-v2 --episodes 24 --out OUT"
GRADE = "grade --assignment controller --agent KIT/controller.py:MyController --episodes 4"
GRADE += f" --seed {1 << 128}"
TRAIN = "train --drones 2 --environments 8 --hidden 8 --neighbors 1 --interactions none"
TRAIN += " --algo dagger --evaluations 2 --evaluation-episodes 4 --dagger.batch-size 64"
TRAIN += " --steps 8000 --checkpoint-rollouts 3 --no-progress --out OUT"
FIT = "fit --data ROWS --steps 400 --batch-size 64 --no-progress --out OUT"
COMMANDS: Mapping[str, str] = {
    "demo": "demo --swaps 1 --no-video --out OUT",
    "fly": FLY,
    "evaluate": EVALUATE,
    "benchmark": BENCHMARK,
    "grade": f"{GRADE} --out OUT/grades.csv",
    "assignment": "assignment start controller OUT/kit",
    "collect": "collect --teams S SL --duration-s 4 --no-progress --out OUT",
    "train": TRAIN,
    "fit": FIT,
}
"""Every command that writes, as small as it can be."""
TIMES = re.compile(
    r"(^|_)(s|ms|us|seconds|times?|wall|rate|per_s|p50|p99|command|started|runs|next)(_least|_most)?$"
)
"""Names of entries that differ between two runs: times, commands, and advice with the folder."""
UNCOMPARED = re.compile(r"^manifest\.json$|\.lock$|partial|tfevents|\.(png|html|md)$")
"""Files of which no two runs write the same bytes, or that show what is in others."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, str]:
    """Return the inputs of commands: an assignment's files, and rows of a force."""
    from swarm_envs.training.interaction_rows import save_rows

    folder = tmp_path_factory.mktemp("inputs")
    save_rows(folder / "rows.npz", rows_of())
    assert main(["assignment", "start", "controller", str(folder / "kit")]) == 0
    return {"KIT": str(folder / "kit"), "ROWS": str(folder / "rows.npz")}


def words(command: str, places: Mapping[str, str]) -> list[str]:
    """Return a command as a process takes it, with its folders in place of their names."""
    for name, path in places.items():
        command = command.replace(name, path)
    return [sys.executable, "-m", "swarm_envs", *command.split()]


def run(command: Sequence[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, **options)


def killed(command: Sequence[str], after_s: float) -> bool:
    """Run a command and kill it after a time; return False if it had ended by then."""
    silent = subprocess.DEVNULL
    with subprocess.Popen(
        command, cwd=ROOT, start_new_session=True, stdout=silent, stderr=silent
    ) as process:
        try:
            return process.wait(after_s) != 0
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return True


def contents(folder: Path) -> dict[str, Any]:
    """Return what a run has written by file, without what differs between two runs."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    return {
        str(file.relative_to(folder)): content(file)
        for file in files
        if not UNCOMPARED.search(file.name)
    }


def content(file: Path) -> Any:
    """Return what is in a file, without times."""
    if file.suffix == ".json":
        return without_times(json.loads(file.read_text("utf-8")))
    if file.suffix == ".jsonl":  # a line an episode, in the order in which they ended
        lines = file.read_text("utf-8").splitlines()
        return sorted(json.dumps(without_times(json.loads(line))) for line in lines)
    if file.suffix == ".csv":
        rows = [line.split(",") for line in file.read_text("utf-8").splitlines()]
        kept = [k for k, name in enumerate(rows[0]) if not TIMES.search(name)]
        return [[row[k] for k in kept] for row in rows]
    if file.suffix == ".parquet":
        columns = pytest.importorskip("pyarrow.parquet").read_table(file).to_pydict()
        return without_times(columns)
    if file.suffix == ".safetensors":
        return {name: array.tobytes() for name, array in load_file(file).items()}
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {n: a.tobytes() for n, a in arrays.items() if a.dtype.kind != "U"}
    return file.read_bytes()


def without_times(value: Any) -> Any:
    """Return JSON without the entries that say how long something took."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if not TIMES.search(k)}
    return [without_times(part) for part in value] if isinstance(value, list) else value


QUICK = ("fly", "assignment")
NAMES = [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in COMMANDS]


def needs_torch(name: str) -> None:
    """Skip what trains where there is nothing to train with."""
    if name in ("train", "fit"):
        pytest.importorskip("stable_baselines3")


@pytest.mark.parametrize("name", NAMES)
def test_killed_and_run_again_it_writes_the_same(name, inputs, tmp_path):
    needs_torch(name)
    whole, out = tmp_path / "whole" / "run", tmp_path / "killed" / "run"
    begin = time.monotonic()
    done = run(words(COMMANDS[name], {**inputs, "OUT": str(whole)}))
    assert done.returncode == 0, done.stderr
    took_s = time.monotonic() - begin
    command = words(COMMANDS[name], {**inputs, "OUT": str(out)})
    if killed(command, 0.7 * took_s) and contents(out) != contents(whole):
        done = run(command)
        assert done.returncode == 0, done.stderr
    assert not list(out.rglob("*partial*"))
    assert contents(out) == contents(whole)


def limit_files() -> None:
    """Let a process write 100 bytes into any file."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))


@pytest.mark.parametrize("name", NAMES)
def test_without_space_it_says_so_and_leaves_nothing_half_written(name, inputs, tmp_path):
    needs_torch(name)
    out = tmp_path / "run"
    out.mkdir()
    (out / "note.txt").write_text("before")
    command = words(COMMANDS[name], {**inputs, "OUT": str(out)})
    done = run(command, preexec_fn=limit_files)
    assert done.returncode in (1, 2)
    assert "File too large" in done.stderr or "cannot be written" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr
    assert (out / "note.txt").read_text() == "before"
    assert not list(out.rglob("*partial*"))
