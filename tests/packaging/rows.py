"""The installations of the matrix, and the steps that it tries in each."""

from __future__ import annotations

from dataclasses import dataclass

OPTIONAL = {
    "parquet": ("pyarrow",),
    "film": ("imageio_ffmpeg",),
    "viz": ("imageio_ffmpeg", "pyarrow"),
    "train": ("torch", "stable_baselines3"),
    "tensorboard": ("tensorboard", "torch", "stable_baselines3"),
    "ray": ("ray",),
    "minari": ("minari", "h5py"),
    "docs": ("sphinx", "furo", "myst_parser"),
}
"""By extra, the packages that it brings, by the names they import as."""
OPTIONAL["all"] = tuple(sorted({p for e in OPTIONAL if e != "docs" for p in OPTIONAL[e]}))
EVERY_OPTIONAL = frozenset(package for packages in OPTIONAL.values() for package in packages)

BASE = ("modules", "first step", "agents", "demo", "fly", "evaluate", "README", "quickstart")
"""The steps of a base installation; see `tests.packaging.steps`."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """An installation, and what is tried in it."""

    name: str
    python: str = "3.11"  # version of the interpreter
    extras: tuple[str, ...] = ()
    oldest: bool = False
    """install the oldest dependencies that pyproject.toml admits, not the newest"""
    locked: bool = False  # nothing in the installation can be written, and there is no network
    steps: tuple[str, ...] = BASE  # what is tried, in this order

    def absent(self) -> list[str]:
        """Optional packages that this row does not ask for."""
        present = {package for extra in self.extras for package in OPTIONAL[extra]}
        return sorted(EVERY_OPTIONAL - present)

    def requirement(self, wheel: str) -> str:
        """The requirements for pip."""
        return f"{wheel}[{','.join(self.extras)}]" if self.extras else wheel


ROWS = (
    Row(name="newest", steps=(*BASE, "refusals")),
    Row(name="oldest", extras=("viz",), oldest=True, steps=(*BASE, "page", "tests")),
    Row(name="3.12", python="3.12", steps=(*BASE, "tests")),
    Row(name="3.13", python="3.13", steps=(*BASE, "tests")),
    Row(name="3.14", python="3.14", steps=(*BASE, "tests")),
    Row(name="locked", locked=True),
    Row(name="viz", extras=("viz",), steps=("modules", "page")),
    Row(name="ray", extras=("ray",), steps=("modules", "cluster")),
    Row(name="train", extras=("train",), steps=("modules", "train")),
    Row(name="docs", extras=("docs",), steps=("modules",)),
    Row(name="all", extras=("all",), steps=("modules", "page", "cluster", "train")),
)
"""Every row, none with a display. Rows with torch need constraints.txt beside pyproject.toml."""
