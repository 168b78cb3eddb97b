"""A planning problem and its bounds (eq. 6), checked before planning starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import check_array, check_name, check_number, check_type, unknown_name
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Team, Vehicle, parse_team

__all__ = ["FORCE_BOUNDS_G", "PlanningBounds", "shortest_time"]

FORCE_BOUNDS_G: Mapping[str, float] = MappingProxyType({"S": 5.0, "S*": 5.0, "L": 10.0})
"""f_a,max by vehicle token, grams (Neural-Swarm2, Sec. VII-D, Fig. 6 and 7)."""


@dataclass(frozen=True)
class PlanningBounds:
    """Bounds on every robot's states, controls and forces: the sets X and U of eq. (6).

    Only the vertical component of forces is bounded, as in the paper, whose f_a is vertical: the
    horizontal one is the drone's own drag, which no neighbor's plan changes.

    Raises:
        ValueError: A number is not positive and finite, or the box is empty.
    """

    lower: tuple[float, float, float] = (-2.0, -2.0, 0.2)
    """The lower corner of the box of positions, m."""
    upper: tuple[float, float, float] = (2.0, 2.0, 2.5)
    """The upper corner of the box of positions, m."""
    speed: float = 2.0
    """The largest |v| along each axis, m/s."""
    acceleration: float = 5.0
    """The largest |u| along each axis, m/s^2: thrust per mass, gravity removed (eq. 13)."""
    force_g: Mapping[str, float] = field(default_factory=lambda: FORCE_BOUNDS_G)
    """f_a,max, the largest |f_a,z| by vehicle token, grams."""
    force_change_g: float = 10.0
    """b_fa, the largest change of the force on another robot when one is planned, grams."""
    clearance_factor: float = 1.1
    """The least distance over the sum of the two radii: r(lk) of eq. (6) with room for tracking."""
    goal_distance: float = 0.1
    """The epsilon in position: the distance from the goal at which stage 1 may end, m."""
    goal_speed: float = 0.2
    """The epsilon in velocity: the speed at which stage 1 may end, m/s."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in (
            "speed",
            "acceleration",
            "force_change_g",
            "clearance_factor",
            "goal_distance",
            "goal_speed",
        ):
            check_number(name, getattr(self, name), above=0.0)
        check_type("force_g", self.force_g, Mapping)
        for token, grams in self.force_g.items():
            check_number(f"force_g[{token!r}]", grams, above=0.0)
        low, high = check_array("lower", self.lower, (3,)), check_array("upper", self.upper, (3,))
        if not (low < high).all():
            raise ValueError(
                f"lower is {self.lower} m and upper {self.upper} m, but upper must be larger "
                "along each axis"
            )
        if self.clearance_factor < 1.0:
            raise ValueError(
                f"clearance_factor is {self.clearance_factor}, but must be at least 1: below that, "
                "vehicles collide"
            )

    def force_bounds(self, team: Team) -> FloatArray:
        """Return the largest |f_a,z| (N,) of each vehicle, N.

        Raises:
            ValueError: A vehicle's token has no bound.
        """
        for token in (vehicle.token for vehicle in team):
            if token not in self.force_g:
                where = "in the team, looked up in force_g"
                raise ValueError(unknown_name("vehicle token", token, self.force_g, where))
        return np.array([self.force_g[vehicle.token] for vehicle in team]) * GRAM_FORCE

    def clearances(self, team: Team) -> FloatArray:
        """Return the least distance (N, N) of each pair of vehicles, m; 0 on the diagonal."""
        radii = np.array([vehicle.radius for vehicle in team])
        distances = self.clearance_factor * (radii[:, None] + radii[None, :])
        np.fill_diagonal(distances, 0.0)
        return distances


Plane = Literal["xyz", "yz"]
"""`"xyz"` for motion in space; `"yz"` if each robot keeps the x of its start (Fig. 6 and 7)."""

