"""Time and ratio curves of RTH3D's Fig. 5 to 9, and what rings and blocks are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.baselines.rth3d import GridInstance, make_instance
from swarm_envs.baselines.rth3d.grid import Coordinates
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.rth3d_runs import (
    FIT_FROM,
    GUARANTEED,
    CurveFigure,
    CurvePoint,
    Curves,
    Peer,
    Spread,
)
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS: Mapping[str, str] = {
    "rth3d": "#D55E00",
    "rth3d-lba": "#0072B2",
    "auto": "#009E73",
    "pibt": "#CC79A7",
    "rth3d-lba-paper": "#56B4E9",
}
_LINES = ("-", "--")
_MARKERS: Mapping[str, str] = {"ECBS, w = 1.5": "D", "LaCAM3": "^"}
_AXES: Mapping[str, str] = {"robots": "Robots", "density": "Robots per vertex (%)", "m": "Height m"}


def plot_curve_figure(path: Path, figure: CurveFigure, curves: Curves) -> None:
    """Draw a figure: time and ratio, or for patterns the ratio alone, as the paper does."""
    if figure.axis == "m":
        _plot_patterns(path, figure, curves)
        return
    names = list(figure.series)
    with picture(path, 4.0 * (1 + len(names)), 4.1, figure.headline) as canvas:
        axes = canvas.subplots(1, 1 + len(names), squeeze=False)[0]
        _draw_times(axes[0], figure, curves)
        for k, name in enumerate(names):
            _draw_ratios(axes[k + 1], figure, name, curves, k == 0)
        _same_height(axes[1:], 1.25 if figure.axis == "density" else 1.0)


def _plot_patterns(path: Path, figure: CurveFigure, curves: Curves) -> None:
    with picture(path, 13.0, 7.6, figure.headline) as canvas:
        axes = canvas.subplots(2, 3, width_ratios=(1.15, 1.0, 1.0))
        _draw_patterns(axes[0, 0], axes[1, 0])
        ratios = axes[:, 1:].reshape(-1)
        for k, (axis, name) in enumerate(zip(ratios, figure.series, strict=False)):
            _draw_ratios(axis, figure, name, curves, k == 0)
        _same_height(ratios, 1.0)


def _same_height(axes: Sequence[Axes], room: float) -> None:
    """Give all the same limits, the largest times the room that a legend needs."""
    top = 1.0 + room * (max(axis.get_ylim()[1] for axis in axes) - 1.0)
    for axis in axes:
        axis.set_ylim(0.95, top)


def _place(figure: CurveFigure, point: CurvePoint) -> float:
    """Where a point stands along x."""
    if figure.axis == "density":
        return 100.0 * point.robots / point.setting.vertices
    return float(point.robots if figure.axis == "robots" else point.setting.shape[2])


def _draw_times(axis: Axes, figure: CurveFigure, curves: Curves) -> None:
    names = list(figure.series)
    for (name, method), row in curves.items():
        solved = [point for point in row if point.robots]
        place = [_place(figure, point) for point in solved]
        line = _LINES[names.index(name)]
        label = method if name == names[0] else None
        spreads = [point.cpu_s for point in solved]
        _draw_curve(axis, place, spreads, method, line, label)
    if len(names) > 1:
        axis.plot([], [], color=GREY, linestyle=_LINES[1], label=names[1])
    if figure.order is not None:
        _draw_order(axis, figure, curves)
    _draw_peers(axis, [(peer, peer.seconds) for peer in figure.peers])
    axis.set(xlabel=_AXES[figure.axis], ylabel="CPU time (s)", yscale="log")
    axis.set_title("Time, validation included")
    _finish(axis, figure)
    axis.set_ylim(bottom=axis.get_ylim()[0] / 4)
    axis.legend(fontsize=7.5, loc="lower right")


def _draw_curve(
    axis: Axes,
    place: Sequence[float],
    spreads: Sequence[Spread],
    method: str,
    line: str,
    label: str | None,
) -> None:
    """Means, and from least to largest of the runs; thinner lines show thicker ones below."""
    means = [spread.mean for spread in spreads]
    color, width = _COLORS[method], 2.1 - 0.4 * list(_COLORS).index(method)
    hollow = "white" if line != "-" else color
    look = {"color": color, "linestyle": line, "markersize": 2.0 + width, "linewidth": width}
    axis.plot(place, means, marker="o", markerfacecolor=hollow, label=label, **look)  # type: ignore[arg-type]
    least, most = [s.least for s in spreads], [s.most for s in spreads]
    axis.fill_between(place, least, most, color=color, alpha=0.13, linewidth=0)


def _draw_order(axis: Axes, figure: CurveFigure, curves: Curves) -> None:
    """The theory's slope, through the first point that counts in the fit."""
    rows = [row for (_, method), row in curves.items() if method == "rth3d-lba"] or [
        next(iter(curves.values()))
    ]
    large = [p for p in rows[0] if p.robots and p.setting.vertices >= FIT_FROM]
    if len(large) < 2 or figure.order is None:
        return
    begin, end = large[0], large[-1]
    grown = (end.setting.vertices / begin.setting.vertices) ** figure.order
    seconds = [begin.cpu_s.mean, begin.cpu_s.mean * grown]
    label = f"theory: vertices$^{{{figure.order:.2f}}}$"
    axis.plot([begin.robots, end.robots], seconds, color=GREY, linestyle=":", label=label)


