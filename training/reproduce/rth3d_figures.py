"""The figures of RTH3D, reproduced with this package's planners, and what they should show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

from swarm_envs.arguments import Count, typed
from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.baselines.rth3d import METHODS
from swarm_envs.errors import check_name
from swarm_envs.training.reproduce import rth3d_runs
from swarm_envs.training.reproduce.rth3d_claims import (
    building_claims,
    density_claims,
    flat_claims,
    pattern_claims,
    slab_claims,
)
from swarm_envs.training.reproduce.rth3d_letters import letter_claims, letter_report
from swarm_envs.training.reproduce.rth3d_plots import plot_curve_figure
from swarm_envs.training.reproduce.rth3d_runs import (
    FIGURES,
    CurveFigure,
    CurvePoint,
    Curves,
    GridSetting,
    Spread,
    gather_runs,
    growth,
    runs_at,
)
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, StudyOptions, drawing

_PAPER = "rth3d"  # as `swarm-envs reproduce` names the paper


@partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class Rth3dOptions(StudyOptions):
    """Remake a figure of the RTH3D paper: time and makespan over the size of the grid.

    `--figure 5`: 4:2:1 grids; `--figure 6`: square grids six vertices high; `--figure 7`: between
    tall buildings; `--figure 8`: by density; `--figure 9`: rings and blocks; `--figure 11`: ten
    drones write letters, flown. The largest grids take minutes; `--largest` leaves them out. What
    is interrupted resumes when run again.
    """

    paper: ClassVar[str] = _PAPER

    figure: Literal["5", "6", "7", "8", "9", "11"]
    """number of the figure"""
    methods: tuple[str, ...] = ("rth3d", "rth3d-lba", "rth3d-lba-paper", "auto")
    """rth3d, rth3d-lba, rth3d-lba-paper, auto, pibt"""
    runs: Count = 20
    """of each method on each grid where grids are small"""
    budget: Count = 250_000
    """vertices of all runs of a method on a grid together: on larger grids there are fewer runs"""
    largest: int = 500_000
    """vertices of the largest grid"""

    @property
    def curves(self) -> CurveFigure:
        """The figure, without grids larger than wanted."""
        figure = FIGURES[self.figure]
        kept = {
            name: tuple(setting for setting in curve if setting.vertices <= self.largest)
            for name, curve in figure.series.items()
        }
        return replace(figure, series={name: curve for name, curve in kept.items() if curve})

    def seeds(self, setting: GridSetting) -> range:
        """Of a setting's runs."""
        return range(self.seed, self.seed + runs_at(setting, self.runs, self.budget))


OPTIONS = Rth3dOptions  # What `swarm-envs reproduce rth3d` takes


def _check_curves(options: Rth3dOptions) -> None:
    for method in options.methods:
        check_name("method", method, METHODS)
    if not options.methods or len(set(options.methods)) < len(options.methods):
        raise ValueError(f"--methods is {' '.join(options.methods)!r}; give each method once")
    if not options.curves.series:
        smallest = min(_settings_of(FIGURES[options.figure]), key=lambda s: s.vertices)
        raise ValueError(
            f"--largest is {options.largest} vertices, below every grid of figure "
            f"{options.figure}; the smallest has {smallest.vertices}"
        )


def _settings_of(figure: CurveFigure) -> list[GridSetting]:
    """Every setting once, small ones first."""
    settings = {setting for curve in figure.series.values() for setting in curve}
    return sorted(settings, key=lambda setting: (setting.vertices, setting.name))


def _run_name(setting: GridSetting, method: str, seed: int) -> str:
    return f"{setting.name}, {method}, seed {seed}"


def _grid(options: Rth3dOptions) -> Cells:
    return {
        _run_name(setting, method, seed): partial(rth3d_runs.measure_run, setting, method, seed)
        for setting in _settings_of(options.curves)
        for seed in options.seeds(setting)
        for method in options.methods
    }


def _curves(options: Rth3dOptions, cells: Mapping[str, Cell]) -> Curves:
    def point(setting: GridSetting, method: str) -> CurvePoint:
        runs = [cells[_run_name(setting, method, seed)] for seed in options.seeds(setting)]
        return gather_runs(setting, method, runs)

    return {
        (name, method): [point(setting, method) for setting in settings]
        for name, settings in options.curves.series.items()
        for method in options.methods
    }


