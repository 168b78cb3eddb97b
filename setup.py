"""The description on PyPI: the README with links into the repository.

They lead to `Repository` under `[project.urls]` of pyproject.toml. Without it they become text,
and pictures are left out. Everything else is in pyproject.toml.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
REPOSITORY = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["urls"].get(
    "Repository"
)
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?://)([^)\s]+)\)")


def absolute(link: re.Match[str]) -> str:
    """A link or picture of the README as it is on PyPI."""
    picture, text, target = link.groups()
    if REPOSITORY is None:
        return "" if picture else text
    return f"{picture}[{text}]({REPOSITORY}/{'raw' if picture else 'blob'}/main/{target})"


setup(
    long_description=LINK.sub(absolute, (ROOT / "README.md").read_text("utf-8")),
    long_description_content_type="text/markdown",
)
