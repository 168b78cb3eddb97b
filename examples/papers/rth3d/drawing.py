"""Pictures of Figs. 5 to 9: time and ratio curves, and the patterns of rings and blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.colors import hsv_to_rgb

from examples.papers.rth3d.runs import FIT_FROM, GUARANTEED, Points
from swarm_envs.baselines.rth3d import GridInstance, make_instance
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {
    "rth3d": "#D55E00",
    "rth3d-lba": "#0072B2",
    "auto": "#009E73",
    "pibt": "#CC79A7",
    "rth3d-lba-paper": "#56B4E9",
}
DASHES: Any = (0, (4, 2))  # of ratios before compaction
SIDE, GAP = 27, 6  # vertices of a pattern, and between its starts and goals

Along = Literal["robots", "density", "height"]
LABELS = {"robots": "Robots", "density": "Robots per vertex (%)", "height": "Height m"}
PLACE: Mapping[Along, Callable[[dict[str, Any]], float]] = {
    "robots": lambda point: point["robots"],
    "density": lambda point: 100.0 * point["robots"] / point["vertices"],
    "height": lambda point: int(point["grid"].split("x")[2]),
}
"""Where a point stands along the horizontal axis."""


def draw_times_and_ratios(
    path: Path,
    points: Points,
    headline: str,
    *,
    axis: Along = "robots",
    paper: Mapping[str, float] | None = None,
    limit: float | None = None,
    order: float | None = None,
) -> None:
    """Draw CPU times of all series, and beside them the ratios of each.

    Args:
        path: of the PNG file.
        points: rows of `measure`.
        headline: above the picture.
        axis: what grows along the horizontal axis.
        paper: ratio that the paper's text gives for the largest grids, by method.
        limit: ratio that the theory approaches on random instances.
        order: the theory's exponent of the run time in the number of vertices.
    """
    names = list(dict.fromkeys(point["series"] for point in points))
    with picture(path, 4.0 * (1 + len(names)), 4.1, headline) as canvas:
        axes = canvas.subplots(1, 1 + len(names), squeeze=False)[0]
        _draw_times(axes[0], points, names, axis)
        if order is not None:
            _draw_order(axes[0], points, names[0], order)
        axes[0].set_ylim(bottom=axes[0].get_ylim()[0] / 4)
        axes[0].legend(fontsize=7.5, loc="lower right")
        for ratios, name in zip(axes[1:], names, strict=True):
            _draw_ratios(ratios, points, name, axis)
            _draw_known(ratios, paper or {}, limit)
        _finish_ratios(axes[1:], columns=2 if axis == "density" else 1)
        if axis == "robots":
            for each in axes:
                each.set_xscale("log")


def draw_patterns(path: Path, points: Points, headline: str) -> None:
    """Draw rings and 27 blocks, and the ratios of four series over the height."""
    names = list(dict.fromkeys(point["series"] for point in points))
    with picture(path, 13.0, 7.6, headline) as canvas:
        axes = canvas.subplots(2, 3, width_ratios=(1.15, 1.0, 1.0))
        shape = (SIDE, SIDE, SIDE)
        _draw_pattern(axes[0, 0], "(a) rings: a plane", make_instance("rings", shape), 6)
        _draw_pattern(axes[1, 0], "(b) 27 blocks: a plane", make_instance("blocks", shape), 3)
        ratios = axes[:, 1:].reshape(-1)
        for axis, name in zip(ratios, names, strict=False):
            _draw_ratios(axis, points, name, "height")
        _finish_ratios(ratios, columns=1)


def _by_method(points: Points, series: str) -> dict[str, Points]:
    """The solved points of a series, by method."""
    curves: dict[str, Points] = {}
    for point in points:
        if point["series"] == series and point["solved"]:
            curves.setdefault(point["method"], []).append(point)
    return curves


def _draw_times(axis: Axes, points: Points, names: Sequence[str], along: Along) -> None:
    for name, line in zip(names, ("-", "--"), strict=False):
        for method, own in _by_method(points, name).items():
            label = method if name == names[0] else None
            _draw_curve(axis, own, "cpu_s", along, line, label)
    if len(names) > 1:
        axis.plot([], [], color=GREY, linestyle="--", label=names[1])
    axis.set(xlabel=LABELS[along], ylabel="CPU time (s)", yscale="log")
    axis.set_title("Time, validation included")
    axis.grid(True)


def _draw_curve(
    axis: Axes, own: Points, column: str, along: Along, line: str, label: str | None
) -> None:
    """Draw means, and the range of the runs; thinner lines show thicker ones below."""
    method = own[0]["method"]
    color, width = COLORS[method], 2.1 - 0.4 * list(COLORS).index(method)
    place = [PLACE[along](point) for point in own]
    axis.plot(
        place,
        [point[column] for point in own],
        line,
        color=color,
        linewidth=width,
        marker="o",
        markersize=2.0 + width,
        markerfacecolor=color if line == "-" else "white",
        label=label,
    )
    least, most = ([point[f"{column}_{end}"] for point in own] for end in ("least", "most"))
    axis.fill_between(place, least, most, color=color, alpha=0.13, linewidth=0)


def _draw_order(axis: Axes, points: Points, name: str, order: float) -> None:
    """Draw the theory's slope, through the first point that counts in the fit."""
    curves = _by_method(points, name)
    own = curves.get("rth3d-lba") or next(iter(curves.values()), [])
    large = [point for point in own if point["vertices"] >= FIT_FROM]
    if len(large) < 2:
        return
    begin, end = large[0], large[-1]
    grown = (end["vertices"] / begin["vertices"]) ** order
    seconds = [begin["cpu_s"], begin["cpu_s"] * grown]
    label = f"theory: vertices$^{{{order:.2f}}}$"
    axis.plot([begin["robots"], end["robots"]], seconds, color=GREY, linestyle=":", label=label)


