"""What a plan must keep to: the box, speeds, controls, forces and distances."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.errors import check_array, unknown_name
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Team

FORCE_BOUNDS_G: Mapping[str, float] = MappingProxyType({"S": 5.0, "S*": 5.0, "L": 10.0})
"""f_a,max by vehicle token, grams (Neural-Swarm2, Sec. VII-D, Fig. 6 and 7)."""


@typed
@dataclass(frozen=True)
class PlanningBounds:
    """Bounds on every robot's states, controls and forces: the sets X and U of eq. (6).

    Forces are bounded in their vertical component, as in the paper, whose f_a is vertical: the
    horizontal one is the drone's own drag, which no neighbour's plan changes.

    Raises:
        ValueError: a number is not positive and finite, or the box is empty.
    """

    lower: tuple[float, float, float] = (-2.0, -2.0, 0.2)
    """Lower corner of the box of positions, m."""
    upper: tuple[float, float, float] = (2.0, 2.0, 2.5)
    """Upper corner of the box of positions, m."""
    speed: float = 2.0
    """Largest |v| along each axis, m/s."""
    acceleration: float = 5.0
    """Largest |u| along each axis, m/s^2: thrust per mass, gravity removed (eq. 13)."""
    force_g: Mapping[str, float] = field(default_factory=lambda: FORCE_BOUNDS_G)
    """f_a,max, the largest |f_a,z| by vehicle token, grams."""
    force_change_g: float = 10.0
    """b_fa, by how much planning one robot may change the vertical force on another, grams."""
    clearance_factor: float = 1.1
    """Distance to keep over the sum of the two radii: r(lk) of eq. (6) with room for tracking."""
    goal_distance: float = 0.1
    """epsilon in position, m: how near to the goal stage 1 may end."""
    goal_speed: float = 0.2
    """epsilon in velocity, m/s: how slow stage 1 must be there."""

    def __post_init__(self) -> None:
        """Refuse what bounds nothing or everything."""
        for bound in dataclasses.fields(self):
            if bound.type == "float":
                check_positive(bound.name, getattr(self, bound.name))
        for token, grams in self.force_g.items():
            check_positive(f"force_g[{token!r}]", grams)
        low, high = check_array("lower", self.lower, (3,)), check_array("upper", self.upper, (3,))
        if not (low < high).all():
            raise ValueError(
                f"lower is {self.lower} m and upper {self.upper} m, but upper must be larger "
                "along each axis"
            )
        if self.clearance_factor < 1.0:
            raise ValueError(
                f"clearance_factor is {self.clearance_factor}, but must be at least 1: below it "
                "the vehicles touch"
            )

    def force_bounds(self, team: Team) -> FloatArray:
        """Largest |f_a,z| (N,) of each vehicle, newton.

        Raises:
            ValueError: a vehicle's token has no bound.
        """
        for vehicle in team:
            if vehicle.token not in self.force_g:
                raise ValueError(
                    unknown_name(
                        "vehicle token",
                        vehicle.token,
                        self.force_g,
                        "in the team, looked up in force_g",
                    )
                )
        return np.array([self.force_g[vehicle.token] for vehicle in team]) * GRAM_FORCE

    def clearances(self, team: Team) -> FloatArray:
        """Distance (N, N) that each pair of vehicles keeps at least, m; 0 on the diagonal."""
        radii = np.array([vehicle.radius for vehicle in team])
        distances = self.clearance_factor * (radii[:, None] + radii[None, :])
        np.fill_diagonal(distances, 0.0)
        return distances


def check_positive(name: str, value: object) -> None:
    """Refuse a number that is not positive and finite.

    Raises:
        ValueError: naming the number.
    """
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not 0.0 < number < math.inf:
        raise ValueError(f"{name} is {value!r}, but must be a number, positive and finite")
