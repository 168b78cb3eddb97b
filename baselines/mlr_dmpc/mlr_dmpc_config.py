"""The parameters of MLR-DMPC: times, bounds, distances and weights.

The defaults are the published values unless a field states otherwise. `MlrDmpcConfig.published()`
has all published values; with `recovery="paper"` they give the method of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from swarm_envs.errors import (
    check_array,
    check_bool,
    check_integer,
    check_name,
    check_number,
    check_numbers,
)
from swarm_envs.state import FloatArray

__all__ = ["MlrDmpcConfig"]

Corner = tuple[float, float, float]  # x, y, z, m
_MOST_TURNED = 4
_MOST_SAMPLES = 1000
"""The largest number of samples per round: each adds a row to matrices of the optimization."""


@dataclass(frozen=True, kw_only=True)
class MlrDmpcConfig:
    """The parameters of the optimization (Sec. 4.2.3, Appendix B) and of its rounds (Sec. 3.1).

    Raises:
        ValueError: A value is out of range, or a sampling time does not divide a round.
    """

    round_s: float = 0.2
    """The duration of a round (T), s."""
    horizon_rounds: int = 15
    """The number of rounds that a plan covers (H); it ends at rest."""
    input_sampling_s: float = 0.2
    """The duration of each jerk (T_s), s."""
    state_sampling_s: float = 0.2
    """The time between the instants at which bounds of the state hold (T_b), s."""
    collision_sampling_s: float = 0.025
    """The time between the instants at which the distance of plans is checked (T_c), s. The public
    simulation has 0.1, which would require 0.14 m more at samples; see `between_samples`."""
    position_weight: float = 1.0
    """The weight of the squared distance to the target at the end of the plan, 1/m^2."""
    path_weight: float = 0.3
    """The weight of the squared distance to the target at each input sample, 1/m^2. The public
    simulation has 0 (eq. (13) has a sum) and needs the whole horizon for the last meter."""
    velocity_weight: float = 1e-4
    """The weight of the squared velocity at each input sample."""
    acceleration_weight: float = 0.005
    """The weight of the squared acceleration at each input sample."""
    jerk_weight: float = 0.001
    """The weight of the squared jerk at each input sample."""
    speed_limit: float = 2.0
    """The largest speed along an axis, m/s."""
    acceleration_limit: float = 5.0
    """The largest acceleration along an axis, m/s^2."""
    jerk_limit: float = 5.0
    """The largest jerk along an axis, m/s^3."""
    box: tuple[Corner, Corner] = ((-2.0, -2.0, 0.3), (2.0, 2.0, 3.0))
    """The lower and upper corner of the box in which drones may fly, m."""
    distance_m: float = 0.25
    """The least scaled distance between references, m."""
    between_samples: bool = True
    """True to keep that distance at any time, by a greater one at the samples, (24); False to keep
    it at the samples alone, as published."""
    scaling: tuple[float, float, float] = (1.0, 1.0, 6.0)
    """The diagonal of Theta, which divides offsets: drones keep a greater vertical distance."""
    soft_m: float = 0.7
    """The largest soft margin (epsilon) at the end of a plan, m. The public simulation has 0.3;
    with it, sixteen drones take half as long again to swap positions on a circle."""
    soft_weight: float = 0.5
    """The weight of a neighbor straight ahead or behind."""
    soft_turn: float = 2.0
    """A neighbor at angle phi to the left has exp(soft_turn sin phi) times that weight."""
    soft_near_m: float = 1.2
    """The distance from the target, m, below which soft margins have next to no weight. The public
    simulation has 0.8, with which the larger margins would hold a drone off its target."""
    soft_near_factor: float = 1e-7
    """The factor of the weights below that distance."""
    deadlock_speed: float = 0.15
    """The speed above which a drone is in no deadlock, m/s."""
    deadlock_m: float = 0.1
    """A drone whose plan ends within this distance of its target is in no deadlock, m."""
    contact_factor: float = 1.1
    """Drones are in contact within this many times `sampled_distance_m`."""
    deadlock_residual: float = 0.1
    """The share of the pull to the target that contacts need not balance."""
    detour_range_m: float = 0.6
    """The distance within which drones make room for one in a deadlock, m."""
    detour_step_m: float = 0.5
    """The length of such a detour, m."""
    detour_noise_m: float = 0.1
    """The standard deviation of the end of a detour, by axis, m."""
    detour_rounds: int = 10
    """The number of rounds for which a drone makes room."""
    detour_pause_rounds: int = 5
    """The number of rounds after a detour before the next can begin."""
    planes: Literal["fixed", "relinearised"] = "relinearised"
    """The planes that separate a plan from drones that are not planned in the same round: `fixed`
    between the present trajectories, as published, or `relinearised` around the solution until it
    no longer changes (Lemma L3 needs the distance alone). Drones arrive sooner with the latter, but
    it takes longer to solve, and lost messages prevent more plans, as no guarantee holds
    (Lemma L9)."""
    turn_rad: float = 0.4
    """The angle by which planes between drones that are far enough apart are turned,
    counter-clockwise as seen from above, rad: two drones that approach head-on then pass on the
    right. The value is for two drones; see `for_swarm`. Published: 0."""
    turn_share: float = 0.5
    """The largest turn, as a share (below 1) of the angle at which the gap along the normal would
    be too small."""
    trigger: Literal["WT", "HT", "RR", "DT"] = "WT"
    """The event trigger (Appendix A), by which drones are planned next: by their age since the last
    plan, `RR` (A1); by their distance from the target, `DT` (A2); by the product, `HT` (A3), as
    published; or `WT`, the product in which ages count four rounds more."""
    measure: Literal["end", "next"] = "end"
    """The point from which that distance is measured: the `end` of the newest trajectory, as in the
    public code, or the position when the `next` round begins, t(k+1); (A2) and (A3), read
    literally, have t(k)."""
    arrival_m: float = 0.05
    """The distance from its target within which a drone has arrived, m."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("round_s", "input_sampling_s", "state_sampling_s", "collision_sampling_s"):
            check_number(name, getattr(self, name), above=0.0, unit="s")
        check_integer("horizon_rounds", self.horizon_rounds, at_least=3)
        for name in (
            "position_weight",
            "jerk_weight",
            "speed_limit",
            "acceleration_limit",
            "jerk_limit",
            "deadlock_speed",
        ):
            check_number(name, getattr(self, name), above=0.0)
        for name in (
            "path_weight",
            "velocity_weight",
            "acceleration_weight",
            "soft_m",
            "soft_weight",
            "soft_turn",
            "soft_near_m",
            "soft_near_factor",
            "deadlock_m",
            "deadlock_residual",
            "detour_noise_m",
            "turn_rad",
        ):
            check_number(name, getattr(self, name), at_least=0.0)
        for name in ("distance_m", "detour_range_m", "detour_step_m", "arrival_m"):
            check_number(name, getattr(self, name), above=0.0, unit="m")
        check_number("contact_factor", self.contact_factor, at_least=1.0)
        check_integer("detour_rounds", self.detour_rounds, at_least=1)
        check_integer("detour_pause_rounds", self.detour_pause_rounds, at_least=0)
        check_name("planes", self.planes, ("fixed", "relinearised"))
        check_name("trigger", self.trigger, ("WT", "HT", "RR", "DT"))
        check_name("measure", self.measure, ("end", "next"))
        check_bool("between_samples", self.between_samples)
        check_number("turn_share", self.turn_share, at_least=0.0, below=1.0)
        for name in ("input_sampling_s", "state_sampling_s", "collision_sampling_s"):
            ratio = self.round_s / getattr(self, name)
            count = round(min(ratio, 2.0 * _MOST_SAMPLES))
            if abs(ratio - count) > 1e-9 or not 1 <= count <= _MOST_SAMPLES:
                raise ValueError(
                    f"{name} is {getattr(self, name)!r} s, but must divide round_s, "
                    f"{self.round_s!r} s, into at most {_MOST_SAMPLES} parts"
                )
        check_numbers("scaling", self.scaling, 3, above=0.0)
        lower, upper = check_array("box", self.box, (2, 3))
        if not (lower < upper).all():
            raise ValueError(f"box is {self.box}, but its corners must be lower and upper")

    @classmethod
    def published(cls, **others: Any) -> MlrDmpcConfig:
        """Return the parameters of the paper and its public simulation.

        They have fixed planes, the trigger HT, and (A2) and (A3) by positions. The text gives only
        0.25 m and rounds of 0.2 s. (13a) sums the distance to the target; the simulation has its
        last term alone.

        Args:
            **others: Parameters that differ, such as `trigger="RR"`.
        """
        paper: dict[str, Any] = {
            "collision_sampling_s": 0.1,
            "between_samples": False,
            "path_weight": 0.0,
            "soft_m": 0.3,
            "soft_near_m": 0.8,
            "planes": "fixed",
            "turn_rad": 0.0,
            "trigger": "HT",
            "measure": "next",
        }
        return cls(**{**paper, **others})

    def for_swarm(self, num_drones: int) -> MlrDmpcConfig:
        """Return the parameters for N drones, whose planes are turned by (2 / N)^2 of `turn_rad`.

        Large swarms are not symmetric enough to stay in a deadlock, and the turn costs time.
        Relinearized planes are therefore not turned for more than four drones.
        """
        share = min(1.0, 2.0 / max(num_drones, 1)) ** 2
        if self.planes == "relinearised" and num_drones > _MOST_TURNED:
            share = 0.0
        return replace(self, turn_rad=self.turn_rad * share)

    @property
    def num_inputs(self) -> int:
        """The number of jerks of a plan (h_s)."""
        return round(self.horizon_rounds * self.round_s / self.input_sampling_s)

    @property
    def num_states(self) -> int:
        """The number of instants at which bounds of the state hold (h_b)."""
        return round(self.horizon_rounds * self.round_s / self.state_sampling_s)

    @property
    def num_samples(self) -> int:
        """The number of collision samples (h_c): T_c, 2 T_c, ... to the end of the plan."""
        return round(self.horizon_rounds * self.round_s / self.collision_sampling_s)

    @property
    def samples_per_round(self) -> int:
        """The number of collision samples per round."""
        return round(self.round_s / self.collision_sampling_s)

    @cached_property
    def sampled_distance_m(self) -> float:
        """The scaled distance that is kept at samples (d_hat_min), m.

        With `between_samples` it is large enough to keep `distance_m` between them too, (24).

        Let V and A bound |r'| and |r''| of the scaled difference r of two references. Between two
        samples, T_c apart, r deviates by at most A T_c^2 / 8 from its chord, which is at most V T_c
        long. A chord of that length whose ends keep the distance h keeps sqrt(h^2 - (V T_c / 2)^2).

        Bounds hold at state samples, T_b apart. Between them a speed exceeds its bound by at most
        j T_b^2 / 8 and an acceleration by at most j T_b / 2, where j bounds the jerk.
        """
        if not self.between_samples:
            return self.distance_m
        step, gap = self.collision_sampling_s, self.state_sampling_s
        relative = 2.0 * float(np.linalg.norm(self.inverse_scaling))
        speed = relative * (self.speed_limit + self.jerk_limit * gap**2 / 8.0)
        acceleration = relative * (self.acceleration_limit + self.jerk_limit * gap / 2.0)
        least = self.distance_m + acceleration * step**2 / 8.0
        return float(np.hypot(least, speed * step / 2.0))

    @property
    def inverse_scaling(self) -> FloatArray:
        """The diagonal (3,) of the inverse of Theta."""
        return 1.0 / np.array(self.scaling)
