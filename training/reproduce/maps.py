"""Heat maps of Fig. 5 as numbers: joint force, superposition gap, the paper's readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.reproduce.cases import CASES, EGO, READINGS, Case
from swarm_envs.training.reproduce.forces import force_on_ego_g, superposed_force_g
from swarm_envs.vehicles import parse_team

HALF_WIDTH_M, HEIGHT_M = 0.5, 1.0
"""Size of a map: y from -0.5 to 0.5 m, z over 1 m."""
BELOW_M = 0.06
"""What a picture shows below: ground, or more of the air."""
LOWEST_MEASURED_M = 0.07
"""No flight of a small drone was lower."""


@dataclass(frozen=True)
class ForceMap:
    """One heat map: rows go up in z, columns in y."""

    case: Case
    """What is mapped."""
    y: FloatArray
    """(C,) m."""
    z: FloatArray
    """(R,) m above the ground."""
    force_g: FloatArray
    """(R, C) vertical force on the small drone."""
    gap_g: FloatArray
    """(R, C) sum of the pairs minus joint force."""
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


def force_map(model: InteractionModel, case: Case, step_m: float = 0.01) -> ForceMap:
    """Evaluate one case on a grid.

    Args:
        model: whose forces.
        case: who stands where.
        step_m: spacing of the grid.

    Raises:
        ValueError: the grid is coarser than a map, or the model does not know a vehicle.
    """
    if not 0.001 <= step_m <= 0.25:
        raise ValueError(f"step_m is {step_m}, but must be from 0.001 to 0.25")
    y = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, round(2 * HALF_WIDTH_M / step_m) + 1)
    below = 0.0 if case.ground else BELOW_M
    steps = round((HEIGHT_M + below) / step_m) + 1
    z = case.floor_m + np.linspace(-below, HEIGHT_M, steps)
    team = [EGO, *(n.kind for n in case.neighbours)]
    position = np.zeros((len(z) * len(y), len(team), 3))
    velocity = np.zeros_like(position)
    position[:, 0, 1], position[:, 0, 2] = (a.ravel() for a in np.meshgrid(y, z))
    for j, neighbour in enumerate(case.neighbours, start=1):
        position[:, j, 1:] = neighbour.y, neighbour.z
        velocity[:, j, 1] = neighbour.vy
    joint = force_on_ego_g(model, team, position, velocity)
    gap = superposed_force_g(model, team, position, velocity) - joint
    shape = (len(z), len(y))
    free = _free(team, position).reshape(shape)
    return ForceMap(case, y, z, joint.reshape(shape), gap.reshape(shape), free)


def _free(team: list[str], position: FloatArray) -> BoolArray:
    radius = [vehicle.radius for vehicle in parse_team("".join(team))]
    free = position[:, 0, 2] >= LOWEST_MEASURED_M - 1e-9
    for j in range(1, len(team)):
        distance = np.linalg.norm(position[:, j] - position[:, 0], axis=1)
        free &= distance >= radius[0] + radius[j]
    return np.asarray(free)


def summarise(maps: list[ForceMap], model: str) -> dict[str, Any]:
    """Numbers of the eight maps with the paper's readings beside ours, ready for JSON."""
    by_letter = {m.case.letter: m for m in maps}
    ours = {
        "ground_effect": by_letter["a"].at(0.0, 0.05),
        "two_above": by_letter["e"].at(0.0, 0.3),
        "superposition_gap": abs(by_letter["g"].extreme_gap(free_only=False)[0]),
    }
    readings = [
        {**reading._asdict(), "ours_g": round(ours[reading.name], 3)} for reading in READINGS
    ]
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


def _summary(found: ForceMap) -> dict[str, Any]:
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


def all_maps(model: InteractionModel, step_m: float = 0.01) -> list[ForceMap]:
    """All eight maps, (a) to (h)."""
    return [force_map(model, case, step_m) for case in CASES]
