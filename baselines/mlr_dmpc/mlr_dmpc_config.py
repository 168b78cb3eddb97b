"""What MLR-DMPC is tuned by: times, bounds, distances and weights.

Defaults are those published, unless a field says otherwise; `MlrDmpcConfig.published()` has all as
published, and with `recovery="paper"` a swarm is the paper's.
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

Corner = tuple[float, float, float]  # A point, by axis: x, y, z
_MOST_TURNED = 4
_MOST_SAMPLES = 1000
"""Samples of a round: matrices of the optimisation have a row for each in the horizon."""


@dataclass(frozen=True, kw_only=True)
class MlrDmpcConfig:
    """Parameters of the optimisation (Sec. 4.2.3, Appendix B) and of its rounds (Sec. 3.1).

    Raises:
        ValueError: a value is out of range, or a time is no multiple of what it is sampled by.
    """

    round_s: float = 0.2
    """Duration of a round (T), s."""
    horizon_rounds: int = 15
    """Rounds that a plan covers (H); it ends at rest."""
    input_sampling_s: float = 0.2
    """For how long each jerk lasts (T_s), s."""
    state_sampling_s: float = 0.2
    """Between the instants at which bounds of the state hold (T_b), s."""
    collision_sampling_s: float = 0.025
    """Between the instants at which plans are checked for distance (T_c), s. Public simulation:
    0.1, which would ask for 0.14 m more at samples; see `between_samples`."""
    position_weight: float = 1.0
    """Of the squared distance to the target at the end of the plan, 1/m^2."""
    path_weight: float = 0.3
    """Of the squared distance to the target on the way there, at each input sample, 1/m^2. The
    published simulation has 0 (eq. (13) a sum), and takes the whole horizon for the last metre."""
    velocity_weight: float = 1e-4
    """Of the squared velocity, at each input sample."""
    acceleration_weight: float = 0.005
    """Of the squared acceleration, at each input sample."""
    jerk_weight: float = 0.001
    """Of the squared jerk, at each input sample."""
    speed_limit: float = 2.0
    """By axis, m/s."""
    acceleration_limit: float = 5.0
    """By axis, m/s^2."""
    jerk_limit: float = 5.0
    """By axis, m/s^3."""
    box: tuple[Corner, Corner] = ((-2.0, -2.0, 0.3), (2.0, 2.0, 3.0))
    """Lower and upper corner of where drones may fly, m."""
    distance_m: float = 0.25
    """Least scaled distance between references, m."""
    between_samples: bool = True
    """True to keep that distance at any time, by a greater one at the samples (24). Published:
    False, at the samples alone."""
    scaling: tuple[float, float, float] = (1.0, 1.0, 6.0)
    """Diagonal of Theta: distances are divided by it, so drones stay further off vertically."""
    soft_m: float = 0.7
    """Largest soft margin (epsilon) at the end of a plan, m. Public simulation: 0.3; with it,
    sixteen drones take half as long again to change places on a circle."""
    soft_weight: float = 0.5
    """Weight of a neighbour straight ahead or behind."""
    soft_turn: float = 2.0
    """A neighbour at angle phi to the left weighs exp(soft_turn sin phi) as much."""
    soft_near_m: float = 1.2
    """Closer to the target than this, m, soft margins weigh next to nothing. Public simulation:
    0.8, too near for the larger margins: they would hold a drone off its target."""
    soft_near_factor: float = 1e-7
    """What they weigh there, as a share."""
    deadlock_speed: float = 0.15
    """A faster drone is in no deadlock, m/s."""
    deadlock_m: float = 0.1
    """Nor is one whose plan ends this near its target, m."""
    contact_factor: float = 1.1
    """Drones within this many times `sampled_distance_m` touch."""
    deadlock_residual: float = 0.1
    """Share of the pull to the target that contacts need not balance."""
    detour_range_m: float = 0.6
    """Nearer than this, m, drones make room for one in a deadlock."""
    detour_step_m: float = 0.5
    """How far they go, m."""
    detour_noise_m: float = 0.1
    """Standard deviation of where to, by axis, m."""
    detour_rounds: int = 10
    """For how many rounds they make room."""
    detour_pause_rounds: int = 5
    """For how many more rounds they then continue."""
    planes: Literal["fixed", "relinearised"] = "relinearised"
    """Where a plan keeps clear of drones that are not planned in the same round: `relinearised`
    around its own solution, again until that stays (Lemma L3 asks for the distance alone), or
    `fixed` behind planes between what both fly, as published. The former arrives sooner, but takes
    longer to solve, and what is lost stops more plans: no promise holds (Lemma L9)."""
    turn_rad: float = 0.4
    """By how much planes between drones that are apart enough are turned, counter-clockwise as seen
    from above, rad: two that meet head on then pass on the right. This is for two drones; see
    `for_swarm`. Published: 0."""
    turn_share: float = 0.5
    """Nor by more than this share of the angle at which the gap along the normal would be too
    small; below 1."""
    trigger: Literal["WT", "HT", "RR", "DT"] = "WT"
    """Which drones are planned next (Appendix A): by their age since the last plan, `RR` (A1); by
    their distance from the target, `DT` (A2); by the product, `HT` (A3), as published; or `WT`, the
    product in which ages count four rounds more."""
    measure: Literal["end", "next"] = "end"
    """That distance is the one from the `end` of the newest trajectory, as in the public code, or
    from the position when the `next` round begins, t(k+1); (A2) and (A3), read literally, have
    t(k)."""
    arrival_m: float = 0.05
    """A drone has arrived when it is this close to its target, m."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
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
        """Return the method of the paper with the parameters of its public simulation.

        That is fixed planes, the trigger HT, and (A2) and (A3) by positions. The text gives only
        0.25 m and rounds of 0.2 s; (13a) sums the distance to the target, the simulation has its
        last term alone.

        Args:
            **others: parameters that differ, such as `trigger="RR"`.
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
        """The parameters with which N drones fly: planes are turned by (2 / N)^2 of `turn_rad`.

        In a large swarm nothing is so symmetric as to stay stuck, and the turn costs time. With
        relinearised planes that is so for more than four drones, which are not turned at all.
        """
        share = min(1.0, 2.0 / max(num_drones, 1)) ** 2
        if self.planes == "relinearised" and num_drones > _MOST_TURNED:
            share = 0.0
        return replace(self, turn_rad=self.turn_rad * share)

    @property
    def num_inputs(self) -> int:
        """Jerks of a plan (h_s)."""
        return round(self.horizon_rounds * self.round_s / self.input_sampling_s)

    @property
    def num_states(self) -> int:
        """Instants at which bounds of the state hold (h_b)."""
        return round(self.horizon_rounds * self.round_s / self.state_sampling_s)

    @property
    def num_samples(self) -> int:
        """Instants at which distances are kept (h_c): T_c, 2 T_c, ... to the end of the plan."""
        return round(self.horizon_rounds * self.round_s / self.collision_sampling_s)

    @property
    def samples_per_round(self) -> int:
        """By how many collision samples a plan is older after a round."""
        return round(self.round_s / self.collision_sampling_s)

    @cached_property
    def sampled_distance_m(self) -> float:
        """The scaled distance that is kept at samples (d_hat_min), m.

        With `between_samples` it is so great that `distance_m` is kept between them too, (24).

        For the scaled difference r of two references, let V and A bound |r'| and |r''|. Between two
        samples, T_c apart, r is at most A T_c^2 / 8 off its chord, which is at most V T_c long. A
        chord of that length whose ends keep the distance h keeps sqrt(h^2 - (V T_c / 2)^2).

        Bounds hold at state samples, T_b apart. Between them a speed exceeds its own by at most
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
        """(3,) diagonal of the inverse of Theta."""
        return 1.0 / np.array(self.scaling)
