"""The tables of the state: `<!-- state table: DRONE -->` becomes every quantity of that table.

They are read from `swarm_envs.tables`, so a field that is added there is on the page as well.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.tables import DRONE, ENVIRONMENT, SETTINGS, Field

TABLES = {"DRONE": DRONE, "ENVIRONMENT": ENVIRONMENT, "SETTINGS": SETTINGS}
"""The tables that a page may ask for."""


def state_table(name: str) -> str:
    """One table in Markdown: a row for each quantity.

    Raises:
        KeyError: there is no such table.
    """
    head = ["| field | shape | type | unit | at reset | |", "|---|---|---|---|---|---|"]
    return "\n".join([*head, *map(_row, TABLES[name])])


def _row(field: Field) -> str:
    kind = np.dtype(field.kind)
    reset = "" if field.reset is None else f"`{kind.type(field.reset).item()}`"
    cells = [f"`{field.name}`", f"`{field.shape}`", f"`{kind}`", field.unit, reset, field.meaning]
    return " ".join(["|", " | ".join(cell.replace("|", r"\|") for cell in cells), "|"])
