"""The common style of all pictures: figures, colors, the font, and drones from the side.

Every vehicle type has a hue, and each of its drones a shade. The font is DejaVu Sans, which is
included in matplotlib.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.vehicles import Vehicle, parse_team

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure
    from PIL.ImageFont import FreeTypeFont

__all__ = ["GREY", "INK", "draw_drone", "draw_ground", "drone_colors", "force_colors", "picture"]

INK = "#202428"
"""Color of text and axes."""
GREY = "#60656B"
"""Color of secondary elements."""

_STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "grid.color": "#E3E6EA",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "hatch.linewidth": 0.6,
}


@contextmanager
def picture(path: Path, width: float, height: float, headline: str) -> Iterator[Figure]:
    """Yield a figure to draw on, and write it to `path` atomically at the end."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained", h_pad=0.08)
        figure.suptitle(headline, fontsize=13, fontweight="bold", color=INK)
        yield figure
        with written_whole(path) as partial:
            figure.savefig(partial, dpi=150)


def force_colors(lowest: float, highest: float) -> Colormap:
    """Return a color map of vertical forces: red for negative, blue for positive, white for zero.

    Forces of equal magnitude have equally strong colors; the map ranges from lowest to highest.
    """
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap

    largest = max(-lowest, highest)
    position = 0.5 + 0.5 * np.linspace(lowest, highest, 512) / largest
    return ListedColormap(mpl.colormaps["RdBu"](position))


def draw_drone(
    axis: Axes, kind: str | Vehicle, y: float, z: float, color: str = INK, alpha: float = 1.0
) -> None:
    """Draw a quadrotor from the side, to scale: y and z in m, with equal axes."""
    from matplotlib.patches import Ellipse, FancyBboxPatch

    radius = (parse_team(kind)[0] if isinstance(kind, str) else kind).radius
    edge: Any = {"facecolor": color, "edgecolor": "white", "linewidth": 0.5, "zorder": 6}
    edge["alpha"] = alpha
    line: Any = {"color": color, "alpha": alpha, "zorder": 5}
    rotor = 0.42 * radius
    for side in (-1, 1):
        foot = y + side * (radius - rotor)
        axis.plot([foot, foot], [z, z + 0.3 * radius], linewidth=1.6, **line)
        axis.add_patch(Ellipse((foot, z + 0.3 * radius), 2 * rotor, 0.14 * radius, **edge))
    axis.plot([y - radius + rotor, y + radius - rotor], [z, z], linewidth=2.2, **line)
    width, height = 0.55 * radius, 0.3 * radius
    box = f"round,pad=0,rounding_size={0.1 * radius}"
    corner = (y - width / 2, z - height / 2)
    axis.add_patch(FancyBboxPatch(corner, width, height, boxstyle=box, **edge))


def draw_ground(axis: Axes) -> None:
    """Draw the ground as a dashed line, as in the paper's figure, hatched below."""
    axis.axhspan(-0.06, 0.0, facecolor="#EDEFF1", edgecolor="#A8ADB3", hatch="////", zorder=2)
    axis.axhline(0.0, color=INK, linewidth=1.2, linestyle="--", zorder=3)


_HUES = {"S": 0.585, "L": 0.072, "S*": 0.405}
_OTHER_HUE = 0.78
_SATURATION = 0.68
_SHADES = (0.40, 0.64)
"""Lightness of the darkest and the lightest drone of a type, visible on white and on black."""
_TYPICAL = 0.52


def type_color(token: str) -> str:
    """Return the color, `#rrggbb`, of a vehicle type."""
    return _hex(token, _TYPICAL)


def drone_colors(team: Sequence[Vehicle]) -> list[str]:
    """Return a color, `#rrggbb`, for each drone: shades of its type's hue, from dark to light."""
    tokens = [vehicle.token for vehicle in team]
    colors = []
    for i, token in enumerate(tokens):
        count, place = tokens.count(token), tokens[:i].count(token)
        share = place / (count - 1) if count > 1 else 0.5
        colors.append(_hex(token, _SHADES[0] + share * (_SHADES[1] - _SHADES[0])))
    return colors


def _hex(token: str, lightness: float) -> str:
    hue = _HUES.get(token, _OTHER_HUE)
    parts = colorsys.hls_to_rgb(hue, lightness, _SATURATION)
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)


@cache
def font(size: int, bold: bool = False) -> FreeTypeFont | Any:
    """Return the font of a size, pixels."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / name), size)
