"""Heat maps of Neural-Swarm2's Fig. 5: who stands where, joint forces, and superposition gaps.

The paper's text gives the drones of (a), (e) and (g), the speed in (d), and says that a small
drone feels the force; the rest is in the picture alone. Each case says what is whose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing.style import INK, draw_drone, draw_ground, force_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EGO = "S"  # the drone that feels the force: small in all eight cases (Sec. VII-C)

_WITHOUT_GROUND_M = 1.0
"""How far the cases without a ground are lifted: the flights show no ground effect there."""


class _MapNeighbour(NamedTuple):
    """A drone whose wake is felt: everything lies in the plane x = 0."""

    kind: str  # `S` or `L`
    y: float  # m
    z: float  # m
    vy: float = 0.0  # m/s


@dataclass(frozen=True)
class _MapCase:
    letter: str  # of the panel in the figure
    title: str  # what flies
    neighbours: tuple[_MapNeighbour, ...]  # whose wakes are felt
    ground: bool
    """Whether the map begins at the ground; otherwise it begins `_WITHOUT_GROUND_M` above."""
    stated: str  # what the paper's text says of it
    assumed: str  # what we chose, since only the picture shows it

    @property
    def floor_m(self) -> float:
        """Height at which the map begins."""
        return 0.0 if self.ground else _WITHOUT_GROUND_M


_UP = 0.5 + _WITHOUT_GROUND_M
_PAIR = ((-0.1, 0.5), (0.1, 0.5))
_THREE = ((0.0, 0.6), *_PAIR)


def _standing(kinds: str, places: Sequence[tuple[float, float]]) -> tuple[_MapNeighbour, ...]:
    return tuple(_MapNeighbour(kind, y, z) for kind, (y, z) in zip(kinds, places, strict=True))


_ONE_STATED = "one small neighbour over the ground, which mitigates its downwash"
_FOUR_STATED = "four vehicles, three of them small neighbours, over the ground"
_PAIR_STATED = "large at (-0.1, 0.5), small at (0.1, 0.5)"
_ALOFT_ASSUMED = "small, at (0, 0.5), without ground: else (c) would be (b)"
_MOVING = (_MapNeighbour("S", 0.0, _UP, 0.8),)
_ALOFT, _NEAR = _standing("S", [(0.0, _UP)]), _standing("S", [(0.0, 0.5)])
_THREE_SMALL, _LARGE_ON_TOP = _standing("SSS", _THREE), _standing("LSS", _THREE)
MAP_CASES = tuple(
    _MapCase(*case)
    for case in (
        ("a", "ground only", (), True, "no neighbour; ground at z = 0", ""),
        ("b", "S over the ground", _NEAR, True, _ONE_STATED, "its place (0, 0.5)"),
        ("c", "S aloft, hovering", _ALOFT, False, "one neighbour, hovering", _ALOFT_ASSUMED),
        ("d", "S aloft, moving at 0.8 m/s", _MOVING, False, "one neighbour moving at 0.8 m/s",
         "as (c); towards +y"),
        ("e", "L and S", _standing("LS", _PAIR), True, _PAIR_STATED, ""),
        ("f", "L and L", _standing("LL", _PAIR), True, "nothing",
         "two large ones where (e) has its two"),
        ("g", "three S", _THREE_SMALL, True, _FOUR_STATED, "at (0, 0.6), (-0.1, 0.5), (0.1, 0.5)"),
        ("h", "L and two S", _LARGE_ON_TOP, True, "four vehicles",
         "as (g) with a large one at the top"),
    )
)  # fmt: skip
"""The panels of Fig. 5."""


READINGS = (
    # name, what it says, the paper's value, the same from the weights that the authors published, g
    ("ground_effect", "(a): small drone at (0, 0.05)", 5.0, 1.7),
    ("two_above", "(e): small drone at (0, 0.3)", -10.0, -12.4),
    ("superposition_gap", "(g): largest gap to the sum of pairs", 11.4, 3.7),
)
"""Numbers read off Fig. 5. The published weights give neither the first nor the last: nothing is
tuned to them."""


def force_on_ego_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """f_a,z (R,), g, on the first of a team at positions (R, N, 3), m; velocities None for rest."""
    motion = np.zeros_like(position) if velocity is None else velocity
    force: FloatArray = model.forces(position, motion, "".join(team))[:, 0, 2] / GRAM_FORCE
    return force


def superposed_force_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """What the force on the first drone would be if pairs added up, (R,) gram-force.

    f_0 + sum_j (f_j - f_0), with f_0 of the drone alone over the ground and f_j with neighbour j
    alone. The paper adds rho(phi_env) and rho(phi_j) (Sec. VII-C), which leaves the ground out of
    the pairs; only a network can be asked that, and it was never trained without its ground.
    """
    motion = np.zeros_like(position) if velocity is None else velocity
    alone = force_on_ego_g(model, team[:1], position[:, :1], motion[:, :1])
    total = alone.copy()
    for j in range(1, len(team)):
        pair = [0, j]
        force = force_on_ego_g(model, [team[0], team[j]], position[:, pair], motion[:, pair])
        total += force - alone
    return total


_HALF_WIDTH_M, _HEIGHT_M = 0.5, 1.0  # size of a map: y from -0.5 to 0.5 m, z over 1 m
_BELOW_M = 0.06  # what a picture shows below: ground, or more of the air
_LOWEST_MEASURED_M = 0.07  # no flight of a small drone was lower


@dataclass(frozen=True)
class _ForceMap:
    """One heat map: rows go up in z, columns in y."""

    case: _MapCase  # what is mapped
    y: FloatArray  # (C,) m
    z: FloatArray  # (R,) m above the ground
    force_g: FloatArray  # (R, C) vertical force on the small drone
    gap_g: FloatArray  # (R, C) sum of the pairs minus joint force
    free: BoolArray
    """(R, C) where the drone touches no neighbour and is not lower than any that was measured."""

    def at(self, y: float, z: float) -> float:
        """Force at the grid's nearest point, gram-force."""
        row, column = int(np.abs(self.z - z).argmin()), int(np.abs(self.y - y).argmin())
        return float(self.force_g[row, column])

    def extreme_gap(self, free_only: bool = True) -> tuple[float, float, float]:
        """Largest gap by magnitude: its value (g) and its place y, z (m)."""
        size = np.where(self.free | (not free_only), np.abs(self.gap_g), -1.0)
        row, column = np.unravel_index(int(size.argmax()), size.shape)
        return float(self.gap_g[row, column]), float(self.y[column]), float(self.z[row])


