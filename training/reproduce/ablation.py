"""Table III of Neural-Swarm2: the validation error by H, L, velocities and spectral clip.

Every run is a fit of its own in a folder of its own, and is kept: a table that was interrupted
resumes, in the middle of a fit too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.errors import check_name
from swarm_envs.files import write_json
from swarm_envs.training.force_model.force_fit_config import (
    FitConfig,
    TrainConfig,
    with_mode_defaults,
)
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, about
from swarm_envs.training.reproduce.study import Cells, Report, Study
from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OURS_COLOR, _PAPER_COLOR, _PAIRS_COLOR = "#0072B2", "#B8BEC5", "#D55E00"
"""Colours of our values, of the paper's, and of sums over pairs."""
_PASSES = 80.0
# How the table's networks are trained: each by itself on the labels, as the paper's are.
_RECIPE: Mapping[str, Any] = {
    "optimiser": "adam",
    "teachers": 0,
    "schedule": "constant",
    "average_share": 0.2,
}
_TRAINING = tuple(entry.name for entry in fields(TrainConfig) if entry.name != "seed")


@dataclass(frozen=True)
class _AblationCell:
    """A cell: what differs from H = 20, L = 4, velocities seen, weights clipped."""

    name: str  # also its folder's name
    paper_mean: float | None = None  # validation MSE in the paper, g^2; None where it gives none
    paper_deviation: float | None = None  # the paper's standard deviation; None if it gives none
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Options of a fit by name that are set otherwise."""


_BASE = "H=20,L=4"
ABLATIONS = {
    cell.name: cell
    for cell in (
        _AblationCell(_BASE, 6.42, 0.18),
        _AblationCell("H=10", 6.70, 0.05, {"hidden": 10}),
        _AblationCell("H=40", 6.63, 0.35, {"hidden": 40}),
        _AblationCell("L=3", 6.52, 0.17, {"layers": 3}),
        _AblationCell("L=5", 7.21, 0.28, {"layers": 5}),
        _AblationCell("no-relative-velocity", 7.60, None, {"relative_velocity": False}),
        _AblationCell("no-spectral-norm", changes={"spectral": "none"}),
        _AblationCell("exact-spectral-norm", changes={"spectral": "exact"}),
        _AblationCell("pairwise", changes={"model": "pairwise"}),
    )
}
"""Table III; from Sec. VII-C the networks that do not see velocities; and what the paper gives no
number for: no spectral normalisation, or eq. (12) to the letter, and a sum over pairs."""


def _jobs(options: Any) -> list[tuple[str, int]]:
    """Every cell that is wanted with each seed."""
    seeds = range(options.seed, options.seed + options.seeds)
    return [(cell, seed) for seed in seeds for cell in _cells(options)]


def _cells(options: Any) -> list[str]:
    return [name for name in ABLATIONS if name in options.cells]


def ablation_fit(options: Any, cell: str, seed: int) -> FitConfig:
    """Configuration of a run, in a folder of its own: the paper's form, on plain labels."""
    plain = FitConfig(
        data=options.data,
        out=options.out / "runs" / cell / f"seed_{seed}",
        mode="measured",
        lipschitz_samples=0,
        seed=seed,
    )
    length = {"epochs": _PASSES} if options.steps is None else {"steps": options.steps}
    return with_mode_defaults(
        replace(plain, **{**_RECIPE, **length, **ABLATIONS[cell].changes}), "measured"
    )


def _grid(options: Any) -> Cells:
    """What fits each run, or reads it if it has ended; the table is rewritten after each."""
    from swarm_envs.training.flight_logs.fit_data import data_sha256
    from swarm_envs.training.force_model import pipeline

    if not options.data.exists():
        raise FileNotFoundError(
            f"no file of rows at {str(options.data)!r}; give its path by --data"
        )
    digest = data_sha256(options.data)
    configs = {job: ablation_fit(options, *job) for job in _jobs(options)}
    paths = {job: config.out / pipeline.REPORTS[config.model] for job, config in configs.items()}
    for job, config in configs.items():
        pipeline.check_finished(paths[job], config, digest)
    reports = {job: _read(path) for job, path in paths.items() if path.is_file()}

    def run(job: tuple[str, int]) -> Mapping[str, Any]:
        if job not in reports:
            pipeline.fit(configs[job])
            reports[job] = _read(paths[job])
            write_json(options.out / "table_3.json", _ablation_table(options, reports))
        return reports[job]

    return {f"{cell}, seed {seed}": partial(run, (cell, seed)) for cell, seed in configs}


def _read(path: Path) -> Mapping[str, Any]:
    report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return report


def _ablation_table(
    options: Any, reports: Mapping[tuple[str, int], Mapping[str, Any]]
) -> dict[str, Any]:
    """The table of the runs that there are, ready for JSON."""
    first = next(iter(reports.values()), None)
    errors_of_first = first["findings"]["errors"] if first else {}
    seeds, cells = range(options.seed, options.seed + options.seeds), _cells(options)
    rows = [_row(ABLATIONS[cell], seeds, reports) for cell in cells]
    return {
        "what": "validation mean squared error of f_a,z, g^2; deviations are of single runs",
        "runs_wanted": len(cells) * len(seeds),
        "runs_done": sum(len(row["seeds"]) for row in rows),
        "rows": rows,
        "zero_g2": errors_of_first.get("zero"),
        "scenario_mean_g2": errors_of_first.get("scenario_mean"),
        "training": {name: first["config"][name] for name in _TRAINING} if first else {},
        "data_sha256": first["data_sha256"] if first else None,
    }


