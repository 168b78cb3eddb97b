"""Table III: how the validation error depends on H, L, relative velocity and the spectral clip.

Every run is a fit of its own in a folder of its own, and is kept: a table that was interrupted
goes on where it was, in the middle of a fit too.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.files import write_json, written_whole
from swarm_envs.training.force_model.fit_data import data_sha256
from swarm_envs.training.force_model.force_fit_config import (
    FitConfig,
    TrainConfig,
    with_mode_defaults,
)
from swarm_envs.training.force_model.pipeline import REPORTS, fit
from swarm_envs.training.provenance import json_ready
from swarm_envs.training.reproduce.cells import CELLS, Cell
from swarm_envs.training.reproduce.table_plot import is_three_drones, plot_table

_RECIPE: Mapping[str, Any] = {
    "optimiser": "adam",
    "teachers": 0,
    "schedule": "constant",
    "average_share": 0.2,
}
"""How the table's networks are trained: each by itself on the labels, as the paper's are."""
_PASSES = 80.0
_BEFORE: Mapping[str, Any] = {
    "optimiser": "adam",
    "teachers": 0,
    "teacher_epochs": 16.0,
    "label_share": 0.0,
}
"""What reports that do not know these options stand for."""
_TRAINING = tuple(entry.name for entry in fields(TrainConfig) if entry.name != "seed")


class Budget(NamedTuple):
    """What every fit of the table shares."""

    data: Path
    """Rows of measured force: a file, or a folder of files."""
    steps: int | None = None
    """Optimiser steps; this and the others are the trainer's default where None."""
    batch_size: int | None = None
    """Rows of a step; None for the recipe's."""
    learning_rate: float | None = None
    """Rate of the optimiser; None for the recipe's."""


def fit_config(cell: Cell, seed: int, budget: Budget, folder: Path) -> FitConfig:
    """Configuration of one run: the paper's form on the labels as they are.

    Args:
        cell: what is varied.
        seed: of the run.
        budget: what is not.
        folder: where the weights and the report go.
    """
    plain = FitConfig(
        data=budget.data,
        out=folder,
        mode="measured",
        lipschitz_samples=0,
        seed=seed,
    )
    length = {name: value for name, value in budget._asdict().items() if name != "data"}
    shared = {name: value for name, value in length.items() if value is not None}
    if budget.steps is None:
        shared["epochs"] = _PASSES
    return with_mode_defaults(replace(plain, **{**_RECIPE, **shared, **cell.changes}), "measured")


def run_folder(out: Path, cell: Cell, seed: int) -> Path:
    """Folder of one run."""
    return out / "runs" / cell.name / f"seed_{seed}"


def run_ablation(
    out: Path,
    budget: Budget,
    seeds: Sequence[int],
    cells: Sequence[Cell] = CELLS,
    progress: bool = True,
) -> dict[str, Any]:
    """Fit every cell with every seed, and write the table.

    Runs that are there already are read, not repeated. After every run the table is written anew
    with what there is: `table_3.json`, `table_3.csv`; at the end `table_3.png` is drawn.

    Args:
        out: folder of the table; runs go into `runs/<cell>/seed_<seed>`.
        budget: data and length of the fits.
        seeds: one run each.
        cells: which rows of the table.
        progress: show progress bars.

    Returns:
        The table, ready for JSON.

    Raises:
        FileNotFoundError: there is no data.
        ValueError: a run in the folder was made with other data or settings.
    """
    if not budget.data.exists():
        raise FileNotFoundError(f"no file of rows at {str(budget.data)!r}; give its path by --data")
    digest = data_sha256(budget.data)
    jobs = [(cell, seed) for seed in seeds for cell in cells]
    reports: dict[tuple[str, int], Mapping[str, Any]] = {}
    for cell, seed in jobs:
        found = _finished(fit_config(cell, seed, budget, run_folder(out, cell, seed)), digest)
        if found is not None:
            reports[cell.name, seed] = found
    bar = tqdm(jobs, disable=not progress, unit="fit", desc="Table III", position=0)
    for cell, seed in bar:
        bar.set_postfix_str(f"{cell.name}, seed {seed}")
        if (cell.name, seed) not in reports:
            config = fit_config(cell, seed, budget, run_folder(out, cell, seed))
            fit(replace(config, progress=progress))
            reports[cell.name, seed] = _read(config)
            _write(out, _table(cells, seeds, reports, digest))
    table = _table(cells, seeds, reports, digest)
    _write(out, table)
    plot_table(out / "table_3.png", table)
    return table


