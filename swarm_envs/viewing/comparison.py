"""Comparison of flights without and with compensation: plots, and frames of a video."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.viewing.camera import Camera
from swarm_envs.viewing.painting import ZOOM, draw_arrow
from swarm_envs.viewing.record import FlightRecord
from swarm_envs.viewing.style import GREY, INK, font, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.ImageDraw import ImageDraw

__all__ = ["COMPENSATED_COLOR", "WITHOUT_COLOR", "Comparison", "SideBySide", "plot_comparisons"]

WITHOUT_COLOR = "#D55E00"
"""Vermilion of Okabe and Ito's palette for color-blind readers."""
COMPENSATED_COLOR = "#0072B2"
"""Blue of the same palette."""


@dataclass(frozen=True)
class Comparison:
    """Flights with two controllers, pairwise with the same task."""

    title: str
    """The title, such as `L2S`."""
    without: Sequence[FlightRecord]
    """The flights without compensation."""
    compensated: Sequence[FlightRecord]
    """The flights with compensation."""

    @property
    def without_cm(self) -> FloatArray:
        """Worst height error of the lowest drone in each flight without compensation, cm."""
        return np.array([flight.worst_height_error_cm() for flight in self.without])

    @property
    def compensated_cm(self) -> FloatArray:
        """Worst height error of the lowest drone in each flight with compensation, cm."""
        return np.array([flight.worst_height_error_cm() for flight in self.compensated])


def plot_comparisons(path: Path, comparisons: Sequence[Comparison], headline: str) -> None:
    """Plot height error and force of the lowest drone over time, one column per comparison.

    Thin lines are flights, bold lines their median at each time.
    """
    if not comparisons:
        raise ValueError("no comparison was given; plot at least one")
    with picture(path, 1.6 + 3.7 * len(comparisons), 6.4, headline) as figure:
        axes = figure.subplots(
            2,
            len(comparisons),
            sharex=True,
            sharey="row",
            squeeze=False,
            height_ratios=[3, 2],
        )
        for comparison, column in zip(comparisons, axes.T, strict=True):
            _plot_column(comparison, *column)
        axes[0, 0].set_ylabel("Height error of the lowest drone (cm)")
        axes[1, 0].set_ylabel("Vertical interaction force\non the lowest drone (g)")
        _add_legend(figure, axes[0, 0], len(comparisons[0].without))


def _plot_column(comparison: Comparison, upper: Axes, lower: Axes) -> None:
    sides = (
        (comparison.without, WITHOUT_COLOR),
        (comparison.compensated, COMPENSATED_COLOR),
    )
    for flights, color in sides:
        time = max((flight.time for flight in flights), key=len)
        _plot_lines(upper, time, [flight.height_error_cm() for flight in flights], color)
        _plot_lines(lower, time, [flight.vertical_force_g() for flight in flights], color)
    for axis in (upper, lower):
        axis.grid(True)
        axis.axhline(0.0, color=GREY, linewidth=0.8, zorder=1)
        crossing = _crossing_time(comparison.without[0])
        if crossing is not None:
            axis.axvline(crossing, color=GREY, linewidth=0.8, linestyle=":", zorder=1)
    before, after = np.median(comparison.without_cm), np.median(comparison.compensated_cm)
    upper.set_title(
        f"{comparison.title}\nmedian of worst errors: {before:.1f} → {after:.1f} cm", loc="center"
    )
    lower.set_xlabel("Time (s)")
    lower.set_xlim(0.0, float(time[-1]))


def _plot_lines(axis: Axes, time: FloatArray, rows: Sequence[FloatArray], color: str) -> None:
    table = np.full((len(rows), len(time)), np.nan)  # a flight may have ended early
    for line, row in zip(table, rows, strict=True):
        line[: len(row)] = row
        axis.plot(time[: len(row)], row, color=color, linewidth=0.8, alpha=0.5)
    axis.plot(time, np.nanmedian(table, axis=0), color=color, linewidth=2.0)


