"""Tables in the docs: that they say what the files beside them, and the code, hold."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

import numpy as np
import pytest

from docs.extensions.state_tables import TABLES, expand, state_table
from tests.helpers.pages import DOCS

ROW = re.compile(
    r"^\| (?:(\d): )?([^|]*)\| (\d+ x \d+ x \d+) \| ([\d,]+) \| (.*) \|$", re.MULTILINE
)


def table() -> Iterator[tuple[str, str, str, list[str]]]:
    """Rows of the figures' table of docs/rth3d.md: figure, grid, robots, and the numbers."""
    text = (DOCS / "rth3d.md").read_text(encoding="utf-8").partition("| figure | grid |")[2]
    figure = ""
    for match in ROW.finditer(text.partition("\n\n")[0]):
        figure = match[1] or figure
        numbers = [cell.strip() for cell in match[5].split("|")]
        yield figure, match[3].replace(" ", ""), match[4].replace(",", ""), numbers


def measured(figure: str, grid: str, robots: str) -> list[list[str]]:
    """What the file of a figure holds of a grid, one list of numbers for each of its curves."""
    with (DOCS / "rth3d" / f"figure_{figure}.csv").open(encoding="utf-8") as file:
        own = [r for r in csv.DictReader(file) if (r["grid"], r["robots"]) == (grid, robots)]
    found = []
    for series in dict.fromkeys(row["series"] for row in own):
        by = {row["method"]: row for row in own if row["series"] == series}
        pairs = [
            f"{float(by[m]['ratio_before_compaction']):.2f}, {float(by[m]['ratio']):.3f}"
            for m in ("rth3d", "rth3d-lba")
        ]
        auto = f"{float(by['auto']['ratio']):.3f}" if "auto" in by else ""
        spent = [
            f"{float(by[m]['cpu_s']):.2g}" if m in by else "-"
            for m in ("rth3d", "rth3d-lba", "auto")
        ]
        found.append([by["rth3d"]["runs"], *pairs, auto, " / ".join(spent)])
    return found


ROWS = list(table())


def test_the_table_is_found():
    assert {row[0] for row in ROWS} == set("56789") and len(ROWS) > 30


@pytest.mark.parametrize(("figure", "grid", "robots", "numbers"), ROWS)
def test_a_row_says_what_was_measured(figure, grid, robots, numbers):
    assert numbers in measured(figure, grid, robots)


@pytest.mark.parametrize("name", TABLES)
def test_the_page_of_the_architecture_shows_every_field(name):
    text = expand((DOCS / "architecture.md").read_text(encoding="utf-8"))
    assert f"state table: {name}" not in text
    for field in TABLES[name]:
        row = [f"`{field.name}`", f"`{field.shape}`", f"`{np.dtype(field.kind)}`", field.unit]
        assert f"\n| {' | '.join(row)} | " in text
        assert f" | {field.meaning} |\n" in text


def test_a_row_says_what_a_field_holds_after_a_reset():
    assert "| `held` | `()` | `bool` |  | `False` | Whether" in state_table("ENVIRONMENT")
    assert "| `touched_drone` | `()` | `float64` |  | `-1.0` | Drone" in state_table("DRONE")
    assert "| `position` | `(3,)` | `float64` | m |  | Position" in state_table("DRONE")
    with pytest.raises(KeyError, match="DRONES"):
        expand("<!-- state table: DRONES -->")