def force_map(model: InteractionModel, case: _MapCase, step_m: float = 0.01) -> _ForceMap:
    """Evaluate one case on a grid."""
    if not 0.001 <= step_m <= 0.25:
        raise ValueError(f"step_m is {step_m}, but must be from 0.001 to 0.25")
    y = np.linspace(-_HALF_WIDTH_M, _HALF_WIDTH_M, round(2 * _HALF_WIDTH_M / step_m) + 1)
    below = 0.0 if case.ground else _BELOW_M
    steps = round((_HEIGHT_M + below) / step_m) + 1
    z = case.floor_m + np.linspace(-below, _HEIGHT_M, steps)
    team = [_EGO, *(n.kind for n in case.neighbours)]
    position = np.zeros((len(z) * len(y), len(team), 3))
    velocity = np.zeros_like(position)
    position[:, 0, 1], position[:, 0, 2] = (a.ravel() for a in np.meshgrid(y, z))
    for j, neighbour in enumerate(case.neighbours, start=1):
        position[:, j, 1:] = neighbour.y, neighbour.z
        velocity[:, j, 1] = neighbour.vy
    joint = force_on_ego_g(model, team, position, velocity)
    gap = superposed_force_g(model, team, position, velocity) - joint
    shape = (len(z), len(y))
    radius = [vehicle.radius for vehicle in parse_team("".join(team))]
    free = position[:, 0, 2] >= _LOWEST_MEASURED_M - 1e-9
    for j in range(1, len(team)):
        distance = np.linalg.norm(position[:, j] - position[:, 0], axis=1)
        free &= distance >= radius[0] + radius[j]
    joint, gap = joint.reshape(shape), gap.reshape(shape)
    return _ForceMap(case, y, z, joint, gap, free.reshape(shape))


