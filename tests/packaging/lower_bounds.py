"""The oldest dependencies that pyproject.toml admits, as constraints for pip.

Every bound is `>=`, so each becomes `==`; what those depend on themselves pip chooses.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

OWN = "swarm-envs"
_REQUIREMENT = re.compile(r"([\w-]+)(?:\[([\w,-]+)\])?(?:>=([\w.]+))?\s*(?:;\s*(.+))?")


def lowest(pyproject: Path, extras: Sequence[str] = ()) -> list[str]:
    """Constraints, one a direct dependency, in the order of the file."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    return list(dict.fromkeys(_pinned(project, extras)))


def _pinned(project: dict[str, Any], extras: Sequence[str]) -> Iterator[str]:
    optional = project["optional-dependencies"]
    for text in [*project["dependencies"], *(d for extra in extras for d in optional[extra])]:
        read = _REQUIREMENT.fullmatch(text)
        if read is None:
            raise ValueError(f"{text!r} in pyproject.toml is not written `name>=bound; marker`")
        name, others, bound, marker = read.groups()
        if name == OWN:
            yield from _pinned(project | {"dependencies": []}, others.split(","))
        elif bound is None:
            raise ValueError(f"{text!r} in pyproject.toml needs a lower bound: `{name}>=...`")
        else:
            yield f"{name}=={bound}" + (f"; {marker}" if marker else "")
