"""The pages of the docs as they are written: their links, headings and tables of contents."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.helpers.sources import ROOT

DOCS = ROOT / "docs"
GENERATED = DOCS / "generated"  # what commands wrote, and pages include
PAGES = sorted(
    f for f in DOCS.rglob("*.*") if f.suffix in (".md", ".rst") and f.parent != GENERATED
)
"""Every page, by file."""
_FENCE = re.compile(r"^(`{3,})(.*?)\n(.*?)^\1", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(((?!https?://)[^)\s]+)\)")
_TARGET = re.compile(r"^\(([\w-]+)\)=$", re.MULTILINE)


@cache
def prose(page: Path) -> str:
    """A page's text without its blocks of code."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Links and pictures that lead into the checkout: the file, and the heading in it if any."""
    for target in _LINK.findall(prose(page)):
        path, _, anchor = target.partition("#")
        yield (page.parent / path).resolve() if path else page, anchor


@cache
def anchors(page: Path) -> set[str]:
    """Return the anchors of a page: its headings, as GitHub and MyST write them."""
    heads = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    plain = [re.sub(r"[`*]|\[|\]\([^)]*\)", "", head).lower() for head in heads]
    slugs = {re.sub(r"[^\w\- ]", "", head).strip().replace(" ", "-") for head in plain}
    return slugs | set(_TARGET.findall(prose(page)))


def listed(page: Path) -> Iterator[Path]:
    """Pages that a page's tables of contents name."""
    text = page.read_text(encoding="utf-8")
    entries: list[str] = []
    for _, kind, body in _FENCE.findall(text):
        if kind == "{toctree}":
            entries += body.splitlines()
    if page.suffix == ".rst":
        entries += re.findall(r"^   (\S+)$", text, re.MULTILINE)
    for entry in entries:
        if entry.strip() and not entry.strip().startswith(":"):
            yield from page.parent.glob(f"{entry.strip()}.md")
            yield from page.parent.glob(f"{entry.strip()}.rst")
