"""Swarms larger than any that was measured: forces in stacks and in rings of 4, 5 and 16 drones.

The flights have at most two neighbours. What a model says of more is extrapolation of how
neighbours add up; each drone's number of neighbours inside the interaction volume says how far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import LATERAL_REACH, VERTICAL_REACH
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.training.reproduce.forces import force_on_ego_g, superposed_force_g
from swarm_envs.training.reproduce.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED_NEIGHBOURS = 2
"""Most neighbours of any flight that a model here was fitted to."""
SIZES = (4, 5, 16)
"""Fig. 5(g, h), Fig. 9 and Fig. 1 of the paper."""

SPACING_M = 0.25
"""Vertical distance in a stack: drones that swap pass each other at 0.2-0.3 m (Sec. VII-E)."""
RING_RADIUS_M, RING_SPACING_M, RING_SIZE = 0.16, 0.3, 4
"""Rings of up to four drones, one above the other, each turned by half a step."""
LOWEST_M = 0.6
"""Height of the lowest drone: away from the ground."""

JOINT = "#0072B2"
"""Colour of small drones' joint force."""


def stack(drones: int) -> FloatArray:
    """Positions (N, 3) of drones one above the other, the lowest first, m."""
    position = np.zeros((drones, 3))
    position[:, 2] = LOWEST_M + SPACING_M * np.arange(drones)
    return position


def rings(drones: int) -> FloatArray:
    """Positions (N, 3) of drones on rings one above the other, the lowest first, m."""
    level, place = np.divmod(np.arange(drones), RING_SIZE)
    angle = (place + 0.5 * (level % 2)) * 2 * np.pi / RING_SIZE
    across = RING_RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([across, LOWEST_M + RING_SPACING_M * level])


FORMATIONS = {"stack": stack, "rings": rings}
"""How larger swarms are placed, by name."""


@dataclass(frozen=True)
class Swarm:
    """Forces in one formation; drones in the order of their positions."""

    formation: str
    """Name of the formation."""
    team: str
    """Who flies."""
    position: FloatArray
    """(N, 3) m."""
    neighbours: IntArray
    """(N,) how many others stand in each drone's interaction volume."""
    joint_g: FloatArray
    """(N,) vertical force."""
    superposed_g: FloatArray
    """(N,) the sum of its pairs."""


def examine(model: InteractionModel, formation: str, team: str) -> Swarm:
    """Forces on every drone of a resting formation.

    Args:
        model: whose forces.
        formation: `stack` or `rings`.
        team: vehicle types, from the lowest up, such as `"SSSS"`.

    Raises:
        KeyError: there is no such formation.
    """
    position = FORMATIONS[formation](len(team))
    orders = [[i, *(j for j in range(len(team)) if j != i)] for i in range(len(team))]
    joint, superposed = np.zeros((2, len(team)))
    for i, order in enumerate(orders):
        arguments = model, [team[j] for j in order], position[None, order]
        joint[i] = force_on_ego_g(*arguments)[0]
        superposed[i] = superposed_force_g(*arguments)[0]
    apart = np.abs(position[:, None] - position[None])
    inside = (apart < [LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH]).all(axis=-1)
    return Swarm(formation, team, position, inside.sum(axis=1) - 1, joint, superposed)


def all_swarms(model: InteractionModel, sizes: Sequence[int] = SIZES) -> list[Swarm]:
    """Stacks and rings of small drones of every size, and of large above small ones."""
    swarms = [examine(model, f, "S" * n) for f in FORMATIONS for n in sizes]
    return swarms + [examine(model, "stack", "S" + "L" * (n - 1)) for n in sizes]


def summarise_swarms(swarms: Sequence[Swarm]) -> list[dict[str, Any]]:
    """Numbers of each swarm, ready for JSON."""
    return [_summary(s) for s in swarms]


def _summary(s: Swarm) -> dict[str, Any]:
    worst = int(s.joint_g.argmin())
    return {
        "formation": s.formation,
        "team_from_below": s.team,
        "drones": len(s.team),
        "most_neighbours": int(s.neighbours.max()),
        "measured_at_most": MEASURED_NEIGHBOURS,
        "neighbours_beyond_measured": int(max(s.neighbours.max() - MEASURED_NEIGHBOURS, 0)),
        "drones_beyond_measured": int((s.neighbours > MEASURED_NEIGHBOURS).sum()),
        "highest_force_g": round(float(s.joint_g.max()), 3),
        "strongest_force_g": round(float(s.joint_g[worst]), 3),
        "its_sum_of_pairs_g": round(float(s.superposed_g[worst]), 3),
        "its_neighbours": int(s.neighbours[worst]),
        "forces_g": np.round(s.joint_g, 3).tolist(),
        "sums_of_pairs_g": np.round(s.superposed_g, 3).tolist(),
        "neighbours": s.neighbours.tolist(),
    }


