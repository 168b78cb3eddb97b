"""The figures of RTH3D, reproduced with this package's planners, and what they should show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

from swarm_envs.arguments import Count, typed
from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.baselines.rth3d import METHODS
from swarm_envs.errors import check_name
from swarm_envs.training.reproduce import rth3d_runs
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason
from swarm_envs.training.reproduce.rth3d_letters import letter_claims, letter_report
from swarm_envs.training.reproduce.rth3d_plots import plot_curve_figure
from swarm_envs.training.reproduce.rth3d_runs import (
    FIGURES,
    GUARANTEED,
    PUBLISHED,
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


def _points(numbers: Any, series: str, method: str) -> list[dict[str, Any]]:
    """The points of one curve, from the smallest grid to the largest."""
    own = [p for p in numbers["points"] if (p["series"], p["method"]) == (series, method)]
    if not own:
        raise ValueError(f"there is no curve of {method!r} on {series!r}")
    return own


def _ratio_claim(
    point: Mapping[str, Any],
    paper: str = "-",
    agrees: Between | None = None,
    reasons: tuple[Reason, ...] = (),
    column: str = "ratio_before_compaction",
) -> Claim:
    several, before = point["runs"] > 1, " before compaction" if column != "ratio" else ""
    return Claim(
        f"{point['series']} {point['grid'].replace('x', ' x ')}, `{point['method']}`: "
        f"ratio{before}",
        paper,
        point[column],
        agrees,
        reasons,
        spread=(point[f"{column}_least"], point[f"{column}_most"]) if several else None,
        spread_is="least and largest",
    )


def _auto_claim(numbers: Any, series: str) -> Claim:
    """Our best method, which the paper does not have."""
    return _ratio_claim(_points(numbers, series, "auto")[-1], column="ratio")


def _falls_claim(numbers: Any, series: str, method: str) -> Claim:
    curve, column = _points(numbers, series, method), "ratio_before_compaction"
    return Claim(
        f"{series}, `{method}`: ratio on the largest grid over the smallest",
        "decreases with size",
        curve[-1][column] / curve[0][column],
        Between(0.0, 1.0),
    )


def _small_grids(extent: Extent, above: float) -> tuple[Reason, ...]:
    """Why ratios may lie above a value that only small grids have."""
    said = "ratios fall as grids grow, and --quick leaves the large ones out"
    return (Reason(said, Between(above, 2.3)),) if extent.quick else ()


def slab_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 5: about 1.7 and 1.5 at the largest size, falling."""
    shorter = Reason(
        "balancing takes the fewest steps possible here, instead of the least distance",
        Between(1.0, 1.7),
    )
    fewer = Reason("--quick leaves the large grids out", Between(1.0))
    return [
        *(
            _ratio_claim(
                _points(numbers, "uniform", method)[-1],
                f"about {value:g}",
                Between(value - 0.1, value + 0.05),
                (*_small_grids(extent, value), shorter),
            )
            for method, value in zip(PUBLISHED, (1.7, 1.5), strict=True)
        ),
        _ratio_claim(_points(numbers, "uniform", "rth3d-lba")[-1]),
        *(_falls_claim(numbers, "uniform", method) for method in GUARANTEED),
        Claim(
            "robots on the largest grid",
            "over 120,000",
            _points(numbers, "uniform", "rth3d-lba-paper")[-1]["robots"],
            Between(120_000),
            (fewer,) if extent.quick else (),
        ),
        _auto_claim(numbers, "uniform"),
    ]


def flat_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 6: towards 1.5 on flat grids."""
    below = Reason(
        "shifts of bounded matchings are shorter than the sides, so that it passes below what the "
        "theory guarantees",
        Between(1.0, 1.5),
    )
    above = Reason(
        "it has not come down to its asymptote on the grids that we ran", Between(1.5, 2)
    )
    return [
        *(
            _ratio_claim(
                _points(numbers, "uniform", method)[-1],
                "asymptotically 1.5",
                Between(1.4, 1.6),
                (*_small_grids(extent, 1.5), below, above),
            )
            for method in PUBLISHED
        ),
        _ratio_claim(_points(numbers, "uniform", "rth3d-lba")[-1]),
        *(_falls_claim(numbers, "uniform", method) for method in GUARANTEED),
        _auto_claim(numbers, "uniform"),
    ]


def building_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 7: between buildings the paper shows curves alone."""
    return [
        *(_ratio_claim(_points(numbers, "buildings", method)[-1]) for method in GUARANTEED),
        *(_falls_claim(numbers, "buildings", method) for method in GUARANTEED),
        _auto_claim(numbers, "buildings"),
    ]


def density_claims(numbers: Any, extent: Extent) -> Iterator[Claim]:
    """Fig. 8: density has little impact on time, and ratios are better."""
    cheaper = Reason(
        "nothing is written of virtual robots and they are not compacted, so that few robots cost "
        "less than many",
        Between(2.0, 20.0),
    )
    for method in GUARANTEED:
        # The authors' sweep begins with 4,800 robots.
        curve = [p for p in _points(numbers, "uniform", method) if p["robots"] >= 4800]
        first, last, column = curve[0], curve[-1], "ratio_before_compaction"
        yield Claim(
            f"`{method}`: time for {last['robots']:,} robots over {first['robots']:,}",
            "little impact",
            last["cpu_s"] / first["cpu_s"],
            Between(0.5, 2.0),
            (cheaper,),
        )
        yield Claim(
            f"`{method}`: ratio for {last['robots']:,} robots over {first['robots']:,}, before "
            "compaction",
            "better with density",
            last[column] / first[column],
            Between(0.0, 1.0),
        )


def pattern_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Fig. 9: rings approach 1."""
    rings, method = "rings, 2m x 2m x m", "rth3d-lba-paper"
    early = Reason("ratios fall as grids grow, and --quick ends early", Between(1.0, 1.35))
    blocks = ("27 blocks, m x m x m", "3 x 3 x 3 blocks, 2m x 2m x m")
    last = _points(numbers, rings, method)[-1]
    known = (early,) if extent.quick else ()
    return [
        _ratio_claim(last, "approaches 1", Between(1.0, 1.15), known),
        _falls_claim(numbers, rings, method),
        *(_ratio_claim(_points(numbers, series, method)[-1]) for series in blocks),
        _auto_claim(numbers, blocks[0]),
    ]


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
        shows=shows,
        check=_check_curves,
        grid=_grid,
        settings=lambda options: {"figure": options.figure},
        cells_file=f"figure_{number}.json",
        report=_report,
        claims=claims,
        numbers="points.json",
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
        shows="ten Crazyflies write A-R-C-R-U on 6 x 6 x 6 grids",
        report=letter_report,
        claims=letter_claims,
        numbers="points.json",
        note="Flown in simulation, in learned downwash; theirs is a photograph of real drones.",
    ),
)
"""Every numbered figure of the paper; it has no table."""
