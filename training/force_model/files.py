"""Reports as JSON files, and the digest of a data file: without torch, for those who only log."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from pathlib import Path


def json_ready(value: object) -> object:
    """Turn dataclasses, tuples and arrays into what JSON holds; a path keeps only its name."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(entry) for entry in value]
    return value.name if isinstance(value, Path) else value


def write_json(path: Path, content: object) -> None:
    """Write JSON so that a reader sees the old file or the whole new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    partial.write_text(json.dumps(content, indent=1) + "\n")
    partial.replace(path)


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file: says exactly which data was fitted."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