def _row(
    cell: _AblationCell, seeds: Sequence[int], reports: Mapping[tuple[str, int], Mapping[str, Any]]
) -> dict[str, Any]:
    own = {s: reports[cell.name, s]["findings"]["errors"] for s in seeds
           if (cell.name, s) in reports}  # fmt: skip
    errors = [error["overall"] for error in own.values()]
    names = next(iter(own.values()))["scenario"] if own else {}
    scenarios: dict[str, Any] = {
        n: _mean([error["scenario"][n] for error in own.values()]) for n in names
    }
    # The mean over the scenarios of three drones, each counted once.
    three = [error for name, error in scenarios.items() if is_three_drones(name)]
    return {
        "cell": cell.name,
        "paper_g2": cell.paper_mean,
        "paper_deviation_g2": cell.paper_deviation,
        "ours_g2": _mean(errors),
        "ours_deviation_g2": round(float(np.std(errors, ddof=1)), 4) if len(errors) > 1 else None,
        "runs_g2": [round(float(error), 4) for error in errors],
        "seeds": list(own),
        "three_drones_g2": _mean(three),
        "scenarios_g2": scenarios,
    }


def _mean(values: Sequence[float]) -> float | None:
    return round(float(np.mean(values)), 4) if values else None


def is_three_drones(scenario: str) -> bool:
    """Whether a scenario such as `SL2S` has two neighbours."""
    above = scenario.partition("2")[0]
    return above != "Ge" and len(above) == 2


def _report(options: Any, cells: Mapping[str, Any]) -> Report:
    """The table with the paper's values as JSON, CSV, text and bars."""
    table = _ablation_table(options, dict(zip(_jobs(options), cells.values(), strict=True)))
    columns = (
        "cell", "paper_g2", "paper_deviation_g2", "ours_g2", "ours_deviation_g2", "three_drones_g2"
    )  # fmt: skip
    names = sorted({name for row in table["rows"] for name in row["scenarios_g2"]})
    rows = [
        {name: row[name] for name in columns}
        | {"runs": len(row["seeds"])}
        | {f"{name}_g2": row["scenarios_g2"].get(name) for name in names}
        for row in table["rows"]
    ]
    lines = [("validation MSE (g^2)", "paper", "result", "three drones", "runs")]
    for row in table["rows"]:
        spreads = [(row[f"{who}_g2"], row[f"{who}_deviation_g2"]) for who in ("paper", "ours")]
        said = map(_spread, (*spreads, (row["three_drones_g2"], None)))
        lines.append((row["cell"], *said, str(len(row["seeds"]))))
    draw = partial(_plot, table=table)
    return Report(table, "\n".join(format_columns(lines)), rows, {"table_3.png": draw})


def _spread(of: tuple[float | None, float | None]) -> str:
    mean, deviation = of
    if mean is None:
        return "-"
    return f"{mean:.2f}" + ("" if deviation is None else f" ± {deviation:.2f}")


def _plot(path: Path, table: Mapping[str, Any]) -> None:
    rows = [row for row in table["rows"] if row["ours_g2"] is not None]
    named = {row["cell"]: row for row in rows}
    both = [named[name] for name in ("H=20,L=4", "pairwise") if name in named]
    parts = 1 + (len(both) == 2)
    height = 1.4 + max(0.52 * len(rows), 0.34 * len(both[0]["scenarios_g2"]) if parts > 1 else 0.0)
    with picture(path, 6.6 * parts, height, "Validation error of f_a,z: ablations") as figure:
        axes = figure.subplots(1, parts, squeeze=False)[0]
        _plot_cells(axes[0], rows)
        if parts > 1:
            _plot_scenarios(axes[1], both)


