"""What reports of flight tests share: statistics, whose weights flew, which versions."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from contextlib import suppress
from importlib import metadata, resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs import __version__
from swarm_envs.interactions import InteractionModel

_PACKAGES = ("numpy", "numba", "pybullet", "gymnasium", "pettingzoo")


def quartiles(values: npt.ArrayLike) -> dict[str, float]:
    """Median and quartiles of numbers, by linear interpolation."""
    low, median, high = np.quantile(np.asarray(values), [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "lower_quartile": low, "upper_quartile": high}


def describe_spread(statistics: dict[str, float]) -> str:
    """Write what `quartiles` gave as `median (lower - upper)`."""
    median, low, high = (statistics[k] for k in ("median", "lower_quartile", "upper_quartile"))
    return f"{median:.1f} ({low:.1f} - {high:.1f})"


def describe_model(model: InteractionModel) -> dict[str, str]:
    """Name of a model and the hash of its weights file, without the place of that file."""
    file = Path(model.name)
    if file.is_file():
        return {"name": file.name, "sha256": _sha256(file)}
    shipped = resources.files("swarm_envs.interactions").joinpath("weights")
    for name in (f"{model.name}.safetensors", f"{model.name}.json"):
        with resources.as_file(shipped.joinpath(name)) as path:
            if path.is_file():
                return {"name": model.name, "sha256": _sha256(path)}
    return {"name": model.name, "sha256": ""}


def versions() -> dict[str, str]:
    """Versions of what computes a flight, by package."""
    found = {"swarm_envs": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def format_columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Lines of a table whose first row is its head: the first column to the left, others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))])
        for row in rows
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return lines


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
