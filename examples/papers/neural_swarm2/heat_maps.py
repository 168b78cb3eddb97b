"""The heat maps of Fig. 5: positions of the drones, joint forces, and superposition gaps.

The text of the paper gives the drones of (a), (e) and (g), the speed in (d), and that the force is
on a small drone; the rest is in the picture only. Each case states its source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from examples.papers.neural_swarm2.superposition import force_on_first_g, superposed_force_g
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing.style import INK, draw_drone, draw_ground, force_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WITHOUT_GROUND_M = 1.0  # height of the cases without ground: flights show no ground effect there
HALF_WIDTH_M, HEIGHT_M = 0.5, 1.0  # size of a map: y from -0.5 to 0.5 m, z over 1 m
BELOW_M = 0.06  # what a picture shows below: ground, or more air
LOWEST_MEASURED_M = 0.07  # no flight of a small drone was lower


class MapNeighbor(NamedTuple):
    """A drone whose wake is felt, in the plane x = 0."""

    kind: str  # "S" or "L"
    y: float  # m
    z: float  # m
    vy: float = 0.0  # m/s


class MapCase(NamedTuple):
    """A panel of Fig. 5."""

    letter: str
    title: str
    neighbors: tuple[MapNeighbor, ...]
    ground: bool  # the map begins at the ground, or else `WITHOUT_GROUND_M` above it
    stated: str  # in the paper's text
    assumed: str  # by us, because only the picture shows it

    @property
    def floor_m(self) -> float:
        """Height at which the map begins."""
        return 0.0 if self.ground else WITHOUT_GROUND_M


UP = 0.5 + WITHOUT_GROUND_M
PAIR = ((-0.1, 0.5), (0.1, 0.5))
THREE = ((0.0, 0.6), *PAIR)


def _standing(kinds: str, places: Sequence[tuple[float, float]]) -> tuple[MapNeighbor, ...]:
    return tuple(MapNeighbor(kind, y, z) for kind, (y, z) in zip(kinds, places, strict=True))


MAP_CASES = (
    MapCase("a", "ground only", (), True, "no neighbor; ground at z = 0", ""),
    MapCase(
        *("b", "S over the ground", _standing("S", [(0.0, 0.5)]), True),
        "one small neighbor over the ground, which mitigates its downwash",
        "its place (0, 0.5)",
    ),
    MapCase(
        *("c", "S aloft, hovering", _standing("S", [(0.0, UP)]), False),
        "one neighbor, hovering",
        "small, at (0, 0.5), without ground: else (c) would be (b)",
    ),
    MapCase(
        *("d", "S aloft, moving at 0.8 m/s", (MapNeighbor("S", 0.0, UP, 0.8),), False),
        "one neighbor moving at 0.8 m/s",
        "as (c); towards +y",
    ),
    MapCase(
        *("e", "L and S", _standing("LS", PAIR), True),
        "large at (-0.1, 0.5), small at (0.1, 0.5)",
        "",
    ),
    MapCase(
        *("f", "L and L", _standing("LL", PAIR), True),
        "nothing",
        "two large ones where (e) has its two",
    ),
    MapCase(
        *("g", "three S", _standing("SSS", THREE), True),
        "four vehicles, three of them small neighbors, over the ground",
        "at (0, 0.6), (-0.1, 0.5), (0.1, 0.5)",
    ),
    MapCase(
        *("h", "L and two S", _standing("LSS", THREE), True),
        "four vehicles",
        "as (g) with a large one at the top",
    ),
)


@dataclass(frozen=True)
class ForceMap:
    """A heat map: rows go up in z, columns in y."""

    case: MapCase
    y: FloatArray  # (C,) m
    z: FloatArray  # (R,) m above the ground
    force_g: FloatArray  # (R, C) vertical force on the small drone
    gap_g: FloatArray  # (R, C) sum of the pairs minus joint force
    free: BoolArray
    """(R, C) where the drone touches no neighbor and is not lower than any that was measured."""

    def at(self, y: float, z: float) -> float:
        """Return the force at the grid's nearest point, g."""
        row, column = int(np.abs(self.z - z).argmin()), int(np.abs(self.y - y).argmin())
        return float(self.force_g[row, column])

    def extreme_gap(self, free_only: bool = True) -> tuple[float, float, float]:
        """Return the largest gap by magnitude, g, and its place y and z, m."""
        size = np.where(self.free | (not free_only), np.abs(self.gap_g), -1.0)
        row, column = np.unravel_index(int(size.argmax()), size.shape)
        return float(self.gap_g[row, column]), float(self.y[column]), float(self.z[row])


def force_map(model: InteractionModel, case: MapCase, step_m: float = 0.01) -> ForceMap:
    """Evaluate one case on a grid."""
    y = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, round(2 * HALF_WIDTH_M / step_m) + 1)
    below = 0.0 if case.ground else BELOW_M
    steps = round((HEIGHT_M + below) / step_m) + 1
    z = case.floor_m + np.linspace(-below, HEIGHT_M, steps)
    team = ["S", *(neighbor.kind for neighbor in case.neighbors)]
    position = np.zeros((len(z) * len(y), len(team), 3))
    velocity = np.zeros_like(position)
    position[:, 0, 1], position[:, 0, 2] = (a.ravel() for a in np.meshgrid(y, z))
    for j, neighbor in enumerate(case.neighbors, start=1):
        position[:, j, 1:] = neighbor.y, neighbor.z
        velocity[:, j, 1] = neighbor.vy
    joint = force_on_first_g(model, team, position, velocity)
    gap = superposed_force_g(model, team, position, velocity) - joint
    shape = (len(z), len(y))
    free = _is_free(position, team).reshape(shape)
    return ForceMap(case, y, z, joint.reshape(shape), gap.reshape(shape), free)