def _read(config: FitConfig) -> Mapping[str, Any]:
    path = config.out / REPORTS[config.model]
    report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return report


def _finished(config: FitConfig, digest: str) -> Mapping[str, Any] | None:
    """The report of a run if it has ended."""
    if not (config.out / REPORTS[config.model]).is_file():
        return None
    report = _read(config)
    wanted = json.loads(json.dumps(json_ready(replace(config, progress=True))))
    made = {**_BEFORE, **report["config"], "progress": True}
    differing = sorted(k for k in wanted.keys() | made.keys() if wanted.get(k) != made.get(k))
    if report["data_sha256"] != digest:
        differing.append("the data")
    if differing:
        raise ValueError(
            f"the run in {str(config.out)!r} was made with other {', '.join(differing)}; choose "
            "another folder by --out, or delete it"
        )
    return report


def _table(
    cells: Sequence[Cell],
    seeds: Sequence[int],
    reports: Mapping[tuple[str, int], Mapping[str, Any]],
    digest: str,
) -> dict[str, Any]:
    rows: list[dict[str, Any]] = []
    for cell in cells:
        own = [reports[cell.name, s] for s in seeds if (cell.name, s) in reports]
        errors = [report["findings"]["errors"]["overall"] for report in own]
        rows.append(
            {
                "cell": cell.name,
                "paper_g2": cell.paper_mean,
                "paper_deviation_g2": cell.paper_deviation,
                "ours_g2": _rounded(np.mean(errors)) if errors else None,
                "ours_deviation_g2": _rounded(np.std(errors, ddof=1)) if len(errors) > 1 else None,
                "runs_g2": [_rounded(error) for error in errors],
                "seeds": [s for s in seeds if (cell.name, s) in reports],
                "three_drones_g2": _three_drones(own),
                "scenarios_g2": _by_scenario(own),
            }
        )
    first = next(iter(reports.values()), None)
    errors_of_first = first["findings"]["errors"] if first else {}
    return {
        "what": "validation mean squared error of f_a,z, g^2; deviations are of single runs",
        "runs_wanted": len(cells) * len(seeds),
        "runs_done": sum(len(row["seeds"]) for row in rows),
        "rows": rows,
        "zero_g2": errors_of_first.get("zero"),
        "scenario_mean_g2": errors_of_first.get("scenario_mean"),
        "training": {name: first["config"][name] for name in _TRAINING} if first else {},
        "data_sha256": digest,
    }


def _rounded(value: float | np.floating[Any]) -> float:
    return round(float(value), 4)


def _by_scenario(reports: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    errors = [report["findings"]["errors"]["scenario"] for report in reports]
    names = errors[0] if errors else {}
    return {name: _rounded(np.mean([e[name] for e in errors])) for name in names}


def _three_drones(reports: Sequence[Mapping[str, Any]]) -> float | None:
    """Mean over the scenarios of three drones, each counted once."""
    errors = [e for name, e in _by_scenario(reports).items() if is_three_drones(name)]
    return _rounded(np.mean(errors)) if errors else None


def _write(out: Path, table: Mapping[str, Any]) -> None:
    write_json(out / "table_3.json", table)
    columns = (
        "cell", "paper_g2", "paper_deviation_g2", "ours_g2", "ours_deviation_g2", "three_drones_g2"
    )  # fmt: skip
    names = sorted({name for row in table["rows"] for name in row["scenarios_g2"]})
    with (
        written_whole(out / "table_3.csv") as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow((*columns, "runs", *(f"{name}_g2" for name in names)))
        for row in table["rows"]:
            scenarios = [row["scenarios_g2"].get(name) for name in names]
            writer.writerow([*(row[name] for name in columns), len(row["seeds"]), *scenarios])


def format_table(table: Mapping[str, Any]) -> str:
    """The table as text: paper's value beside ours."""
    lines = [f"{'validation MSE (g^2)':22}{'paper':>14}{'ours':>14}{'three drones':>14}  runs"]
    for row in table["rows"]:
        paper = _spread(row["paper_g2"], row["paper_deviation_g2"])
        ours = _spread(row["ours_g2"], row["ours_deviation_g2"])
        three = _spread(row["three_drones_g2"], None)
        lines.append(f"{row['cell']:22}{paper:>14}{ours:>14}{three:>14}{len(row['seeds']):6}")
    return "\n".join(lines)


def _spread(mean: float | None, deviation: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.2f}" + ("" if deviation is None else f" ± {deviation:.2f}")
