"""Time and ratio curves of Fig. 5 to 9."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from swarm_envs.training.reproduce.rth3d.curves import FIT_FROM, Curves, Point, Spread
from swarm_envs.training.reproduce.rth3d.experiments import GUARANTEED, Figure, Peer
from swarm_envs.training.reproduce.rth3d.patterns import draw_patterns
from swarm_envs.training.reproduce.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS: Mapping[str, str] = {
    "rth3d": "#D55E00",
    "rth3d-lba": "#0072B2",
    "auto": "#009E73",
    "pibt": "#CC79A7",
}
"""By method."""
_LINES = ("-", "--")
_MARKERS: Mapping[str, str] = {"ECBS, w = 1.5": "D", "LaCAM3": "^"}
_AXES: Mapping[str, str] = {
    "robots": "Robots",
    "density": "Robots per vertex (%)",
    "m": "Height m",
}


def plot_figure(path: Path, figure: Figure, curves: Curves) -> None:
    """Draw a figure: time and ratio, or for patterns the ratio alone, as the paper does.

    Args:
        path: the picture to write.
        figure: what was varied.
        curves: its points; settings that were not run are missing.
    """
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


def _plot_patterns(path: Path, figure: Figure, curves: Curves) -> None:
    with picture(path, 13.0, 7.6, figure.headline) as canvas:
        axes = canvas.subplots(2, 3, width_ratios=(1.15, 1.0, 1.0))
        draw_patterns(axes[0, 0], axes[1, 0])
        ratios = axes[:, 1:].reshape(-1)
        for k, (axis, name) in enumerate(zip(ratios, figure.series, strict=False)):
            _draw_ratios(axis, figure, name, curves, k == 0)
        _same_height(ratios, 1.0)


def _same_height(axes: Sequence[Axes], room: float) -> None:
    """Give all the same limits, the largest times the room that a legend needs."""
    top = 1.0 + room * (max(axis.get_ylim()[1] for axis in axes) - 1.0)
    for axis in axes:
        axis.set_ylim(0.95, top)


def _place(figure: Figure, point: Point) -> float:
    """Where a point stands along x."""
    if figure.axis == "density":
        return 100.0 * point.robots / point.setting.vertices
    return float(point.robots if figure.axis == "robots" else point.setting.shape[2])


def _draw_times(axis: Axes, figure: Figure, curves: Curves) -> None:
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
    color, width = COLORS[method], 2.1 - 0.4 * list(COLORS).index(method)
    hollow = "white" if line != "-" else color
    look = {"color": color, "linestyle": line, "markersize": 2.0 + width, "linewidth": width}
    axis.plot(place, means, marker="o", markerfacecolor=hollow, label=label, **look)  # type: ignore[arg-type]
    least, most = [s.least for s in spreads], [s.most for s in spreads]
    axis.fill_between(place, least, most, color=color, alpha=0.13, linewidth=0)


def _draw_order(axis: Axes, figure: Figure, curves: Curves) -> None:
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


def _draw_ratios(axis: Axes, figure: Figure, name: str, curves: Curves, first: bool) -> None:
    for (own, method), row in curves.items():
        solved = [p for p in row if p.ratio is not None]
        if own != name or not solved:
            continue
        place = [_place(figure, p) for p in solved]
        spreads = [p.ratio for p in solved if p.ratio is not None]
        _draw_curve(axis, place, spreads, method, "-", method)
        if method in GUARANTEED:
            before = [p.before.mean for p in solved if p.before is not None]
            axis.plot(place, before, color=COLORS[method], linestyle=(0, (4, 2)), linewidth=0.9)
    if any(method in GUARANTEED for _, method in curves):
        axis.plot([], [], color=GREY, linestyle=(0, (4, 2)), linewidth=0.9, label="not compacted")
    _draw_known(axis, figure, name)
    axis.set(xlabel=_AXES[figure.axis], title=name)
    _finish(axis, figure)
    if first:
        axis.set_ylabel("Makespan / lower bound")
        columns = 2 if figure.axis == "density" else 1
        axis.legend(fontsize=7.5, loc="upper right", ncols=columns)


def _draw_known(axis: Axes, figure: Figure, name: str) -> None:
    """What the paper's text says, what its theory says, and what others reach."""
    for method, ratio in figure.paper.items():
        axis.axhline(ratio, color=COLORS[method], linestyle="-.", linewidth=0.8, alpha=0.8)
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


def _finish(axis: Axes, figure: Figure) -> None:
    if figure.axis == "robots":
        axis.set_xscale("log")
    axis.grid(True)
