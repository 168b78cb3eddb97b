"""Tables of episodes as files: Parquet, or CSV where pyarrow is not installed."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from swarm_envs.files import pyarrow, written_whole

Form = Literal["parquet", "csv"]

_TEXT = ("task_id", "agent", "refusal")
_FLAGS = ("refused", "success", "collided", "near_miss")
_WHOLE = ("drones", "seed", "episode", "decisions")


def check_form(form: Form) -> None:
    """Refuse Parquet where it cannot be written, before hours are spent on its content.

    Raises:
        ImportError: pyarrow is missing; the message says how to get it, or do without.
    """
    if form == "parquet":
        _arrow()


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of the same columns, whole or not at all; the same rows, the same bytes.

    Args:
        path: ends in `.parquet` or `.csv`.
        rows: None stands for no value, in CSV an empty cell.

    Raises:
        ImportError: Parquet without pyarrow.
        OSError: the file cannot be written.
    """
    names = list(rows[0]) if rows else []
    with written_whole(path) as partial:
        if path.suffix == ".csv":
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, names, lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
            return
        arrow, parquet = _arrow()
        schema = arrow.schema([(name, _type(arrow, name)) for name in names])
        columns = {name: [row[name] for row in rows] for name in names}
        parquet.write_table(arrow.table(columns, schema=schema), partial)


def _type(arrow: Any, name: str) -> Any:
    if name in _TEXT:
        return arrow.string()
    if name in _FLAGS:
        return arrow.bool_()
    return arrow.int64() if name in _WHOLE else arrow.float64()


def _arrow() -> tuple[Any, Any]:
    return pyarrow("a table of episodes in Parquet", "write CSV by --table csv")
