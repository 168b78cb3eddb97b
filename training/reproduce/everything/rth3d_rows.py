"""What the commands of RTH3D measured, beside what the paper says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from swarm_envs.training.reproduce.everything.item import Preset
from swarm_envs.training.reproduce.everything.neural_swarm_rows import load
from swarm_envs.training.reproduce.everything.rows import Range, Reason, Row

Point = Mapping[str, Any]
"""A line of the figure's table."""
_METHODS = ("rth3d", "rth3d-lba")
_SMALLER = Reason("ratios fall as grids grow, and --quick leaves the large ones out", Range(1, 2.3))


def _curve(folder: Path, series: str, method: str) -> list[Point]:
    """The points of one curve, from the smallest grid to the largest."""
    points: Sequence[Point] = load(folder / "points.json")["points"]
    own = [p for p in points if p["series"] == series and p["method"] == method]
    if not own:
        raise ValueError(f"there is no curve of {method!r} on {series!r} in {str(folder)!r}")
    return own


def _where(point: Point) -> str:
    return f"{point['series']} {point['grid'].replace('x', ' x ')}"


def _ratio(
    point: Point,
    paper: str,
    agrees: Range | None,
    reasons: tuple[Reason, ...],
    column: str = "ratio_before_compaction",
) -> Row:
    return Row(
        quantity=f"{_where(point)}, `{point['method']}`: ratio"
        + (" before compaction" if column != "ratio" else ""),
        paper=paper,
        ours=point[column],
        spread=(point[f"{column}_least"], point[f"{column}_most"]) if point["runs"] > 1 else None,
        spread_is="least and largest" if point["runs"] > 1 else "",
        agrees=agrees,
        reasons=reasons,
    )


def _quick(preset: Preset, *reasons: Reason) -> tuple[Reason, ...]:
    """Reasons that hold for small grids alone, and others."""
    return (*((_SMALLER,) if preset == "quick" else ()), *reasons)


def _falling(folder: Path, series: str, method: str) -> Row:
    """The ratio on the largest grid over that on the smallest: below one."""
    curve = _curve(folder, series, method)
    first, last = curve[0], curve[-1]
    return Row(
        quantity=f"{series}, `{method}`: ratio on the largest grid over the smallest",
        paper="decreases with size",
        ours=last["ratio_before_compaction"] / first["ratio_before_compaction"],
        agrees=Range(0.0, 1.0),
    )


def _auto(folder: Path, series: str) -> Row:
    """Our best method, which the paper does not have."""
    return _ratio(_curve(folder, series, "auto")[-1], "-", None, (), "ratio")


def _most_robots(folder: Path, least: float, preset: Preset) -> Row:
    point = _curve(folder, "uniform", "rth3d-lba")[-1]
    fewer = Reason("--quick leaves the large grids out", Range(1.0))
    return Row(
        quantity="robots on the largest grid",
        paper=f"over {least:,.0f}",
        ours=point["robots"],
        agrees=Range(least),
        reasons=(fewer,) if preset == "quick" else (),
    )


def figure_5(folder: Path, preset: Preset) -> list[Row]:
    """About 1.7 and 1.5 at the largest size, falling."""
    wanted = dict(zip(_METHODS, (1.7, 1.5), strict=True))
    shorter = Reason(
        "ours are shorter: balancing takes the fewest steps there are, and matchings keep shifts "
        "small",
        Range(1.0, 1.7),
    )
    return [
        *(
            _ratio(
                _curve(folder, "uniform", method)[-1],
                f"about {value:g}",
                Range(value - 0.1, value + 0.05),
                _quick(preset, shorter),
            )
            for method, value in wanted.items()
        ),
        *(_falling(folder, "uniform", method) for method in _METHODS),
        _most_robots(folder, 120_000, preset),
        _auto(folder, "uniform"),
    ]


