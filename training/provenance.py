"""What reports hold, and the digest of a data file: without torch, for those who only log."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from pathlib import Path


def json_ready(value: object) -> object:
    """Turn dataclasses and tuples into what JSON holds; a path keeps only its name.

    A number that is not finite, such as the mean of no rows, becomes null: JSON has none.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.name if isinstance(value, Path) else value


def differing(there: Mapping[str, object], here: Mapping[str, object]) -> str:
    """Entries in which two configurations differ, in words: `seed is 0 there, 1 here`.

    Args:
        there: as JSON holds it; nested ones are named after their place, `noise.velocity`.
        here: the other, likewise; an entry that one lacks is taken for null.

    Returns:
        The differences, joined; empty if there are none.
    """
    old, new = _flat(there), _flat(here)
    names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    return "; ".join(f"{n} is {_short(old, n)} there, {_short(new, n)} here" for n in names)


def _flat(content: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def _short(content: Mapping[str, object], name: str) -> str:
    text = str(content.get(name))
    return text if len(text) <= 80 else f"{text[:77]}..."


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file: says exactly which data was fitted."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
