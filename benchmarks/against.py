"""Speed of this tree against another commit's, both in one run, measured in turn.

    make bench-against REF=d9123f6
    python -m benchmarks.against --ref d9123f6 --json against.json --peers PYTHON

CPU time of one thread, median of repetitions. Each tree has a process of its own that stays, and
kernels cached in a folder of its own; the two are asked in turn, so that noise of the machine meets
both alike. `faster` is the ratio of speeds in each repetition: above one, this tree is faster. An
agent-step is one drone flying one decision, 48 a second; batches start from the random layout,
after 2 s of hovering. First steps are those of a fresh process without cached kernels, imports
included: Bullet's, then those of the environment on the batch engine, then of `BatchPhysics` alone.
"""

from __future__ import annotations

import argparse
import atexit
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.peers import RATES, batch_peer_row
from benchmarks.rows import Row, run, spread
from swarm_envs.physics import bullet_available

ROOT = Path(__file__).parent.parent
BUILD = ROOT / "build" / "against"  # where other commits' trees and everyone's cached kernels lie
WORKER = Path(__file__).parent / "against_worker.py"
LEAST_SECONDS = 0.2  # each repetition calls as often as fills this time in the other tree
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
BATCH, LARGE = (1024, 4), (1024, 16)  # environments and drones of the batches


class Measured(NamedTuple):
    """A measurement that is made in both trees."""

    row: Row  # as the table shows it
    maker: str  # of `MAKERS` in the worker
    options: dict[str, Any]  # what the maker takes
    work: int  # agent-steps of a call; 0 where the row tells its time, in ms


def measured() -> Iterator[Measured]:
    """Everything that is measured in processes that stay."""
    engines = [("batch", 4), ("batch", 16), *([("bullet", 4)] if bullet_available() else [])]
    for engine, n in engines:
        row = {"what": f"{engine} environment", "drones": n, "force_rate": 240}
        options = {"engine": engine, "drones": n, "force_rate": 240}
        yield Measured(row | {"unit": "agent-steps/s"}, "environment", options, n)
    for engine in ("batch", *(("bullet",) if bullet_available() else ())):
        row = {"what": f"{engine} environment, reset", "drones": 16, "unit": "ms"}
        yield Measured(row, "reset", {"engine": engine, "drones": 16}, 0)
    kinds: list[tuple[str, str, tuple[int, int], dict[str, Any]]] = [
        ("batch, learned forces", "batch", BATCH, {"force_rate": 240}),
        ("batch, learned forces", "batch", BATCH, {"force_rate": 48}),
        ("batch, no forces", "batch", BATCH, {"interactions": "none"}),
        ("flight alone, no forces", "flight", BATCH, {"interactions": "none"}),
        ("batch, learned forces", "batch", LARGE, {"force_rate": 240}),
    ]
    for what, maker, (envs, n), chosen in kinds:
        row = {"what": what, "environments": envs, "drones": n, "unit": "agent-steps/s"}
        options = {"envs": envs, "drones": n, **chosen}
        yield Measured(row | {"force_rate": chosen.get("force_rate")}, maker, options, envs * n)


class Tree:
    """A tree, and a process that measures in it."""

    def __init__(self, folder: Path, kernels: Path | None = None) -> None:
        self._folder, self._kernels = folder, kernels
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  # as long as the process
        self._process: subprocess.Popen[str] | None = None
        atexit.register(self.close)

    def environ(self, kernels: Path | None = None) -> dict[str, str]:
        """Variables of processes that measure here."""
        kept = kernels or self._kernels
        paths = {"PYTHONPATH": str(self._folder)}
        if kept is not None:
            kept.mkdir(parents=True, exist_ok=True)
            paths["NUMBA_CACHE_DIR"] = str(kept)
        return {**os.environ, **ONE_THREAD, **paths}

    def ask(self, **order: Any) -> dict[str, Any]:
        """Return the answer of the process: `seconds`, or the text of an `error`."""
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=self.environ(),
                text=True,
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended: then there is no answer either
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            self._errors.seek(0)
            last = self._errors.read().strip().splitlines()[-20:]
            raise RuntimeError(f"the process of {self._folder} ended:\n" + "\n".join(last))
        answer: dict[str, Any] = json.loads(line)
        return answer

    def first_steps(self) -> dict[str, float]:
        """CPU time of a fresh process without cached kernels, s, by stage."""
        with tempfile.TemporaryDirectory() as empty:
            command = [sys.executable, "-P", str(WORKER), "first"]
            env = self.environ(Path(empty))
            done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError((done.stderr.strip().splitlines() or ["no first step"])[-1])
        found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
        return found

    def close(self) -> None:
        """End the process. May be called more than once."""
        if self._process is not None:
            with self._process:  # closes its pipes, at which it ends, and waits for it
                pass
        self._process = None
        self._errors.close()


