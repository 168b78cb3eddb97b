"""Forces in stacks and rings of more drones than in any measured flight, beside Fig. 5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from examples.papers.neural_swarm2.superposition import force_on_first_g, superposed_force_g
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import LATERAL_REACH, VERTICAL_REACH
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED_NEIGHBORS = 2  # most neighbors of any flight that a model here was fitted to
SIZES = (4, 5, 16)  # drones in Fig. 5(g, h), Fig. 9 and Fig. 1 of the paper
SPACING_M = 0.25
"""Vertical distance in a stack: drones that swap pass each other at 0.2-0.3 m (Sec. VII-E)."""
RING_RADIUS_M, RING_SPACING_M, RING_SIZE = 0.16, 0.3, 4
"""Rings of up to four drones, one above the other, each turned by half a step."""
LOWEST_M = 0.6  # height of the lowest drone: away from the ground
SMALL_COLOR, LARGE_COLOR = "#0072B2", "#D55E00"


def stack_places(drones: int) -> FloatArray:
    """Return positions (N, 3) of drones one above the other, the lowest first, m."""
    position = np.zeros((drones, 3))
    position[:, 2] = LOWEST_M + SPACING_M * np.arange(drones)
    return position


def ring_places(drones: int) -> FloatArray:
    """Return positions (N, 3) of drones on rings one above the other, the lowest first, m."""
    level, place = np.divmod(np.arange(drones), RING_SIZE)
    angle = (place + 0.5 * (level % 2)) * 2 * np.pi / RING_SIZE
    across = RING_RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([across, LOWEST_M + RING_SPACING_M * level])


FORMATIONS = {"stack": stack_places, "rings": ring_places}


@dataclass(frozen=True)
class Swarm:
    """Forces in one formation of N drones, in the order of their positions."""

    formation: str
    team: str
    position: FloatArray  # (N, 3) m
    neighbors: IntArray  # (N,) how many others are in each drone's interaction volume
    joint_g: FloatArray  # (N,) vertical force
    superposed_g: FloatArray  # (N,) the sum of its pairs

    def numbers(self) -> dict[str, Any]:
        """Return the forces, ready for JSON."""
        worst, most = int(self.joint_g.argmin()), int(self.neighbors.max())
        return {
            "formation": self.formation,
            "team_from_below": self.team,
            "drones": len(self.team),
            "most_neighbors": most,
            "measured_at_most": MEASURED_NEIGHBORS,
            "neighbors_beyond_measured": max(most - MEASURED_NEIGHBORS, 0),
            "drones_beyond_measured": int((self.neighbors > MEASURED_NEIGHBORS).sum()),
            "highest_force_g": round(float(self.joint_g.max()), 3),
            "strongest_force_g": round(float(self.joint_g[worst]), 3),
            "its_sum_of_pairs_g": round(float(self.superposed_g[worst]), 3),
            "its_neighbors": int(self.neighbors[worst]),
            "forces_g": np.round(self.joint_g, 3).tolist(),
            "sums_of_pairs_g": np.round(self.superposed_g, 3).tolist(),
            "neighbors": self.neighbors.tolist(),
        }


def examine_formation(model: InteractionModel, formation: str, team: str) -> Swarm:
    """Compute forces on every drone of a resting formation; the team is from the lowest up."""
    position = FORMATIONS[formation](len(team))
    joint, superposed = np.zeros((2, len(team)))
    for i in range(len(team)):
        order = [i, *(j for j in range(len(team)) if j != i)]
        arguments = model, [team[j] for j in order], position[None, order]
        joint[i] = force_on_first_g(*arguments)[0]
        superposed[i] = superposed_force_g(*arguments)[0]
    apart = np.abs(position[:, None] - position[None])
    inside = (apart < [LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH]).all(axis=-1)
    return Swarm(formation, team, position, inside.sum(axis=1) - 1, joint, superposed)


def all_swarms(model: InteractionModel) -> list[Swarm]:
    """Examine stacks and rings of small drones of every size, and of large above small ones."""
    swarms = [examine_formation(model, f, "S" * n) for f in FORMATIONS for n in SIZES]
    return swarms + [examine_formation(model, "stack", "S" + "L" * (n - 1)) for n in SIZES]


def plot_swarms(path: Path, swarms: Sequence[Swarm], model: InteractionModel) -> None:
    """Draw forces over height in stacks and rings, and over the number of drones."""
    drawn = [s for s in swarms if set(s.team) == {"S"}]
    headline = f"Larger swarms than were measured, model {model.name!r}"
    with picture(path, 15.0, 8.0, headline) as figure:
        grid = figure.add_gridspec(2, len(SIZES) + 1, width_ratios=[1.0] * len(SIZES) + [2.2])
        for row, formation in enumerate(FORMATIONS):
            own = [s for s in drawn if s.formation == formation]
            values = np.concatenate([v for s in own for v in (s.joint_g, s.superposed_g)])
            margin = 0.05 * float(np.ptp(values)) + 0.2
            for column, s in enumerate(own):
                axis = figure.add_subplot(grid[row, column])
                _plot_profile(axis, s)
                axis.set_xlim(values.min() - margin, values.max() + margin)
                if column == 0:
                    axis.set_ylabel("Height (m)")
            _plot_growth(figure.add_subplot(grid[row, -1]), model, formation)
        figure.supxlabel(
            f"The flights have at most {MEASURED_NEIGHBORS} neighbors: beyond, a model "
            "extrapolates how they add up. Filled: joint force; open: sum of its pairs.",
            fontsize=9,
        )


def _plot_profile(axis: Axes, s: Swarm) -> None:
    """Draw the force on each drone of a formation at its height."""
    height = s.position[:, 2]
    for z, joint, pairs in zip(height, s.joint_g, s.superposed_g, strict=True):
        axis.plot([joint, pairs], [z, z], color="#A8ADB3", linewidth=0.9, zorder=1)
    axis.plot(s.superposed_g, height, "o", color=GREY, markerfacecolor="white", markersize=5)
    axis.plot(s.joint_g, height, "o", color=SMALL_COLOR, markersize=5)
    axis.axvline(0.0, color=GREY, linewidth=0.8, zorder=0)
    top = 16 * SPACING_M if s.formation == "stack" else 1.1
    title = f"{s.formation} of {len(s.team)}: {int(s.neighbors.max())} neighbors".capitalize()
    axis.set(ylim=(LOWEST_M - 0.15, LOWEST_M + top), title=title, xlabel="Force on each drone (g)")
    axis.grid(True)


def _plot_growth(axis: Axes, model: InteractionModel, formation: str) -> None:
    """Draw the force on the lowest drone of growing formations, jointly and as a sum of pairs."""
    largest = SIZES[-1]
    for kind, name, color in (("S", "small", SMALL_COLOR), ("L", "large", LARGE_COLOR)):
        found = [examine_formation(model, formation, "S" + kind * n) for n in range(largest)]
        joint, pairs = [s.joint_g[0] for s in found], [s.superposed_g[0] for s in found]
        look: Any = {"color": color, "markersize": 4}
        axis.plot(joint, "-o", label=f"{name} ones, joint", **look)
        axis.plot(pairs, "--o", markerfacecolor="white", label=f"{name} ones, sum of pairs", **look)
    axis.axvspan(-0.4, MEASURED_NEIGHBORS + 0.5, color="#E8F1E4", zorder=0)
    axis.text(0.05, 0.03, "measured", transform=axis.get_xaxis_transform(), color=GREY)
    axis.axhline(0.0, color=GREY, linewidth=0.8, zorder=0)
    axis.set(
        title=f"The lowest drone, small, under more and more others ({formation})",
        xlabel=f"Other drones in its {formation}",
        ylabel="Force on the lowest drone (g)",
        xlim=(-0.4, largest - 0.6),
    )
    axis.grid(True)
    if formation == next(iter(FORMATIONS)):
        axis.legend(fontsize=8, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 0.93))
