"""Records of runs: options and reports as JSON, and digests of data files."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from swarm_envs.files import write_json

__all__ = [
    "begin_manifest",
    "changed_options",
    "check_same",
    "file_sha256",
    "json_ready",
]


def json_ready(value: object) -> object:
    """Convert dataclasses and tuples for JSON; of a path only the name is kept.

    A number that is not finite, such as the mean of no rows, becomes None.
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
    """Return the differences of two configurations as text, such as `seed is 0 there, 1 here`.

    An entry `file of task` is a digest, of which the text says that the file has changed.

    Args:
        there: a configuration from JSON; nested entries are named `noise.velocity`.
        here: another one; a missing entry counts as null.

    Returns:
        The differences, joined; empty if there are none.
    """
    old, new = _flat(there), _flat(here)
    names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    return "; ".join(
        f"the {n}, or a file that it imports, has changed"
        if n.startswith("file of ")
        else f"{n} is {_short(old, n)} there, {_short(new, n)} here"
        for n in names
    )


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


def check_same(path: Path, there: Mapping[str, object], here: Mapping[str, object]) -> None:
    """Check that a file was made with the same options, both from JSON.

    Raises:
        ValueError: they differ; the message lists the differences.
    """
    differences = differing(there, here)
    if differences:
        raise ValueError(
            f"{str(path)!r} was made with other options: {differences}; "
            "choose another folder, or delete that one"
        )


def begin_manifest(path: Path, origin: Mapping[str, object]) -> None:
    """Write the origin of a folder to a manifest, or check that an existing one is the same.

    Raises:
        ValueError: it differs, or the file is damaged.
    """
    wanted = json.loads(json.dumps(json_ready(origin)))
    if not path.is_file():
        write_json(path, wanted)
        return
    try:
        found = dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is damaged ({error}); delete it") from error
    check_same(path, {name: found.get(name) for name in wanted}, wanted)


def changed_options(config: Any, prefix: str = "--", aside: Sequence[str] = ()) -> list[str]:
    """Return the options of a command that differ from their defaults, except `aside`.

    Nested options have prefixes, such as `--logs.rate-hz`.
    """
    words = []
    for entry in dataclasses.fields(config):
        value, option = getattr(config, entry.name), entry.name.replace("_", "-")
        name = prefix + option
        if dataclasses.is_dataclass(value):
            words += changed_options(value, f"{name}.", aside)
        elif entry.default in (dataclasses.MISSING, value) or entry.name in aside:
            continue
        elif isinstance(value, bool):
            words.append(name if value else f"{prefix}no-{option}")
        else:
            given = value if isinstance(value, tuple) else (value,)
            words.append(f"{name} {' '.join(map(str, given))}")
    return words


def file_sha256(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
