"""The figures of RTH3D, remade with this package's planners, and what they should show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal

from swarm_envs.arguments import Count, typed
from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.baselines.rth3d import METHODS
from swarm_envs.errors import check_name
from swarm_envs.files import written_whole
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
    FIT_FROM,
    GUARANTEED,
    CurveFigure,
    CurvePoint,
    Curves,
    GridSetting,
    RatioTarget,
    Spread,
    gather_runs,
    growth,
    runs_at,
)
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, StudyOptions, drawing

_PAPER = "rth3d"  # as `swarm-envs reproduce` names the paper
_SLACK = 30  # what the makespan before compaction may be above m1 + 2 m2 + 2 m3, at most


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
    methods: tuple[str, ...] = ("rth3d", "rth3d-lba", "auto")
    """rth3d, rth3d-lba, auto, pibt"""
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


OPTIONS = Rth3dOptions
"""What `swarm-envs reproduce rth3d` takes."""


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
    checks, rows = check_curves(figure, curves), _rows(curves)
    laws = {f"{name}, {method}": growth(row) for (name, method), row in curves.items()}
    summary = {
        "points": rows,
        "growth": {name: law._asdict() for name, law in laws.items() if law is not None},
        "peers": [peer._asdict() for peer in figure.peers],
        "claims": checks,
    }
    files = {
        f"{name}.png": partial(plot_curve_figure, figure=figure, curves=curves),
        f"{name}.md": partial(_write_page, text=_page(name, figure, curves, checks)),
    }
    return Report(summary, _text(curves, checks), rows, files)


def _write_page(path: Path, text: str) -> None:
    with written_whole(path) as partial_file:
        partial_file.write_text(text, encoding="utf-8")


def check_curves(figure: CurveFigure, curves: Curves) -> list[dict[str, Any]]:
    """What the curves of a figure should show, what was measured, and whether it holds.

    Args:
        figure: what was varied, with its targets.
        curves: of what was run; what was not is not checked.
    """
    checks = (*_targets(figure, curves), *_bounds(curves), *_falls(figure, curves))
    found = [*checks, *_orders(figure, curves)]
    return [{"text": text, "measured": said, "holds": holds} for text, said, holds in found]


_Check = tuple[str, str, bool]


def _targets(figure: CurveFigure, curves: Curves) -> Iterator[_Check]:
    for target in figure.targets:
        points = [
            point
            for point in curves.get((target.series, target.method), ())
            if point.setting in target.settings and point.ratio is not None
        ]
        if points:
            yield _reached(target, points)


def _reached(target: RatioTarget, points: Sequence[CurvePoint]) -> _Check:
    spreads = [point.ratio if target.compacted else point.before for point in points]
    worst = max(spread.mean for spread in spreads if spread is not None)
    first, last = points[0].setting, points[-1].setting
    where = first.grid if first.grid == last.grid else f"{first.grid} to {last.grid}"
    where += f", up to {points[-1].robots:,} robots" if first.robots else ""
    kind = "" if target.compacted else " before compaction"
    source = " (the paper's)" if target.of_paper else ""
    said = f"{target.series}, {where}: `{target.method}`{kind} at most {target.most:g}{source}"
    return said, f"{worst:.3f}", worst <= target.most


def _bounds(curves: Curves) -> Iterator[_Check]:
    for method in GUARANTEED:
        points = [p for (_, own), row in curves.items() if own == method for p in row]
        known = [(p.constant, p.setting.grid) for p in points if p.constant is not None]
        if known:
            constant, grid = max(known)
            said = f"`{method}` before compaction: at most m1 + 2 m2 + 2 m3 + {_SLACK}"
            yield said, f"{constant:+d} ({grid})", constant <= _SLACK


def _falls(figure: CurveFigure, curves: Curves) -> Iterator[_Check]:
    if figure.axis == "density":
        return
    for (name, method), row in curves.items():
        ratios = [p.ratio.mean for p in row if p.ratio is not None]
        if method not in GUARANTEED or len(ratios) < 2:
            continue
        rises = sum(later > earlier for earlier, later in pairwise(ratios))
        yield (
            f"{name}: ratio of `{method}` falls as the grid grows",
            f"{ratios[0]:.3f} to {ratios[-1]:.3f}, {rises} of {len(ratios) - 1} steps up",
            ratios[-1] < ratios[0],
        )


def _orders(figure: CurveFigure, curves: Curves) -> Iterator[_Check]:
    """Growth of RTH3D's time; the theory says nothing of PIBT's, and so nothing of `auto`'s."""
    if figure.order is None:
        return
    for (name, method), row in curves.items():
        law = growth(row) if method in GUARANTEED else None
        if law is not None:
            yield (
                f"{name}: time of `{method}` grows no faster than vertices^{figure.order:.2f}",
                f"{law.exponent:.2f} ± {law.error:.2f}",
                law.exponent <= figure.order,
            )


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


