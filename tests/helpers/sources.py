"""The checkout's root, and the files of the package by the names of their modules."""

from __future__ import annotations

import os
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[2]
OUTER = ("agents", "baselines", "training")
"""Folders beside `swarm_envs` that are linked into it."""


def files_below(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the files of a folder in order, without caches, which other processes may empty."""
    found = []
    for home, folders, names in os.walk(folder, followlinks=True):
        folders[:] = [name for name in folders if name != "__pycache__"]
        found += [Path(home, name) for name in names if fnmatch(name, pattern)]
    return sorted(found)


def sources() -> dict[str, Path]:
    """Return the file of every module of the package, by the module's import name."""
    found = {}
    for file in files_below(ROOT / "swarm_envs", "*.py"):
        parts = file.relative_to(ROOT).with_suffix("").parts
        if "assignments" not in parts[:-2]:  # what is for students is no module
            found[".".join(parts).removesuffix(".__init__")] = file
    return found


SOURCES = sources()
