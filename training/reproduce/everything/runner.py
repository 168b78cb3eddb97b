"""One item after another into folders of their own, each complete or gone on with."""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TextIO

from tqdm import tqdm

from swarm_envs.files import write_json
from swarm_envs.training.reproduce.everything.item import Item, Preset, shell
from swarm_envs.training.reproduce.everything.rows import Row

State = Literal["done", "failed", "not run", "not remade"]
"""Of an item: remade, gone wrong, not asked for yet, and what no simulation remakes."""
Execute = Callable[[Sequence[str]], int]
"""Runs the words of a `swarm-envs` command and gives its exit code."""

RECORD = "item.json"
"""Written last into an item's folder: it is complete, or has failed and says how."""
_INTERRUPTED = 130


@dataclass(frozen=True)
class Outcome:
    """What came of an item."""

    item: Item
    """What was to be remade."""
    state: State
    """How it stands."""
    commands: tuple[str, ...] = ()
    """What remakes it, as one types it."""
    rows: tuple[Row, ...] = ()
    """The paper's numbers and ours."""
    cpu_s: float = 0.0
    """CPU time that it took, s; of the last part, if it was interrupted."""
    error: str = ""
    """What went wrong."""

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "item": self.item.key,
            "label": self.item.label,
            "shows": self.item.shows,
            "state": self.state,
            "missing": self.item.missing,
            "error": self.error,
            "commands": list(self.commands),
            "cpu_s": self.cpu_s,
            "rows": [row.as_json() for row in self.rows],
        }


@dataclass(frozen=True)
class Job:
    """A run of many items."""

    out: Path
    """Folder of all."""
    preset: Preset
    """How much is run."""
    data: Path | None
    """Rows of measured force."""
    execute: Execute
    """Runs a command."""
    seed: int = 0
    """Of every command."""

    def folder(self, item: Item) -> Path:
        """Of an item."""
        return self.out / item.key

    def words(self, item: Item) -> list[list[str]]:
        """The commands of an item."""
        return item.commands(self.preset, self.folder(item), self.data, self.seed)


class _Heard:
    """A stream that keeps what is written to it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.text = ""

    def write(self, text: str) -> int:
        self.text = (self.text + text)[-4000:]
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def standing(job: Job, item: Item) -> Outcome:
    """How an item stands in its folder, without running anything."""
    if item.missing:
        return Outcome(item, "not remade")
    commands = tuple(shell(words) for words in job.words(item))
    path = job.folder(item) / RECORD
    if not path.is_file():
        return Outcome(item, "not run", commands)
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        found = Outcome(
            item, record["state"], commands, (), float(record["cpu_s"]), record["error"]
        )
    except (ValueError, KeyError, TypeError):
        return Outcome(item, "not run", commands)
    return _read(job, found) if found.state == "done" else found


def _read(job: Job, outcome: Outcome) -> Outcome:
    """The outcome with its rows; failed if they cannot be read."""
    assert outcome.item.read is not None
    try:
        rows = tuple(outcome.item.read(job.folder(outcome.item), job.preset))
        pictures = [job.folder(outcome.item) / name for name in outcome.item.pictures]
        absent = [path.name for path in pictures if not path.is_file()]
        if not rows or absent:
            raise ValueError(f"it left no {', '.join(absent) or 'numbers'}")
    except Exception as error:  # whatever is wrong with one item, the others stand
        said = f"its numbers cannot be read: {type(error).__name__}: {error}"
        return replace(outcome, state="failed", error=said)
    return replace(outcome, rows=rows)


def run_item(job: Job, item: Item) -> Outcome:
    """Run the commands of an item, and record what came of it.

    Raises:
        KeyboardInterrupt: it was interrupted; called again, the commands go on where they were.
        OSError: the folder cannot be written.
    """
    folder, begin = job.folder(item), time.process_time()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / RECORD).unlink(missing_ok=True)
    error = ""
    with (folder / "said.txt").open("w", encoding="utf-8") as said:
        for words in job.words(item):
            error = _run(job.execute, words, said)
            if error:
                break
    commands = tuple(shell(words) for words in job.words(item))
    cpu_s = round(time.process_time() - begin, 1)
    outcome = Outcome(item, "failed" if error else "done", commands, (), cpu_s, error)
    if not error:
        outcome = _read(job, outcome)
    write_json(
        folder / RECORD, {"state": outcome.state, "error": outcome.error, "cpu_s": outcome.cpu_s}
    )
    return outcome


def _run(execute: Execute, words: Sequence[str], said: TextIO) -> str:
    """Run one command; what went wrong, empty if nothing did."""
    heard = _Heard(sys.stderr)
    said.write(f"$ {shell(words)}\n")
    try:
        with redirect_stdout(said), redirect_stderr(heard):
            code = execute(words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except Exception as error:
        said.write(traceback.format_exc())
        return f"{type(error).__name__}: {error}"
    if code == _INTERRUPTED:
        raise KeyboardInterrupt
    if code == 0:
        return ""
    lines = [line for line in heard.text.replace("\r", "\n").splitlines() if line.strip()]
    last = next((line for line in reversed(lines) if "error" in line.lower()), "")
    return last or f"exit code {code}: {lines[-1] if lines else 'nothing was said'}"


def run_all(
    job: Job,
    items: Sequence[Item],
    each: Callable[[Mapping[str, Outcome]], None],
    say: Callable[[str], None] = print,
    progress: bool = True,
) -> dict[str, Outcome]:
    """Run the items that are not complete yet, one after another; one that fails stops no other.

    Args:
        job: where, how much and by what.
        items: what is wanted.
        each: called with the outcomes of all items so far, by key, after each.
        say: told what an earlier run has left.
        progress: show a progress bar.

    Returns:
        The outcomes of the items, by key.
    """
    found = {item.key: standing(job, item) for item in items}
    todo = [item for item in items if found[item.key].state in ("not run", "failed")]
    done = sum(outcome.state == "done" for outcome in found.values())
    if done:
        begun = [i.key for i in todo if job.folder(i).is_dir() and found[i.key].state == "not run"]
        gone = f"; {', '.join(begun)} goes on where it was" if begun else ""
        say(f"going on: {done} items are complete, {len(todo)} are to be done{gone}")
    wanted = done + len(todo)
    bar = tqdm(total=wanted, initial=done, desc="items", unit="item", disable=not progress)
    with bar:
        for item in todo:
            bar.set_postfix_str(item.key)
            found[item.key] = run_item(job, item)
            each(found)
            bar.update()
    return found