def _page(name: str, figure: CurveFigure, curves: Curves, checks: Sequence[Cell]) -> str:
    """A figure's numbers in Markdown."""
    legend = (
        "Means; ratio is makespan over the largest Manhattan distance; the last column is the "
        "largest excess of the makespan before compaction over m1 + 2 m2 + 2 m3."
    )
    lines = [f"# {figure.headline}", "", f"![{figure.headline}]({name}.png)", "", legend, ""]
    head = ("grid", "robots", "method", "runs", "CPU s", "ratio", "before compaction")
    for series in figure.series:
        own = [(method, row) for (of, method), row in curves.items() if of == series]
        body = [_line(method, point) for method, row in own for point in row]
        if body:
            lines += [f"## {series}", "", *_markdown((*head, "over the sum"), body), ""]
    lines += [*_laws(figure, curves), "## Checked", ""]
    said = [(c["text"], c["measured"], "yes" if c["holds"] else "**no**") for c in checks]
    return "\n".join([*lines, *_markdown(("", "measured", "holds"), said), ""])


def _markdown(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    rows = [f"| {' | '.join(line)} |" for line in (head, *lines)]
    return [rows[0], f"|{'---|' * len(head)}", *rows[1:]]


def _line(method: str, point: CurvePoint) -> tuple[str, ...]:
    return (
        point.setting.grid.replace("x", " x "),
        f"{point.robots:,}",
        f"`{method}`",
        str(point.runs) if point.solved == point.runs else f"{point.solved} of {point.runs}",
        f"{point.cpu_s.mean:.3g}",
        _mean(point.ratio),
        _mean(point.before),
        "" if point.constant is None else f"{point.constant:+d}",
    )


def _mean(spread: Spread | None) -> str:
    return "" if spread is None else f"{spread.mean:.3f}"


def _laws(figure: CurveFigure, curves: Curves) -> list[str]:
    lines = []
    for (name, method), row in curves.items():
        law = growth(row)
        if law is not None:
            known = figure.order is not None and method in GUARANTEED
            theory = f"{figure.order:.2f}" if known else ""
            fitted = f"{law.exponent:.2f} ± {law.error:.2f}"
            lines.append((name, f"`{method}`", fitted, theory, str(law.settings)))
    if not lines:
        return []
    head = ("", "method", "exponent", "theory", "sizes")
    text = (
        f"CPU time over vertices from {FIT_FROM} on, least squares of the logarithms of the means, "
        "with the standard error:"
    )
    return ["## Growth", "", text, "", *_markdown(head, lines), ""]


def _text(curves: Curves, checks: Sequence[Cell]) -> str:
    """The largest setting of each curve and the checks."""
    rows = [("", "grid", "robots", "method", "runs", "CPU s", "ratio")]
    for (name, method), row in curves.items():
        point = row[-1]
        numbers = (f"{point.cpu_s.mean:.3g}", _mean(point.ratio) or "-")
        where = (name, point.setting.grid, f"{point.robots:,}")
        rows.append((*where, method, str(point.runs), *numbers))
    lines = format_columns(rows)
    lines += [f"{'ok ' if c['holds'] else 'NO '} {c['text']}: {c['measured']}" for c in checks]
    return "\n".join(lines)


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