def _crossing_time(flight: FlightRecord) -> float | None:
    """Return the time at which the references are above one another, s; None for one drone."""
    if len(flight.team) < 2:
        return None
    across = flight.reference[:, :, :2] - flight.reference[:, -1:, :2]
    return float(flight.time[np.argmin(np.linalg.norm(across, axis=2).max(axis=1))])


def _add_legend(figure: Figure, axis: Axes, flights: int) -> None:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=WITHOUT_COLOR, linewidth=2.0, label="without compensation"),
        Line2D([], [], color=COMPENSATED_COLOR, linewidth=2.0, label="with compensation"),
        Line2D([], [], color=GREY, linewidth=0.7, label=f"one of {flights} swaps"),
        Line2D([], [], color=GREY, linewidth=2.0, label="median"),
        Line2D([], [], color=GREY, linewidth=0.8, linestyle=":", label="drones above each other"),
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), frameon=False)


WIDTH, HEIGHT = 1280, 720
"""Size of a picture, pixels."""
_HEADER, _CHART = 56, 184
_PALE, _PAPER = "#7A8088", "#FFFFFF"
_ARROW_M_PER_G = 0.012
_CAPTIONS = ("Without compensation", "With compensation")
_COLORS = (WITHOUT_COLOR, COMPENSATED_COLOR)


