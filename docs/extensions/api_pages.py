"""Reference pages: `.. modules:: PACKAGE` stands for every module below a package.

A module stands on one page alone, that of the longest package which its name begins with, so that
a new module needs no new line anywhere.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .names import exports, modules, public_names

MARK = re.compile(r"^\.\. modules:: (\S+)$", re.MULTILINE)


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
        return "\n\n".join(map(_section, mine))

    return MARK.sub(below, text)


def _section(module: str) -> str:
    title = module.replace("_", r"\_")
    offered = [
        f":py:obj:`{name} <{home}>`" if home in public_names() else f"``{name}``"
        for name, home in exports(module)
    ]
    lines = [title, "-" * len(title), "", f".. automodule:: {module}"]
    return "\n".join([*lines, "", "Offers " + ", ".join(offered) + "." if offered else ""])


def setup(app: Any) -> dict[str, Any]:
    """Tell Sphinx."""

    def read(app: Any, page: str, content: list[str]) -> None:
        if MARK.search(content[0]):
            content[0] = expand(content[0], packages_of(Path(app.srcdir) / "api"))

    app.connect("source-read", read)
    return {"parallel_read_safe": True}