def _draw_ratios(axis: Axes, points: Points, name: str, along: Along) -> None:
    curves = _by_method(points, name)
    for method, own in curves.items():
        _draw_curve(axis, own, "ratio", along, "-", method)
        if method in GUARANTEED:
            place = [PLACE[along](point) for point in own]
            before = [point["ratio_before_compaction"] for point in own]
            axis.plot(place, before, color=COLORS[method], linestyle=DASHES, linewidth=0.9)
    if set(curves) & set(GUARANTEED):
        axis.plot([], [], color=GREY, linestyle=DASHES, linewidth=0.9, label="not compacted")
    axis.set(xlabel=LABELS[along], title=name)
    axis.grid(True)


def _draw_known(axis: Axes, paper: Mapping[str, float], limit: float | None) -> None:
    """Draw the ratios of the paper's text and of its theory."""
    across = axis.get_yaxis_transform()
    note: Any = {"transform": across, "fontsize": 7, "color": GREY}
    for method, ratio in paper.items():
        axis.axhline(ratio, color=COLORS[method], linestyle="-.", linewidth=0.8, alpha=0.8)
    for ratio in sorted(set(paper.values())):
        which = " and ".join(method for method, own in paper.items() if own == ratio)
        axis.text(0.01, ratio, f"paper: {which} {ratio:g}", va="bottom", **note)
    if limit is not None and limit not in paper.values():
        axis.axhline(limit, color=GREY, linestyle=":", linewidth=1.0)
        axis.text(0.01, limit, f"theory's limit {limit:.2f}", va="top", **note)


def _finish_ratios(axes: Sequence[Axes], columns: int) -> None:
    """Give all axes of ratios the same limits, and the first a legend with room for it."""
    axes[0].set_ylabel("Makespan / lower bound")
    axes[0].legend(fontsize=7.5, loc="upper right", ncols=columns)
    room = 1.25 if columns == 2 else 1.0
    top = 1.0 + room * (max(axis.get_ylim()[1] for axis in axes) - 1.0)
    for axis in axes:
        axis.set_ylim(0.95, top)


def _draw_pattern(axis: Axes, title: str, instance: GridInstance, parts: int) -> None:
    """Draw starts and goals in the middle plane, colored by the part that a robot starts in."""
    colors = _colors(instance, parts)
    starts, goals = (_plane(points, colors) for points in (instance.starts, instance.goals))
    gap = np.ones((GAP, SIDE, 3))
    both = np.concatenate([starts, gap, goals]).transpose(1, 0, 2)
    axis.imshow(both, origin="lower", interpolation="nearest")
    for k, name in enumerate(("starts", "goals")):
        left = k * (SIDE + GAP) - 0.5
        frame = [left, left + SIDE, left + SIDE, left, left]
        axis.plot(frame, np.array([0, 0, 1, 1, 0]) * SIDE - 0.5, color="#A0A5AB", linewidth=0.8)
        axis.text(left + SIDE / 2, -2.0, name, ha="center", va="top", fontsize=8)
    axis.set_title(title)
    axis.set_axis_off()


def _colors(instance: GridInstance, parts: int) -> np.ndarray[Any, Any]:
    """Return the color of each robot (n, 3) by the part, `parts` to a side, that it starts in."""
    x, y, z = (instance.starts * parts // np.array(instance.shape)).T
    hue = (x * parts + y) / parts**2
    value = 1.0 - 0.45 * z / max(parts - 1, 1)
    return np.asarray(hsv_to_rgb(np.column_stack([hue, np.full(len(hue), 0.75), value])))


def _plane(points: np.ndarray[Any, Any], colors: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the middle plane seen from above (SIDE, SIDE, 3), white where no robot is."""
    seen = np.ones((SIDE, SIDE, 3))
    there = points[:, 2] == SIDE // 2
    seen[points[there, 0], points[there, 1]] = colors[there]
    return seen
