"""The frame of a small plot in SVG: scales, ticks, labels, marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.markup import tag

WIDTH, HEIGHT = 400.0, 280.0
"""Of a plot, in units of which its text is 12 high."""
LEFT, RIGHT, TOP, BOTTOM = 40.0, 18.0, 10.0, 40.0
"""Margins."""

Tick = tuple[float, str]

MARKS = (
    "M0-4.6A4.6 4.6 0 1 1 0 4.6A4.6 4.6 0 1 1 0-4.6Z",  # disc
    "M-4-4H4V4H-4Z",  # square
    "M0-5.8L5.8 0 0 5.8-5.8 0Z",  # diamond
    "M0-5.4L5.2 4H-5.2Z",  # triangle
    "M0 5.4L5.2-4H-5.2Z",  # triangle on its tip
    "M-1.7-5H1.7V-1.7H5V1.7H1.7V5H-1.7V1.7H-5V-1.7H-1.7Z",  # cross
    "M0-5.5L1.6-1.8 5.4-1.6 2.5.9 3.4 4.6 0 2.5-3.4 4.6-2.5.9-5.4-1.6-1.6-1.8Z",  # star
    "M-5 0A5 5 0 0 1 5 0V1.5H-5Z",  # half a disc
)
"""Shapes of marks, so that nobody needs colours to tell them apart."""
OTHER_MARK = "M0-3A3 3 0 1 1 0 3A3 3 0 1 1 0-3Z"
"""Of whoever has no colour: a small disc."""


@dataclass(frozen=True)
class Axes:
    """A plot's scales; points outside of them are drawn at their end."""

    x: tuple[float, float]
    """Ends of the horizontal scale."""
    y: tuple[float, float] = (0.0, 1.0)
    """Ends of the vertical scale."""
    logarithmic: bool = False
    """Whether the horizontal one is."""

    def right(self, value: float) -> float:
        """Where a value of x is, from the left."""
        low, high = self.x
        if self.logarithmic:
            value, low, high = (math.log10(each) for each in (value, low, high))
        return LEFT + _clipped((value - low) / (high - low)) * (WIDTH - LEFT - RIGHT)

    def down(self, value: float) -> float:
        """Where a value of y is, from the top."""
        low, high = self.y
        return TOP + (1.0 - _clipped((value - low) / (high - low))) * (HEIGHT - TOP - BOTTOM)

    def path(self, x: Sequence[float], y: Sequence[float]) -> str:
        """A line through points, as a path's `d`."""
        points = zip(x, y, strict=True)
        return "M" + "L".join(f"{self.right(a):.1f} {self.down(b):.1f}" for a, b in points)

    def area(self, x: Sequence[float], low: Sequence[float], high: Sequence[float]) -> str:
        """What lies between two lines, as a path's `d`."""
        back = self.path(x[::-1], low[::-1])
        return f"{self.path(x, high)}L{back[1:]}Z"

    def frame(self, x_ticks: Sequence[Tick], x_label: str, y_label: str) -> list[Element]:
        """Grid, ticks and what they count; the vertical scale in per cent."""
        low, left, right = HEIGHT - BOTTOM, LEFT, WIDTH - RIGHT
        parts = []
        for value in (0.0, 0.25, 0.5, 0.75, 1.0):
            y = self.down(value)
            parts.append(tag("path", d=f"M{left:g} {y:.1f}H{right:g}", class_="grid"))
            text = f"{100 * value:.0f}"
            parts.append(tag("text", text, x=left - 7, y=y + 4, class_="end"))
        for value, text in x_ticks:
            x = self.right(value)
            parts.append(tag("path", d=f"M{x:.1f} {low:g}v5", class_="tick"))
            parts.append(tag("text", text, x=x, y=low + 18, class_="mid"))
        middle = (left + right) / 2
        parts.append(tag("text", x_label, x=middle, y=HEIGHT - 5, class_="mid name"))
        turned = f"translate(10 {(TOP + low) / 2:g}) rotate(-90)"
        parts.append(tag("text", y_label, transform=turned, class_="mid name"))
        return parts


def plot(label: str, *content: Element | list[Element]) -> Element:
    """The drawing; the label says what it shows to whoever cannot see it."""
    return tag("svg", *content, viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", role="img", aria_label=label)


def linear_ticks(low: float, high: float) -> list[Tick]:
    """Some five round numbers between two ends."""
    rough = (high - low) / 5.0
    size = 10.0 ** math.floor(math.log10(rough))
    step = next(size * k for k in (1.0, 2.0, 5.0, 10.0) if size * k >= rough * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [(k * step, f"{k * step:.6g}") for k in range(first, last + 1)]


def decades(low: float, high: float) -> list[float]:
    """Powers of ten from that below to that above."""
    first, last = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    return [10.0**k for k in range(first, max(last, first + 1) + 1)]


def _clipped(share: float) -> float:
    return min(1.0, max(0.0, share))
