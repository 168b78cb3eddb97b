"""Hostile values, and the judgement of what a public function does with one."""

from __future__ import annotations

import dataclasses
import linecache
import os
import signal
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from tests.helpers.sources import ROOT

REFUSALS = (ValueError, TypeError, OSError, ImportError)
"""What may be raised for a bad argument, if the message names it."""
PATIENCE_S = 300  # A call that takes more CPU time hangs; it may have to compile first


class Hang(BaseException):
    """A call took longer than `PATIENCE_S`."""


def hostile_values(folder: Path) -> dict[str, Any]:
    """Values by name that hardly any parameter can take, files among them."""
    return {
        "nan": float("nan"),
        "inf": float("inf"),
        "minus inf": float("-inf"),
        "negative": -1,
        "zero": 0,
        "a half": 0.5,
        "huge": 1e300,
        "huge integer": 10**30,
        "none": None,
        "empty text": "",
        "text": "no such thing",
        "unicode": "Ω \u202e\U0001f681 ñ",
        "null byte": "a\0b",
        "surrogate": "\udcff",
        "long text": "x" * 5000,
        "empty list": [],
        "empty mapping": {},
        "ragged": [[1.0], [1.0, 2.0]],
        "nan array": np.full((2, 3), np.nan),
        "inf pair": (float("inf"), 1.0),
        "reversed pair": (2.0, 1.0),
        "wrong shape": np.zeros((1, 2, 3, 4, 5)),
        "no rows": np.zeros((0, 3)),
        "huge array": np.full((2, 3), 1e300),
        **hostile_paths(folder),
    }


def hostile_paths(folder: Path) -> dict[str, Path]:
    """Files that are not there, no files, damaged, or of other kinds."""
    loop, empty, damaged = folder / "loop", folder / "empty.npz", folder / "damaged.safetensors"
    if not loop.is_symlink():
        loop.symlink_to(loop)
        empty.touch()
        damaged.write_bytes(b"\x08\0\0\0\0\0\0\0{damaged")
        (folder / "table.csv").write_bytes(b"\xff\xfe,not,a,table\n1,\0\n")
        (folder / "list.json").write_text("[1, 2", encoding="utf-8")
        np.savez(folder / "other.npz", a=np.zeros(3))
    return {
        "missing file": folder / "nowhere" / "file.npz",
        "folder": folder,
        "link loop": loop,
        "empty file": empty,
        "damaged weights": damaged,
        "damaged table": folder / "table.csv",
        "damaged json": folder / "list.json",
        "another npz": folder / "other.npz",
        "device": Path("/dev/null"),
        "within a file": empty / "inside",
    }


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    """Raise `Hang` after so much CPU time; from within compiled code, once that returns."""

    def give_up(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def judge(call: Callable[[], object], words: tuple[str, ...], value: Any) -> str | None:
    """What is wrong with how a call ends; None if nothing is.

    Args:
        call: with one bad argument.
        words: one of which a refusal must contain: the parameter's name and what goes for it.
        value: the bad one; a refusal may quote it instead.
    """
    try:
        with patience(PATIENCE_S):
            result = call()
    except Hang:
        return f"took more than {PATIENCE_S} s of CPU time"
    except MemoryError as error:
        return None if isinstance(value, int | float) else f"MemoryError: {error}"
    except Exception as error:
        return _fault(error, words, value)
    return _not_finite(result)


def _fault(error: Exception, words: tuple[str, ...], value: Any) -> str | None:
    text = str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    said = f"{type(error).__name__}: {text[:120]!r} at {os.path.relpath(place.filename, ROOT)}"
    said += f":{place.lineno}"
    if not isinstance(error, REFUSALS):
        return said
    ours = place.filename.startswith(str(ROOT)) and "/tests/" not in place.filename
    raised = ours and _is_raise(place.filename, place.lineno or 0)
    if not raised and not isinstance(error, OSError):
        return f"not refused by us: {said}"
    parts = [value, *value] if isinstance(value, Mapping | list | tuple) else [value]
    quotes = {form(part)[:20].strip("'\"[") or repr(part) for part in parts for form in (repr, str)}
    named = any(w.lower() in text.lower() for w in words) or any(q in text for q in quotes)
    return None if named else f"names neither parameter nor value: {said}"


def _is_raise(file: str, line: int) -> bool:
    """Whether a statement raises, itself or through a helper that begins in `raise`."""
    return any("raise" in linecache.getline(file, line - back) for back in range(4))


def _not_finite(result: object, depth: int = 0) -> str | None:
    """What of a result is NaN."""
    if isinstance(result, float | np.floating) and np.isnan(result):
        return "returned NaN"
    if isinstance(result, np.ndarray):
        bad = result.dtype.kind == "f" and bool(np.isnan(result).any())
        return "returned an array with NaN" if bad else None
    parts: list[object] = []
    if isinstance(result, Mapping):
        parts = list(result.values())
    elif isinstance(result, list | tuple):
        parts = list(result)
    elif dataclasses.is_dataclass(result) and not isinstance(result, type):
        parts = [getattr(result, f.name) for f in dataclasses.fields(result)]
    if depth > 3:
        return None
    return next(filter(None, (_not_finite(part, depth + 1) for part in parts)), None)