def _draw_peers(axis: Axes, peers: Sequence[tuple[Peer, float | None]]) -> None:
    """Points of other programs; hollow where they had no answer in that time."""
    for name, marker in _MARKERS.items():
        own = [(peer, value) for peer, value in peers if peer.name == name and value is not None]
        for peer, value in own:
            face = "white" if peer.ratio is None else "#404040"
            axis.plot(peer.robots, value, marker, color="#404040", markerfacecolor=face, ms=6)
            if peer.ratio is None:
                text = "no answer "
                axis.annotate(text, (peer.robots, value), fontsize=7, ha="right", va="bottom")
        if own:
            axis.plot([], [], marker, color="#404040", label=name)


def _draw_ratios(axis: Axes, figure: CurveFigure, name: str, curves: Curves, first: bool) -> None:
    for (own, method), row in curves.items():
        solved = [p for p in row if p.ratio is not None]
        if own != name or not solved:
            continue
        place = [_place(figure, p) for p in solved]
        spreads = [p.ratio for p in solved if p.ratio is not None]
        _draw_curve(axis, place, spreads, method, "-", method)
        if method in GUARANTEED:
            before = [p.before.mean for p in solved if p.before is not None]
            axis.plot(place, before, color=_COLORS[method], linestyle=(0, (4, 2)), linewidth=0.9)
    if any(method in GUARANTEED for _, method in curves):
        axis.plot([], [], color=GREY, linestyle=(0, (4, 2)), linewidth=0.9, label="not compacted")
    _draw_known(axis, figure, name)
    axis.set(xlabel=_AXES[figure.axis], title=name)
    _finish(axis, figure)
    if first:
        axis.set_ylabel("Makespan / lower bound")
        columns = 2 if figure.axis == "density" else 1
        axis.legend(fontsize=7.5, loc="upper right", ncols=columns)


def _draw_known(axis: Axes, figure: CurveFigure, name: str) -> None:
    """What the paper's text says, what its theory says, and what others reach."""
    for method, ratio in figure.paper.items():
        axis.axhline(ratio, color=_COLORS[method], linestyle="-.", linewidth=0.8, alpha=0.8)
    for ratio in sorted(set(figure.paper.values())):
        which = [method for method, own in figure.paper.items() if own == ratio]
        _note(axis, ratio, f"paper: {' and '.join(which)} {ratio:g}")
    if figure.limit is not None and figure.limit not in figure.paper.values():
        axis.axhline(figure.limit, color=GREY, linestyle=":", linewidth=1.0)
        _note(axis, figure.limit, f"theory's limit {figure.limit:.2f}", below=True)
    if name == "uniform":
        _draw_peers(axis, [(peer, peer.ratio) for peer in figure.peers])


def _note(axis: Axes, height: float, text: str, below: bool = False) -> None:
    across, side = axis.get_yaxis_transform(), "top" if below else "bottom"
    axis.text(0.01, height, text, transform=across, fontsize=7, color=GREY, va=side)


def _finish(axis: Axes, figure: CurveFigure) -> None:
    if figure.axis == "robots":
        axis.set_xscale("log")
    axis.grid(True)


_SIDE = 27
_GAP = 6  # empty vertices between starts and goals


def _colors(instance: GridInstance, parts: int) -> FloatArray:
    """(n, 3) colour of each robot: by the part of the grid, parts a side, that it starts in."""
    import matplotlib as mpl

    x, y, z = (instance.starts * parts // np.array(instance.shape)).T
    hue = (x * parts + y) / parts**2
    value = 1.0 - 0.45 * z / max(parts - 1, 1)
    flat = np.column_stack([hue, np.full(len(hue), 0.75), value])
    return np.asarray(mpl.colors.hsv_to_rgb(flat))


def _plane(instance: GridInstance, points: Coordinates, colors: FloatArray) -> FloatArray:
    """(m1, m2, 3) the middle plane seen from above, white where no robot is."""
    seen = np.ones((*instance.shape[:2], 3))
    there = points[:, 2] == instance.shape[2] // 2
    seen[points[there, 0], points[there, 1]] = colors[there]
    return seen


def _draw_pattern(axis: Axes, title: str, instance: GridInstance, parts: int) -> None:
    colors = _colors(instance, parts)
    starts, goals = (_plane(instance, p, colors) for p in (instance.starts, instance.goals))
    gap = np.ones((_GAP, _SIDE, 3))
    both = np.concatenate([starts, gap, goals]).transpose(1, 0, 2)
    axis.imshow(both, origin="lower", interpolation="nearest")
    for k, name in enumerate(("starts", "goals")):
        left = k * (_SIDE + _GAP) - 0.5
        frame = [left, left + _SIDE, left + _SIDE, left, left]
        axis.plot(frame, np.array([0, 0, 1, 1, 0]) * _SIDE - 0.5, color="#A0A5AB", linewidth=0.8)
        axis.text(left + _SIDE / 2, -2.0, name, ha="center", va="top", fontsize=8)
    axis.set_title(title)
    axis.set_axis_off()


def _draw_patterns(rings: Axes, blocks: Axes) -> None:
    """Starts and goals of rings and of 27 blocks in the middle plane of 27 x 27 x 27."""
    shape = (_SIDE, _SIDE, _SIDE)
    _draw_pattern(rings, "(a) rings: a plane", make_instance("rings", shape), 6)
    _draw_pattern(blocks, "(b) 27 blocks: a plane", make_instance("blocks", shape), 3)