ROUNDING = 1e-9  # Differences of states up to this, m and m/s, are ignored
_MOST_STEPS = 10_000


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """The starts, goals, vehicles and force model of a team whose motions are planned (eq. 6).

    Positions are in m, in the world frame, z up; every robot is at rest at its start and its goal.
    The force bounds hold for the forces that `model` predicts.

    Raises:
        ValueError: The problem has no solution: a start or goal lies outside the box or in
            collision, cannot be reached in time, or has forces beyond the bounds even when
            hovering there; or a value is out of range.
    """

    starts: FloatArray
    """The start positions (N, 3), m."""
    goals: FloatArray
    """The goal positions (N, 3), m."""
    team: Team
    """The N vehicles, or a string such as `"SSL"`."""
    model: InteractionModel = field(default_factory=lambda: load("learned"))
    """The planner's model of the interaction forces f_a."""
    bounds: PlanningBounds = field(default_factory=PlanningBounds)
    """The bounds of the plan."""
    dt: float = 0.1
    """The time between knots, over which controls are held, s."""
    max_duration: float = 5.0
    """The latest end of the plan t_f, s. Longer flights are cheaper (eq. 6), so plans use it."""
    plane: Plane = "xyz"
    """The plane or space in which robots move."""

    def __post_init__(self) -> None:
        team = parse_team(self.team)
        object.__setattr__(self, "team", team)
        for name in ("starts", "goals"):
            rows = "one row of x, y, z for each drone of the team"
            places = check_array(name, getattr(self, name), (len(team), 3), rows).copy()
            places.flags.writeable = False
            object.__setattr__(self, name, places)
        check_number("dt", self.dt, above=0.0)
        check_number("max_duration", self.max_duration, above=0.0)
        if not 1 <= self.steps <= _MOST_STEPS:
            raise ValueError(
                f"max_duration is {self.max_duration:g} s and dt {self.dt:g} s, which makes "
                f"{self.steps:.3g} steps, but must make 1 to {_MOST_STEPS:,}"
            )
        check_name("plane", self.plane, ("xyz", "yz"))
        self.model.type_indices(team)  # Raises ValueError for a type that the model lacks
        self._check_plane()
        for name, places in (("start", self.starts), ("goal", self.goals)):
            self._check_box(name, places)
            self._check_clearance(name, places)
            self._check_forces(name, places)
        self._check_reachable()

    @property
    def axes(self) -> tuple[int, ...]:
        """Indices of the axes along which robots may move."""
        return (0, 1, 2) if self.plane == "xyz" else (1, 2)

    @property
    def masses(self) -> FloatArray:
        """The masses (N,), kg."""
        return np.array([vehicle.mass for vehicle in self.team])

    @property
    def steps(self) -> int:
        """The largest number of steps of length dt that a plan may have."""
        return int(np.floor(self.max_duration / self.dt + 1e-9))

    def _check_plane(self) -> None:
        moved = np.abs(self.goals[:, 0] - self.starts[:, 0])
        if self.plane == "yz" and moved.max() > ROUNDING:
            i = int(moved.argmax())
            raise ValueError(
                f"drone {i} starts at x = {self.starts[i, 0]:g} m with its goal at "
                f"x = {self.goals[i, 0]:g} m, but plane='yz' keeps x; give both the same x, or "
                "plan with plane='xyz'"
            )

    def _check_box(self, name: str, places: FloatArray) -> None:
        low, high = self.bounds.lower, self.bounds.upper
        outside = ((places < low) | (places > high)).any(axis=1)
        if outside.any():
            i = int(outside.argmax())
            raise ValueError(
                f"the {name} of drone {i} is {places[i].tolist()} m, outside the box from {low} to "
                f"{high} m; move it inside or widen PlanningBounds.lower and upper"
            )

    def _check_clearance(self, name: str, places: FloatArray) -> None:
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        short = self.bounds.clearances(self.team) - apart
        i, j = np.unravel_index(int(short.argmax()), short.shape)
        if short[i, j] > 0.0:
            raise ValueError(
                f"the {name}s of drones {i} and {j} are {apart[i, j]:.3g} m apart, in collision: "
                f"they must be {apart[i, j] + short[i, j]:.3g} m apart; move one of them"
            )

    def _check_forces(self, name: str, places: FloatArray) -> None:
        """Raise ValueError if hovering alone or together exceeds the force bounds."""
        limit = self.bounds.force_bounds(self.team)
        alone = [hover_force(self.model, p[None], [v]) for p, v in zip(places, self.team)]
        together = hover_force(self.model, places, self.team)
        for how, force in (("alone", np.concatenate(alone)), ("with the others", together)):
            excess = np.abs(force) - limit
            i = int(excess.argmax())
            if excess[i] > 0.0:
                token = self.team[i].token
                raise ValueError(
                    f"drone {i} ({token}) hovering {how} at its {name} has a force of "
                    f"{force[i] / GRAM_FORCE:.3g} g, but force_g[{token!r}] allows "
                    f"{limit[i] / GRAM_FORCE:.3g} g; raise the bound or move the {name}"
                )

    def _check_reachable(self) -> None:
        """Raise ValueError if the largest acceleration and allowed force do not suffice."""
        limit = self.bounds.force_bounds(self.team) / self.masses
        distance = np.abs(self.goals - self.starts)
        acceleration = self.bounds.acceleration + limit[:, None]
        times = shortest_time(distance, self.bounds.speed, acceleration)
        i = int(times.max(axis=1).argmax())
        least, given = float(times[i].max()), self.steps * self.dt
        if least > given:
            raise ValueError(
                f"drone {i} cannot reach its goal in max_duration = {self.max_duration:g} s "
                f"({self.steps} steps of {self.dt:g} s): it needs at least {least:.3g} s at "
                f"{self.bounds.speed:g} m/s and {self.bounds.acceleration:g} m/s^2; allow more time"
            )


def shortest_time(
    distance: npt.ArrayLike, speed: npt.ArrayLike, acceleration: npt.ArrayLike
) -> FloatArray:
    """Return the shortest time of a double integrator from rest to rest over a distance, m, s."""
    d, v, a = (np.asarray(x, dtype=np.float64) for x in (distance, speed, acceleration))
    return np.where(d > v * v / a, d / v + v / a, 2.0 * np.sqrt(d / a))


def hover_force(model: InteractionModel, places: FloatArray, team: Sequence[Vehicle]) -> FloatArray:
    """Return the vertical force f_a,z (N,) on drones that all hover at positions (N, 3), m, N."""
    # For a read-only array, numba would compile the forces once more.
    return model.forces(places[None].copy(), np.zeros((1, *places.shape)), team)[0, :, 2]