def figure_6(folder: Path, preset: Preset) -> list[Row]:
    """Towards 1.5 on flat grids."""
    below = Reason(
        "shifts of bounded matchings are shorter than the sides, so that it passes below what the "
        "theory guarantees",
        Range(1.0, 1.5),
    )
    above = Reason("it has not come down to its asymptote on the grids that we ran", Range(1.5, 2))
    return [
        *(
            _ratio(
                _curve(folder, "uniform", method)[-1],
                "asymptotically 1.5",
                Range(1.4, 1.6),
                _quick(preset, below, above),
            )
            for method in _METHODS
        ),
        *(_falling(folder, "uniform", method) for method in _METHODS),
        _auto(folder, "uniform"),
    ]


def figure_7(folder: Path, preset: Preset) -> list[Row]:
    """Between buildings the paper shows curves alone."""
    last = [_curve(folder, "buildings", method)[-1] for method in _METHODS]
    return [
        *(_ratio(point, "-", None, ()) for point in last),
        *(_falling(folder, "buildings", method) for method in _METHODS),
        _auto(folder, "buildings"),
    ]


def figure_8(folder: Path, preset: Preset) -> list[Row]:
    """Density: little impact on time, better ratios."""
    rows = []
    for method in _METHODS:
        curve = [p for p in _curve(folder, "uniform", method) if p["robots"] >= _FEWEST]
        first, last = curve[0], curve[-1]
        rows.append(
            Row(
                quantity=f"`{method}`: time for {last['robots']:,} robots over {first['robots']:,}",
                paper="little impact",
                ours=last["cpu_s"] / first["cpu_s"],
                agrees=Range(0.5, 2.0),
                reasons=(
                    Reason(
                        "virtual robots are cheap here: nothing is written of them, and writing "
                        "and compaction take most of the time",
                        Range(2.0, 20.0),
                    ),
                ),
            )
        )
        rows.append(
            Row(
                quantity=f"`{method}`: ratio for {last['robots']:,} robots over "
                f"{first['robots']:,}, before compaction",
                paper="better with density",
                ours=last["ratio_before_compaction"] / first["ratio_before_compaction"],
                agrees=Range(0.0, 1.0),
            )
        )
    return rows


_FEWEST = 4800
"""Robots that the authors' density sweep begins with."""


def figure_9(folder: Path, preset: Preset) -> list[Row]:
    """Rings approach 1."""
    rings = "rings, 2m x 2m x m"
    return [
        _ratio(
            _curve(folder, rings, "rth3d-lba")[-1],
            "approaches 1",
            Range(1.0, 1.15),
            (Reason("ratios fall as grids grow, and --quick ends early", Range(1.0, 1.35)),)
            if preset == "quick"
            else (),
        ),
        _falling(folder, rings, "rth3d-lba"),
        *(
            _ratio(_curve(folder, series, "rth3d-lba")[-1], "-", None, ())
            for series in ("27 blocks, m x m x m", "3 x 3 x 3 blocks, 2m x 2m x m")
        ),
        _auto(folder, "27 blocks, m x m x m"),
    ]


def figure_11(folder: Path, preset: Preset) -> list[Row]:
    """Letters: flown, without collision, and planned on the paper's grid."""
    content = load(folder / "figure_11.json")
    return [
        Row(
            quantity="drones",
            paper="10",
            ours=content["drones"],
            agrees=Range(10.0, 10.0),
        ),
        Row(
            quantity="letters written",
            paper="5",
            ours=content["letters_reached"],
            agrees=Range(5.0, 5.0),
        ),
        Row(
            quantity="collisions",
            paper="0",
            ours=content["collisions"],
            agrees=Range(0.0, 0.0),
        ),
        Row(
            quantity="least distance of two drones, m",
            paper="-",
            ours=content["least_distance_m"],
        ),
        Row(
            quantity="longest plan of a change of letter, steps",
            paper="-",
            ours=max(content["makespans"]),
        ),
    ]