def plot_swarms(path: Path, swarms: Sequence[Swarm], model: InteractionModel) -> None:
    """Draw forces over height in stacks and rings, and over the number of drones.

    Args:
        path: the picture to write.
        swarms: as `all_swarms` returns them; those of small drones are drawn.
        model: whose forces they are.
    """
    drawn = [s for s in swarms if set(s.team) == {"S"}]
    headline = f"Larger swarms than were measured, model {model.name!r}"
    with picture(path, 15.0, 8.0, headline) as figure:
        sizes = list(dict.fromkeys(len(s.team) for s in drawn))
        grid = figure.add_gridspec(2, len(sizes) + 1, width_ratios=[1.0] * len(sizes) + [2.2])
        for row, formation in enumerate(FORMATIONS):
            own = [s for s in drawn if s.formation == formation]
            values = np.concatenate([v for s in own for v in (s.joint_g, s.superposed_g)])
            margin = 0.05 * float(np.ptp(values)) + 0.2
            for column, s in enumerate(own):
                axis = figure.add_subplot(grid[row, column])
                _profile(axis, s)
                axis.set_xlim(values.min() - margin, values.max() + margin)
                if column == 0:
                    axis.set_ylabel("Height (m)")
            _growth(figure.add_subplot(grid[row, -1]), model, formation)
        figure.supxlabel(
            f"The flights have at most {MEASURED_NEIGHBOURS} neighbours: beyond, a model "
            "extrapolates how they add up. Filled: joint force; open: sum of its pairs.",
            fontsize=9,
        )


def _profile(axis: Axes, s: Swarm) -> None:
    height = s.position[:, 2]
    for z, joint, pairs in zip(height, s.joint_g, s.superposed_g, strict=True):
        axis.plot([joint, pairs], [z, z], color="#A8ADB3", linewidth=0.9, zorder=1)
    axis.plot(s.superposed_g, height, "o", color=GREY, markerfacecolor="white", markersize=5)
    axis.plot(s.joint_g, height, "o", color=JOINT, markersize=5)
    axis.axvline(0.0, color=GREY, linewidth=0.8, zorder=0)
    axis.set_ylim(LOWEST_M - 0.15, LOWEST_M + (16 * SPACING_M if s.formation == "stack" else 1.1))
    neighbours = int(s.neighbours.max())
    name = "Stack" if s.formation == "stack" else "Rings"
    axis.set_title(f"{name} of {len(s.team)}: {neighbours} neighbours")
    axis.set_xlabel("Force on each drone (g)")
    axis.grid(True)


def _growth(axis: Axes, model: InteractionModel, formation: str) -> None:
    """Force on the lowest drone of growing formations, jointly and as a sum of pairs."""
    largest = SIZES[-1]
    for kind, color in (("S", JOINT), ("L", "#D55E00")):
        found = [examine(model, formation, "S" + kind * n) for n in range(largest)]
        number = np.arange(largest)
        joint, pairs = [s.joint_g[0] for s in found], [s.superposed_g[0] for s in found]
        name = "small" if kind == "S" else "large"
        axis.plot(number, joint, "-o", color=color, markersize=4, label=f"{name} ones, joint")
        axis.plot(number, pairs, "--o", color=color, markersize=4, markerfacecolor="white",
                  label=f"{name} ones, sum of pairs")  # fmt: skip
    axis.axvspan(-0.4, MEASURED_NEIGHBOURS + 0.5, color="#E8F1E4", zorder=0)
    axis.text(0.05, 0.03, "measured", transform=axis.get_xaxis_transform(), color=GREY)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set(xlim=(-0.4, largest - 0.6), ylabel="Force on the lowest drone (g)")
    axis.set_xlabel(f"Other drones in its {formation}", color=INK)
    axis.grid(True)
    axis.set_title(f"The lowest drone, small, under more and more others ({formation})")
    if formation == next(iter(FORMATIONS)):
        axis.legend(fontsize=8, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 0.93))
