"""Names beside the marks of a plot, so that none covers another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from swarm_envs.training.scoreboard.axes import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH

_CHARACTER, _LINE = 6.7, 13.0
"""Width of a character, a little generous, and height of a line of small text."""
_SHORT = 22
"""Longer names are cut: they stand in full in the legend."""
_GAP = 8.0

Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""


class Label(NamedTuple):
    """A name that belongs to a mark."""

    text: str
    """The name."""
    x: float
    """Of the mark."""
    y: float
    """Of the mark."""
    key: str
    """For whoever draws it."""


def placed(labels: Sequence[Label], taken: Sequence[Box]) -> Iterator[tuple[Label, float, float]]:
    """Give each name that finds room near its mark, and where its text begins; baseline.

    Args:
        labels: those that matter most first.
        taken: where none may be.
    """
    taken = list(taken)
    for label in labels:
        text = label.text if len(label.text) <= _SHORT else label.text[: _SHORT - 1] + "…"
        width = _CHARACTER * len(text)
        for x, y in _places(label, width):
            box = (x, y - _LINE + 3, x + width, y + 3)
            if _inside(box) and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                yield label._replace(text=text), x, y
                break


def _places(label: Label, width: float) -> Iterator[tuple[float, float]]:
    """Where a name may begin: left of its mark, right, above, below; then farther off."""
    for shift in (4.0, -8.0, 17.0, -22.0, 31.0):
        for x in (label.x - _GAP - width, label.x + _GAP, label.x - width / 2):
            yield x, label.y + shift


def _inside(box: Box) -> bool:
    left, top, right, bottom = box
    return left > LEFT and right < WIDTH - RIGHT and top > TOP - 8 and bottom < HEIGHT - BOTTOM


def _overlap(one: Box, other: Box) -> bool:
    apart = one[2] < other[0] or other[2] < one[0] or one[3] < other[1] or other[3] < one[1]
    return not apart