def summarise_maps(maps: list[_ForceMap], model: str) -> dict[str, Any]:
    """Numbers of the eight maps and the paper's readings, ready for JSON."""
    by_letter = {m.case.letter: m for m in maps}
    ours = {
        "ground_effect": by_letter["a"].at(0.0, 0.05),
        "two_above": by_letter["e"].at(0.0, 0.3),
        "superposition_gap": abs(by_letter["g"].extreme_gap(free_only=False)[0]),
    }
    keys = ("name", "what", "paper_g", "published_weights_g", "ours_g")
    readings = [dict(zip(keys, (*row, round(ours[row[0]], 3)), strict=True)) for row in READINGS]
    moving = np.abs(by_letter["d"].force_g - by_letter["c"].force_g)
    b = by_letter["b"]
    return {
        "model": model,
        "readings": readings,
        "moving_changes_force_by_g": round(float(moving[by_letter["c"].free].max()), 3),
        "mitigation_g": {
            f"z={z}": round(b.at(0.0, z) - by_letter["a"].at(0.0, z), 3) for z in (0.3, 0.1, 0.07)
        },
        "cases": [_summary(m) for m in maps],
        "gap_means": "sum of pairs minus joint force: negative where the pairs push down more",
    }


def _summary(found: _ForceMap) -> dict[str, Any]:
    case = found.case
    inside = found.force_g[found.free]
    gap = {}
    for name, free_only in (("where_free", True), ("anywhere", False)):
        value, y, z = found.extreme_gap(free_only)
        gap[name] = {"gap_g": round(value, 3), "y_m": round(y, 3), "z_m": round(z, 3)}
    return {
        "case": case.letter,
        "neighbours": [n._asdict() for n in case.neighbours],
        "ground": case.ground,
        "paper_states": case.stated,
        "assumed": case.assumed,
        "lowest_g": round(float(inside.min()), 3),
        "highest_g": round(float(inside.max()), 3),
        "superposition_gap": gap if len(case.neighbours) > 1 else None,
    }


def plot_heat_maps(path: Path, maps: Sequence[_ForceMap], model: str) -> None:
    """Draw the eight maps on one colour scale."""
    lowest = min(float(m.force_g.min()) for m in maps)
    highest = max(float(m.force_g.max()) for m in maps)
    headline = f"Force on a small drone among its neighbours, model {model!r} (Fig. 5 of the paper)"
    with picture(path, 14.0, 8.0, headline) as figure:
        axes = figure.subplots(2, 4)
        for axis, found in zip(axes.flat, maps, strict=True):
            colors = _draw(axis, found, found.force_g, (lowest, highest))
            axis.set_title(f"({found.case.letter})  {found.case.title}")
        _finish(figure, axes, colors, "Vertical force (g): red pushes down")


def plot_gaps(path: Path, maps: Sequence[_ForceMap], model: str) -> None:
    """Draw sum of pairs minus joint force where there is more than one neighbour."""
    several = [m for m in maps if len(m.case.neighbours) > 1]
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
    axis: Axes,
    found: _ForceMap,
    value: FloatArray,
    limits: tuple[float, float],
    contour_g: float = 2.5,
) -> Any:
    span = (found.y[0], found.y[-1], found.z[0], found.z[-1])
    colors = axis.imshow(
        value,
        extent=span,
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
        axis.axhline(_LOWEST_MEASURED_M, color=INK, linewidth=0.7, linestyle=":", zorder=3)
    for neighbour in found.case.neighbours:
        draw_drone(axis, neighbour.kind, neighbour.y, neighbour.z)
        if neighbour.vy:
            begin, z = neighbour.y + 0.09, neighbour.z
            arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6}
            end = (begin + 0.22 * neighbour.vy, z)
            axis.annotate("", end, (begin, z), arrowprops=arrow, zorder=6)
    base = found.case.floor_m
    axis.set(xlim=(-_HALF_WIDTH_M, _HALF_WIDTH_M), xticks=[-0.4, -0.2, 0, 0.2, 0.4])
    axis.set_ylim(base - _BELOW_M, base + _HEIGHT_M)
    axis.set_aspect("equal")
    return colors


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
