"""Write the tables of all pages; a test checks that they are up to date."""

from __future__ import annotations

import re
from pathlib import Path

from docs.tables import figure_tables, option_tables, recommendations, state_tables, task_pages

DOCS = Path(__file__).parents[1]
_PLACE = re.compile(
    r"^(<!-- (?:(?:\w+ )?table(?:: \w+)?|commands|recommended agents|task: \w+) -->)$"
    r".*?^<!-- end -->$",
    re.MULTILINE | re.DOTALL,
)


def filled(page: Path) -> str:
    """Return the text of a page with new tables."""
    text = page.read_text(encoding="utf-8")
    return _PLACE.sub(
        lambda place: f"{place[1]}\n\n{_table(place[1], page.parent).strip()}\n\n<!-- end -->", text
    )


def _table(mark: str, folder: Path) -> str:
    for module in (option_tables, recommendations, state_tables, figure_tables):
        if (table := module.expand(mark)) != mark:
            return table
    return task_pages.expand(mark, folder)


if __name__ == "__main__":
    for page in sorted(DOCS.rglob("*.md")):
        page.write_text(filled(page), encoding="utf-8")