def _report(options: Rth3dOptions, cells: Mapping[str, Cell]) -> Report:
    figure, curves, name = options.curves, _curves(options, cells), options.chosen.file
    rows = _rows(curves)
    laws = {f"{name}, {method}": growth(row) for (name, method), row in curves.items()}
    summary = {
        "points": rows,
        "growth": {name: law._asdict() for name, law in laws.items() if law is not None},
        "peers": [peer._asdict() for peer in figure.peers],
    }
    draw = partial(plot_curve_figure, figure=figure, curves=curves)
    return Report(summary, _text(curves), rows, {f"{name}.png": draw})


def _rows(curves: Curves) -> list[dict[str, Any]]:
    """One row for each point of each curve."""
    return [
        {
            "series": name,
            "grid": point.setting.grid,
            "vertices": point.setting.vertices,
            "robots": point.robots,
            "method": method,
            "runs": point.runs,
            "solved": point.solved,
            **_columns("cpu_s", point.cpu_s),
            **_columns("ratio", point.ratio),
            **_columns("ratio_before_compaction", point.before),
            "most_over_m1_2m2_2m3": point.constant,
            "plans_by": "; ".join(f"{who} {count}" for who, count in point.winners.items()),
        }
        for (name, method), row in curves.items()
        for point in row
    ]


def _columns(name: str, spread: Spread | None) -> dict[str, float | None]:
    columns = (name, f"{name}_least", f"{name}_most")
    if spread is None:
        return dict.fromkeys(columns)
    values = (float(f"{x:.4g}") for x in (spread.mean, spread.least, spread.most))
    return dict(zip(columns, values, strict=True))


def _mean(spread: Spread | None) -> str:
    return "" if spread is None else f"{spread.mean:.3f}"


def _text(curves: Curves) -> str:
    """The largest setting of each curve."""
    rows = [("", "grid", "robots", "method", "runs", "CPU s", "ratio")]
    for (name, method), row in curves.items():
        point = row[-1]
        numbers = (f"{point.cpu_s.mean:.3g}", _mean(point.ratio) or "-")
        where = (name, point.setting.grid, f"{point.robots:,}")
        rows.append((*where, method, str(point.runs), *numbers))
    return "\n".join(format_columns(rows))


def _planned(number: str, shows: str, largest: int, claims: Any) -> Study:
    """A figure of curves; the quick one ends at grids of so many vertices."""
    return Study(
        paper=_PAPER,
        name=f"figure-{number}",
        label=f"Fig. {number}",
        shows=shows,
        check=_check_curves,
        grid=_grid,
        settings=lambda options: {"figure": options.figure},
        cells_file=f"figure_{number}.json",
        report=_report,
        claims=claims,
        numbers="points.json",
        pictures=(f"figure_{number}.png",),
        quick={"runs": 3, "budget": 80_000, "largest": largest},
    )


_ILLUSTRATION = "an illustration of the method; nothing is measured"
STUDIES = (
    drawing(
        _PAPER,
        1,
        "a light show; a swarm between tall buildings in Unity",
        "a photograph, and a picture of another simulator; such buildings are planned in Fig. 7",
    ),
    drawing(_PAPER, 2, "a Rubik table of 27 items sorted by shuffles", _ILLUSTRATION),
    drawing(_PAPER, 3, "a random configuration on 6 x 6 x 3, balanced", _ILLUSTRATION),
    drawing(_PAPER, 4, "one plane sorted by shuffles along its lanes", _ILLUSTRATION),
    _planned(
        "5",
        "time and ratio of makespan to lower bound on 4:2:1 grids, a third taken",
        70_000,
        slab_claims,
    ),
    _planned("6", "the same on square grids six vertices high", 60_000, flat_claims),
    _planned("7", "the same between tall buildings", 50_000, building_claims),
    _planned("8", "the same on 120 x 60 x 6 by the number of robots", 50_000, density_claims),
    _planned("9", "rings and blocks, and their ratios", 50_000, pattern_claims),
    drawing(
        _PAPER,
        10,
        "not known",
        "the text that we have of the paper holds neither this picture, nor its caption, nor a "
        "reference to it",
    ),
    Study(
        paper=_PAPER,
        name="figure-11",
        label="Fig. 11",
        shows="ten Crazyflies write A-R-C-R-U on 6 x 6 x 6 grids",
        report=letter_report,
        claims=letter_claims,
        numbers="points.json",
        pictures=("figure_11.png",),
        note="Flown in simulation, in learned downwash; theirs is a photograph of real drones.",
    ),
)
"""Every numbered figure of the paper; it has no table."""
