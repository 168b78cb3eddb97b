"""What reports hold, and the digest of a data file: without torch, for those who only log."""

from __future__ import annotations

import dataclasses
import hashlib
import math
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


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file: says exactly which data was fitted."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
