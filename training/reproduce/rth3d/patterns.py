"""Fig. 9 (a) and (b): what rings and blocks are, in a plane of the grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.baselines.rth3d import GridInstance, make_instance
from swarm_envs.baselines.rth3d.grid import Coordinates
from swarm_envs.state import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIDE = 27
_GAP = 6
"""Empty vertices between starts and goals."""


def _colors(instance: GridInstance, parts: int) -> FloatArray:
    """(n, 3) colour of each robot: by the part of the grid, parts a side, that it starts in."""
    import matplotlib as mpl

    x, y, z = (instance.starts * parts // np.array(instance.shape)).T
    hue = (x * parts + y) / parts**2
    value = 1.0 - 0.45 * z / max(parts - 1, 1)
    flat = np.column_stack([hue, np.full(len(hue), 0.75), value])
    return np.asarray(mpl.colors.hsv_to_rgb(flat))


def _plane(instance: GridInstance, points: Coordinates, colors: FloatArray) -> FloatArray:
    """(m1, m2, 3) the middle plane seen from above, white where nobody is."""
    seen = np.ones((*instance.shape[:2], 3))
    there = points[:, 2] == instance.shape[2] // 2
    seen[points[there, 0], points[there, 1]] = colors[there]
    return seen


def _draw(axis: Axes, title: str, instance: GridInstance, parts: int) -> None:
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


def draw_patterns(rings: Axes, blocks: Axes) -> None:
    """Draw starts and goals of rings and of 27 blocks in the middle plane of 27 x 27 x 27.

    Args:
        rings: where (a) goes; colour says where in the plane a robot starts.
        blocks: where (b) goes; colour says from which block a robot comes.
    """
    shape = (_SIDE, _SIDE, _SIDE)
    _draw(rings, "(a) rings: a plane", make_instance("rings", shape), 6)
    _draw(blocks, "(b) 27 blocks: a plane", make_instance("blocks", shape), 3)
