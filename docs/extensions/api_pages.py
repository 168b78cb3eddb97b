"""Reference pages: `.. modules:: PACKAGE` stands for every module below a package.

First come the names that its packages offer, then all modules. A module is on one page alone, that
of the longest package which its name begins with, so that a new module needs no new line anywhere.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .names import exports, listed_names, modules, public_names

MARK = re.compile(r"^\.\. modules:: (\S+)$", re.MULTILINE)
SINGLE = (
    "swarm_envs.reference",
    "swarm_envs.reference_numbers",
    "swarm_envs.trajectories",
    "swarm_envs.vehicles",
)
"""Modules that are no packages and that users import from; modules of tasks are others."""


def packages_of(folder: Path) -> list[str]:
    """The packages that the pages of a folder ask for."""
    texts = [page.read_text(encoding="utf-8") for page in sorted(folder.glob("*.rst"))]
    return [name for text in texts for name in MARK.findall(text)]


def page_of(module: str, packages: list[str]) -> str | None:
    """The longest of the packages that a module is, or is in."""
    around = [p for p in packages if f"{module}.".startswith(f"{p}.")]
    return max(around, key=len, default=None)


def expand(text: str, packages: list[str]) -> str:
    """A page's text with each mark replaced by its modules."""

    def below(mark: re.Match[str]) -> str:
        mine = [m for m in modules() if page_of(m, packages) == mark[1]]
        offering = [line for line in map(_offered, mine) if line]
        public = ["Public API", "----------", "", *offering, ""] if offering else []
        return "\n".join([*public, "\n\n".join(map(_section, mine))])

    return MARK.sub(below, text)


def _offered(module: str) -> str:
    """Return the line of the names that users import from a module; empty if there are none."""
    names = (exports(module) or listed_names(module)) if _is_public(module) else []
    if re.fullmatch(r"swarm_envs\.[a-z]+_v\d+", module):
        names = [(name, f"{module}.{name}") for name in ("parallel_env", "env")]
    links = [
        f":py:obj:`{name} <{home}>`" if home in public_names() else f"``{name}``"
        for name, home in names
    ]
    return f"- ``{module}``: {', '.join(links)}" if links else ""


def _is_public(module: str) -> bool:
    """Return True for a package, one of `SINGLE`, or a module of a package without names."""
    package = module.rpartition(".")[0]
    alone = package in modules() and package != "swarm_envs" and not exports(package)
    return modules()[module].name == "__init__.py" or module in SINGLE or alone


def _section(module: str) -> str:
    title = module.replace("_", r"\_")
    return "\n".join([title, "-" * len(title), "", f".. automodule:: {module}", ""])


def setup(app: Any) -> dict[str, Any]:
    """Tell Sphinx."""

    def read(app: Any, page: str, content: list[str]) -> None:
        if MARK.search(content[0]):
            content[0] = expand(content[0], packages_of(Path(app.srcdir) / "api"))

    app.connect("source-read", read)
    return {"parallel_read_safe": True}
