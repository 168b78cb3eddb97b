"""Links of pages that read well in a checkout, and on the site, where there is no checkout.

A link out of `docs/` leads to the page of model cards if it is one of them, else its words stay.
A line in italics that begins with "In a checkout:" is for checkouts only, and left out.
A line of a toctree that asks for the pages of a folder is left out while there are none.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

OUTWARD = re.compile(r"\[([^\]]+)\]\((\.\./[^)]+)\)")
MANY = re.compile(r"^([\w/-]+\*)\n", re.MULTILINE)
PLAIN = re.compile(r"^_In a checkout: .*_\n", re.MULTILINE)
CARDS = "model-cards.md"


def inward(text: str, page: Path, docs: Path) -> str:
    """A page's text without links out of the folder of the docs."""

    def link(found: re.Match[str]) -> str:
        words, target = found[1], (page.parent / found[2].partition("#")[0]).resolve()
        if target.is_relative_to(docs):
            return found[0]
        if target.name == "MODEL_CARD.md":
            return f"[{words}]({'../' * (len(page.relative_to(docs).parts) - 1)}{CARDS})"
        return words

    return OUTWARD.sub(link, text)


def without_empty_folders(text: str, docs: Path) -> str:
    """The text without lines such as `folder/*` for which there is no page."""
    return MANY.sub(lambda found: found[0] if [*docs.glob(f"{found[1]}.md")] else "", text)


def setup(app: Any) -> dict[str, Any]:
    """Tell Sphinx."""

    def read(app: Any, page: str, content: list[str]) -> None:
        docs = Path(app.srcdir).resolve()
        text = inward(content[0], docs / f"{page}.md", docs)
        content[0] = PLAIN.sub("", without_empty_folders(text, docs))

    app.connect("source-read", read)
    return {"parallel_read_safe": True}