def checked_out(ref: str) -> Path:
    """The tree of another commit, as a worktree of this repository's; made once."""
    git = ["git", "-C", str(ROOT)]
    name = subprocess.check_output([*git, "rev-parse", "--short", f"{ref}^{{commit}}"], text=True)
    folder = BUILD / name.strip()
    if not (folder / "swarm_envs").is_dir():
        subprocess.run([*git, "worktree", "prune"], check=True)  # those that `make clean` removed
        add = ["worktree", "add", "--quiet", "--detach", str(folder), name.strip()]
        subprocess.run([*git, *add], check=True)
    return folder


Pair = tuple[list[float], list[float]]
"""Times or speeds in the other tree and in this one, of the same repetitions."""


def in_turn(trees: Sequence[Tree], job: Measured, repetitions: int) -> Pair | str:
    """Seconds of a call in both trees, asked in turn, or why there are none."""
    made = [tree.ask(make=job.maker, options=job.options) for tree in trees]
    errors = [answer["error"] for answer in made if "error" in answer]
    if errors:
        return errors[0]
    times = max(1, math.ceil(LEAST_SECONDS / max(made[0]["seconds"], 1e-6)))
    found: Pair = ([], [])
    for k in range(repetitions):
        for side in (0, 1) if k % 2 == 0 else (1, 0):
            found[side].append(trees[side].ask(times=times)["seconds"])
    return found


def compared(row: Row, pair: Pair | str, fast: bool) -> Iterator[Row]:
    """Three rows: the other tree's, this one's, and how many times as fast this one is."""
    names = [f"{row['what']}, {which}" for which in ("old", "new", "new over old")]
    units = [row["unit"], row["unit"], "times as fast"]
    notes = [{"value": None, "note": pair}] * 2 + [{"value": None, "note": "not measured"}]
    if not isinstance(pair, str):
        over = [b / a if fast else a / b for a, b in zip(*pair, strict=True)]
        notes = [spread(values) for values in (*pair, over)]
    for name, unit, found in zip(names, units, notes, strict=True):
        yield row | {"what": name, "unit": unit} | found


def staying_rows(trees: Sequence[Tree], repetitions: int, only: str = "") -> Iterator[Row]:
    """Rows of what is measured in processes that stay, or of one maker alone."""
    for job in measured():
        if only not in ("", job.maker):
            continue
        pair = in_turn(trees, job, repetitions)
        if not isinstance(pair, str):
            one, two = ([job.work / s if job.work else 1e3 * s for s in side] for side in pair)
            pair = one, two
        yield from compared(job.row, pair, fast=bool(job.work))


def first_rows(trees: Sequence[Tree], repetitions: int) -> Iterator[Row]:
    """Rows of the first steps of fresh processes, stage by stage and all together."""
    stages = {"bullet": "Bullet", "batch": "then the batch engine", "alone": "then BatchPhysics"}
    found: tuple[list[dict[str, float]], list[dict[str, float]]] = ([], [])
    why = ""
    try:
        for k in range(repetitions):
            for side in (0, 1) if k % 2 == 0 else (1, 0):
                found[side].append(trees[side].first_steps())
    except RuntimeError as error:
        why = str(error)
    names = [name for name in stages if name != "bullet" or bullet_available()]
    for parts in (*([name] for name in names), names):
        what = f"first step, {stages[parts[0]]}" if len(parts) == 1 else "first steps, all of them"
        one, two = ([sum(run[name] for name in parts) for run in side] for side in found)
        yield from compared({"what": what, "unit": "CPU s"}, why or (one, two), fast=False)


def rows(options: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured, in the order of the table."""
    other = options.old or checked_out(options.ref)
    trees = [Tree(other, BUILD / f"kernels-{other.name}"), Tree(options.new, BUILD / "kernels-new")]
    yield from staying_rows(trees, options.repetitions, options.only)
    if options.first_steps and not options.only:
        yield from first_rows(trees, options.first_steps)
    if options.peers:
        for rates in RATES:
            yield batch_peer_row(options.peers, rates, *BATCH, options.repetitions)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add what only this benchmark takes."""
    parser.add_argument("--ref", default="HEAD", help="commit that this tree is measured against")
    parser.add_argument("--old", type=Path, help="a folder with its tree, in place of a commit")
    parser.add_argument("--new", type=Path, default=ROOT, help="this tree's folder")
    parser.add_argument("--only", default="", help="measure this alone, such as reset")
    parser.add_argument("--first-steps", type=int, default=3, help="runs of the first steps")
    parser.add_argument("--peers", help="interpreter that has crazyflow, measured beside")


if __name__ == "__main__":
    run(__doc__, rows, configure=configure)
