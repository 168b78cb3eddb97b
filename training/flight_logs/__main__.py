"""Look at flight logs: which are sound, how many rows they give, the calibration of each vehicle.

`python -m swarm_envs.training.flight_logs PATH`
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro

from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import DEFAULT, read_data
from swarm_envs.training.interaction_rows import save_rows


def _look(
    data: tyro.conf.Positional[Path], options: LogOptions = DEFAULT, rows: Path | None = None
) -> None:
    """Check flight logs and say what became of them.

    Args:
        data: a log (.csv, .parquet) or a folder of them.
        options: how logs become rows.
        rows: write the rows to this file (.npz), which `swarm-envs fit` reads too.
    """
    table, report = read_data(data, options, progress=True)
    print("\n".join(report.lines()))
    if rows is not None:
        save_rows(rows, table)


def check_logs() -> int:
    """Run the command line and return its exit code."""
    try:
        tyro.cli(_look, config=(tyro.conf.OmitArgPrefixes,))
    except (OSError, ImportError, ValueError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(check_logs())
