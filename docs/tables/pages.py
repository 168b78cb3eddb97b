"""Write the tables of all pages; a test checks that they are up to date."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from docs.tables.figure_tables import figure_table
from docs.tables.option_tables import assignment_table, command_tables, settings_table
from docs.tables.recommendations import recommendation_table
from docs.tables.state_tables import state_table
from docs.tables.task_pages import action_table, observation_table, task_page

DOCS = Path(__file__).parents[1]
TABLES: dict[str, Callable[..., str]] = {
    "action table": action_table,
    "assignment table": assignment_table,
    "commands": command_tables,
    "figure table": figure_table,
    "observation table": observation_table,
    "option table": settings_table,
    "recommended agents": recommendation_table,
    "state table": state_table,
    "task": task_page,
}
"""The function of each mark; it takes what follows the colon, as in `<!-- task: swap_v1 -->`."""
MARK = re.compile(rf"^<!-- ({'|'.join(TABLES)})(?:: (\w+))? -->$", re.MULTILINE)
_PLACE = re.compile(MARK.pattern + r".*?^<!-- end -->$", re.MULTILINE | re.DOTALL)


def filled(text: str) -> str:
    """Return the text of a page with new tables.

    Raises:
        KeyError: there is no such table.
    """
    return _PLACE.sub(lambda place: _written(*place.groups()), text)


def _written(kind: str, name: str | None) -> str:
    mark, given = (kind, ()) if name is None else (f"{kind}: {name}", (name,))
    return f"<!-- {mark} -->\n\n{TABLES[kind](*given).strip()}\n\n<!-- end -->"


if __name__ == "__main__":
    for page in sorted(DOCS.rglob("*.md")):
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