def _plot_cells(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    place = np.arange(len(rows))
    drawn = (
        (-0.19, "ours", _OURS_COLOR, "swarm-envs"),
        (0.19, "paper", _PAPER_COLOR, "Neural-Swarm2"),
    )
    for offset, kind, color, label in drawn:
        values = [row[f"{kind}_g2"] for row in rows]
        spread = [row[f"{kind}_deviation_g2"] or np.nan for row in rows]
        shown = [k for k, value in enumerate(values) if value is not None]
        width = [values[k] for k in shown]
        axis.barh(
            place[shown] + offset, width, 0.36, xerr=[spread[k] for k in shown], color=color,
            label=label, error_kw={"ecolor": INK, "elinewidth": 1.0, "capsize": 2.0},
        )  # fmt: skip
        for k, value in zip(shown, width, strict=True):
            end = value + np.nan_to_num(spread[k])
            axis.annotate(f"{value:.2f}", (end, place[k] + offset), xytext=(4, 0), fontsize=8,
                          textcoords="offset points", va="center", color=INK)  # fmt: skip
    axis.set_yticks(place, [row["cell"] for row in rows])
    axis.invert_yaxis()
    axis.set_xlabel("Mean squared error (g²); whiskers: one standard deviation of single runs")
    axis.margins(x=0.12)
    _legend(axis)
    axis.set_title("Cells of Table III, and others")
    axis.grid(True, axis="x")


def _plot_scenarios(axis: Axes, both: Sequence[Mapping[str, Any]]) -> None:
    names = sorted(both[0]["scenarios_g2"], key=_order)
    place = np.arange(len(names))
    for offset, row, color, label in zip(
        (-0.19, 0.19),
        both,
        (_OURS_COLOR, _PAIRS_COLOR),
        ("deep set", "sum over pairs"),
        strict=True,
    ):
        values = [row["scenarios_g2"][name] for name in names]
        axis.barh(place + offset, values, 0.36, color=color, label=label)
    axis.set_yticks(place, names)
    axis.invert_yaxis()
    three = [k for k, name in enumerate(names) if is_three_drones(name)]
    if three:
        axis.axhspan(three[0] - 0.5, three[-1] + 0.5, color="#F4F1E6", zorder=0)
        axis.text(0.99, three[-1] + 0.4, "three drones", ha="right", va="bottom", color=GREY,
                  transform=axis.get_yaxis_transform())  # fmt: skip
    axis.set_xlabel("Mean squared error (g²)")
    _legend(axis)
    axis.set_title("By scenario")
    axis.grid(True, axis="x")


def _legend(axis: Axes) -> None:
    """Next to the title, where no bar can be."""
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=9, borderpad=0.0)


def _order(scenario: str) -> tuple[bool, bool, str]:
    """Lone drones first, then pairs, then three."""
    return is_three_drones(scenario), not scenario.startswith("Ge"), scenario


def _check(options: Any) -> None:
    if options.data is None:
        raise ValueError("--table 3 fits models: give the rows to fit by --data PATH")
    for cell in options.cells:
        check_name("cell", cell, ABLATIONS)


def ablation_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """The error of each cell, and its ratio to that of H = 20, L = 4.

    Levels depend on the rows and how they are split; ratios say what width, depth and velocities
    are worth.
    """
    rows = {row["cell"]: row for row in numbers["rows"] if row["paper_g2"] is not None}
    base = rows[_BASE]
    found = [_level(name, row, extent) for name, row in rows.items()]
    for name, row in rows.items():
        if name != _BASE:
            paper, ours = (row[who] / base[who] for who in ("paper_g2", "ours_g2"))
            what, why = f"{name}: error over that of {_BASE}", _reasons(name, extent)
            found.append(Claim(what, f"{paper:.3f}", ours, about(paper, 0.06), why))
    return found


def _level(name: str, row: Mapping[str, Any], extent: Extent) -> Claim:
    error, deviation = row["ours_g2"], row["ours_deviation_g2"]
    other = Reason(
        "other rows: collected in simulation, with its forces, sensors and calibration",
        Between(0.1, 40.0),
    )
    splits = Reason(
        "the splits differ: 20 s pieces of a scenario there, 5 s blocks here", Between(5, 9)
    )
    return Claim(
        f"{name}: validation error, g²",
        _spread((row["paper_g2"], row["paper_deviation_g2"])),
        error,
        about(row["paper_g2"], 0.05),
        (other, splits) if extent.collected else (splits,),
        spread=(error - deviation, error + deviation) if deviation else None,
        spread_is="standard deviation",
    )


def _reasons(name: str, extent: Extent) -> tuple[Reason, ...]:
    short = Reason("--quick fits 400 steps of one seed: far from the end", Between(0.7, 1.6))
    flat = Reason(
        "with this recipe width and depth matter less; the paper's L = 5 overfits",
        Between(0.9, 1.15),
    )
    air = Reason("how much the simulated force depends on velocity is its own", Between(0.95, 3.0))
    bare = Reason(
        "simulated rows leave little but the network's own error, a tenth of the paper's, so what "
        "a smaller one cannot form weighs more; on measured rows they differ by 2 % at most",
        Between(0.95, 2.0),
    )
    known: tuple[Reason, ...]
    if name == "no-relative-velocity":
        known = (air,) if extent.collected else ()
    else:
        known = (flat, bare) if extent.collected else (flat,)
    return (short, *known) if extent.quick else known


TABLE_3 = Study(
    paper="neural-swarm2",
    name="table-3",
    label="Table III",
    shows="validation error by width H and depth L of the networks, and without velocities",
    takes=("data", "seeds", "cells", "steps"),
    check=_check,
    needs_torch=True,
    grid=_grid,
    report=_report,
    claims=ablation_claims,
    collects=(20, 3),
    full={"steps": 6000},
    quick={
        "steps": 400,
        "seeds": 1,
        "cells": tuple(cell.name for cell in ABLATIONS.values() if cell.paper_mean is not None),
    },
    note="Fitted to the rows given by --data, or to flights collected in simulation where none "
    "are given: the authors' flights are not part of the package.",
)
"""Every cell with every seed, each a fit that is kept."""