class SideBySide:
    """Renderer of two flights side by side, with their height errors below.

    Each half shows the reference path of the lowest drone (dashed), its actual path, and the
    interaction force on it as an arrow.

    Args:
        title: the title above the pictures.
        flights: the flight without compensation, then the one with it; of one team and task.
        duration_s: the duration of the video, s, or that of the longer flight if it is less.
    """

    def __init__(
        self, title: str, flights: tuple[FlightRecord, FlightRecord], duration_s: float
    ) -> None:
        self.title, self.flights = title, flights
        self.duration_s = min(duration_s, max(float(flight.time[-1]) for flight in flights))
        size = WIDTH // 2, HEIGHT - _HEADER - _CHART
        self._camera = Camera(
            flights[0].team, *size, azimuth_deg=_beside(flights[0]), elevation_deg=9.0
        )
        self._camera.aim(np.concatenate([f.position.reshape(-1, 3) for f in flights]))
        errors = np.concatenate([f.height_error_cm() for f in flights])
        self._range_cm = (
            math.floor(errors.min() / 5.0) * 5.0 - 1.0,
            math.ceil(max(float(errors.max()), 1.0) / 5.0) * 5.0 + 1.0,
        )

    def count(self, fps: int) -> int:
        """Return the number of frames."""
        return math.floor(self.duration_s * fps) + 1

    def frames(self, fps: int) -> Iterator[npt.NDArray[np.uint8]]:
        """Yield the frames (720, 1280, 3) of both flights, in real time.

        Args:
            fps: frames per second.
        """
        for k in range(self.count(fps)):
            yield self.frame(k / fps)

    def frame(self, time: float) -> npt.NDArray[np.uint8]:
        """Return the frame (720, 1280, 3) at a time, s."""
        from PIL import Image, ImageDraw

        canvas = Image.new("RGB", (ZOOM * WIDTH, ZOOM * HEIGHT), _PAPER)
        for side, flight in enumerate(self.flights):
            index = min(int(np.searchsorted(flight.time, time + 1e-9)), len(flight.time)) - 1
            half = self._camera.canvas(flight.state(index))
            self._annotate(ImageDraw.Draw(half), side, index)
            canvas.paste(half, (side * ZOOM * WIDTH // 2, ZOOM * _HEADER))
        pen = ImageDraw.Draw(canvas)
        middle = ZOOM * WIDTH // 2
        pen.line(
            [(middle, ZOOM * _HEADER), (middle, ZOOM * (HEIGHT - _CHART))],
            fill=_PAPER,
            width=4 * ZOOM,
        )
        _write(pen, (20, 15), self.title, 22, bold=True)
        _write(pen, (WIDTH - 20, 17), f"{time:.1f} s", 20, anchor="ra")
        self._chart(pen, time)
        return np.asarray(canvas.reduce(ZOOM))

    def _annotate(self, pen: ImageDraw, side: int, index: int) -> None:
        flight, color = self.flights[side], _COLORS[side]
        _dash(pen, self._project(flight.reference[:, -1]), _PALE)
        flown = self._project(flight.position[: index + 1, -1])
        if index:
            pen.line(_points(flown), fill=color, width=3 * ZOOM, joint="curve")
        force = float(flight.vertical_force_g()[index])
        foot = flight.position[index, -1]
        tip = foot + np.array([0.0, 0.0, _ARROW_M_PER_G * force])
        foot, tip = self._project(np.stack([foot, tip]))
        draw_arrow(pen, foot, tip, INK, width=3 * ZOOM, head=9.0 * ZOOM)
        error = float(flight.height_error_cm()[index])
        _write(pen, (20, 14), _CAPTIONS[side], 21, bold=True, color=color)
        _write(pen, (20, 44), f"height error {_signed(error)} cm", 18)
        _write(pen, (20, 68), f"interaction force {_signed(force)} g", 18)

    def _project(self, points: FloatArray) -> FloatArray:
        return ZOOM * self._camera.lens.project(points)

    def _chart(self, pen: ImageDraw, time: float) -> None:
        left, right, top, bottom = 84, WIDTH - 24, HEIGHT - _CHART + 34, HEIGHT - 30
        last = self.duration_s
        low, high = self._range_cm

        def place(t: FloatArray, error: FloatArray) -> FloatArray:
            x = left + (right - left) * t / last
            y = bottom - (bottom - top) * (error - low) / (high - low)
            return np.stack([x, y], axis=-1) * ZOOM

        _write(pen, (20, HEIGHT - _CHART + 8), "Height error of the lowest drone (cm)", 16)
        for tick in np.arange(math.ceil(low / 5.0) * 5.0, high, 5.0):
            ends = place(np.array([0.0, last]), np.array([tick, tick]))
            pen.line(_points(ends), fill="#C9CED4" if tick else _PALE, width=ZOOM)
            _write(pen, (left - 10, ends[0, 1] / ZOOM), _signed(tick, 0), 14, anchor="rm")
        for tick in range(math.floor(last) + 1):
            x = place(np.array([float(tick)]), np.zeros(1))[0, 0] / ZOOM
            _write(pen, (x, bottom + 6), f"{tick} s", 14, anchor="ma", color=_PALE)
        for flight, color in zip(self.flights, _COLORS, strict=True):
            past = flight.time <= time + 1e-9
            line = place(flight.time[past], flight.height_error_cm()[past])
            if len(line) > 1:
                pen.line(_points(line), fill=color, width=3 * ZOOM, joint="curve")
            x, y = line[-1]
            r = 5 * ZOOM
            pen.ellipse((x - r, y - r, x + r, y + r), fill=color)


def _beside(flight: FlightRecord) -> float:
    """Return the azimuth, degrees, from which the lowest drone's path is seen from the side."""
    path = flight.reference[-1, -1] - flight.reference[0, -1]
    return math.degrees(math.atan2(float(path[1]), float(path[0]))) - 90.0


def _signed(value: float, digits: int = 1) -> str:
    text = f"{value:+.{digits}f}".replace("-", "\N{MINUS SIGN}")
    return text[1:] if float(f"{value:.{digits}f}") == 0.0 else text


def _points(pixels: FloatArray) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in pixels]


def _dash(pen: ImageDraw, pixels: FloatArray, color: str) -> None:
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    step = 9.0 * ZOOM
    for start in np.arange(0.0, along[-1] - step / 2, 2 * step):
        ends = [
            [np.interp(s, along, pixels[:, 0]), np.interp(s, along, pixels[:, 1])]
            for s in (start, min(start + step, along[-1]))
        ]
        pen.line(_points(np.array(ends)), fill=color, width=2 * ZOOM)


def _write(
    pen: ImageDraw,
    at: Sequence[float],
    text: str,
    size: int,
    *,
    bold: bool = False,
    anchor: str = "la",
    color: str = INK,
) -> None:
    place = (at[0] * ZOOM, at[1] * ZOOM)
    pen.text(place, text, fill=color, font=font(size * ZOOM, bold), anchor=anchor)