def _is_free(position: FloatArray, team: Sequence[str]) -> BoolArray:
    """Return where the first drone touches no other and is not lower than any flight, (R,)."""
    radius = [vehicle.radius for vehicle in parse_team("".join(team))]
    free: BoolArray = position[:, 0, 2] >= LOWEST_MEASURED_M - 1e-9
    for j in range(1, len(team)):
        distance = np.linalg.norm(position[:, j] - position[:, 0], axis=1)
        free &= distance >= radius[0] + radius[j]
    return free


def plot_heat_maps(path: Path, maps: Sequence[ForceMap], model: str) -> None:
    """Draw the eight maps on one color scale."""
    lowest = min(float(m.force_g.min()) for m in maps)
    highest = max(float(m.force_g.max()) for m in maps)
    headline = f"Force on a small drone among its neighbors, model {model!r} (Fig. 5 of the paper)"
    with picture(path, 14.0, 8.0, headline) as figure:
        axes = figure.subplots(2, 4)
        for axis, found in zip(axes.flat, maps, strict=True):
            colors = _draw(axis, found, found.force_g, (lowest, highest), 2.5)
            axis.set_title(f"({found.case.letter})  {found.case.title}")
        _finish(figure, axes, colors, "Vertical force (g): red pushes down")


def plot_gaps(path: Path, maps: Sequence[ForceMap], model: str) -> None:
    """Draw the sum of the pairs minus the joint force where there is more than one neighbor."""
    several = [m for m in maps if len(m.case.neighbors) > 1]
    largest = max(float(np.abs(m.gap_g).max()) for m in several) or 1.0
    headline = f"Sum of pair forces minus joint force, model {model!r}"
    with picture(path, 14.0, 4.6, headline) as figure:
        axes = figure.subplots(1, len(several), squeeze=False)
        for axis, found in zip(axes.flat, several, strict=True):
            colors = _draw(axis, found, found.gap_g, (-largest, largest), 1.0)
            gap, y, z = found.extreme_gap()
            axis.plot([y], [z], marker="o", markersize=7, markerfacecolor="none", color=INK)
            axis.set_title(f"({found.case.letter})  largest {gap:+.1f} g (ring)")
        label = "Gap (g): red where the pairs\nwould push down more"
        _finish(figure, axes, colors, label)


def _draw(
    axis: Axes, found: ForceMap, value: FloatArray, limits: tuple[float, float], contour_g: float
) -> Any:
    """Draw a map with its neighbors; return the image, of which a color bar is made."""
    colors = axis.imshow(
        value,
        extent=(found.y[0], found.y[-1], found.z[0], found.z[-1]),
        origin="lower",
        cmap=force_colors(*limits),
        vmin=limits[0],
        vmax=limits[1],
        interpolation="bilinear",
    )
    steps = np.arange(np.ceil(limits[0] / contour_g), limits[1] / contour_g) * contour_g
    steps = steps[np.abs(steps) > 1e-9]
    if len(steps) and np.ptp(value) > contour_g:
        lines = axis.contour(found.y, found.z, value, steps, colors=INK, linewidths=0.5, alpha=0.55)
        axis.clabel(lines, steps[::2], fmt="%g", fontsize=7)
    if found.case.ground:
        draw_ground(axis)
        axis.axhline(LOWEST_MEASURED_M, color=INK, linewidth=0.7, linestyle=":", zorder=3)
    for neighbor in found.case.neighbors:
        _draw_neighbor(axis, neighbor)
    base = found.case.floor_m
    axis.set(xlim=(-HALF_WIDTH_M, HALF_WIDTH_M), xticks=[-0.4, -0.2, 0, 0.2, 0.4])
    axis.set_ylim(base - BELOW_M, base + HEIGHT_M)
    axis.set_aspect("equal")
    return colors


def _draw_neighbor(axis: Axes, neighbor: MapNeighbor) -> None:
    """Draw a drone, with an arrow if it moves."""
    draw_drone(axis, neighbor.kind, neighbor.y, neighbor.z)
    if neighbor.vy:
        begin, z = neighbor.y + 0.09, neighbor.z
        arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6}
        axis.annotate("", (begin + 0.22 * neighbor.vy, z), (begin, z), arrowprops=arrow, zorder=6)


def _finish(figure: Figure, axes: Any, colors: Any, label: str) -> None:
    for axis in axes[-1]:
        axis.set_xlabel("y (m)")
    for axis in axes[:, 0]:
        axis.set_ylabel("Height z (m)")
    bar = figure.colorbar(colors, ax=axes, shrink=0.75, aspect=30, pad=0.015)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    figure.supxlabel(
        "Drones drawn to scale; dashed: ground; dotted: the lowest height that was measured",
        fontsize=9,
        color=INK,
    )
