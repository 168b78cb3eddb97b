"""Configuration of the tracking controller: gains, filters, limits, and feed-forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarm_envs.errors import check_bool, check_number, check_type

if TYPE_CHECKING:
    from swarm_envs.interactions.base import ForceFunction, InteractionModel

__all__ = [
    "GAINS",
    "MID",
    "STIFF",
    "ControllerConfig",
    "Indi",
    "MomentumObserver",
    "NeuralFly",
    "PositionGains",
    "gains",
]

INTEGRAL_LIMIT = 0.7
"""Default of `velocity_integral_limit`, m: 9 % of the weight, three standard deviations of what a
drone in the world `"hall"` cannot know (of a large one 2.7 % as a force, 1.4 % of its thrust)."""

STEP = 1.0 / 240.0  # Length of one controller step, which is one physics step, s


@dataclass(frozen=True)
class PositionGains:
    """Gains of the position loop, 1/s, the same in x, y and z (Neural-Swarm2, eqs. 18 and 19).

    Raises:
        ValueError: a gain is not positive and finite; its message names the gain.
    """

    position: float
    """Lambda_p: velocity asked for per metre of position error."""
    velocity: float
    """K_v / m: acceleration per velocity error."""
    integral: float
    """Gamma_v: rate at which the velocity error is integrated."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for name in ("position", "velocity", "integral"):
            check_number(name, getattr(self, name), above=0.0)


SOFT = PositionGains(position=1.0, velocity=2.0, integral=0.5)
"""Slow and smooth: tolerates noisy positions."""
MID = PositionGains(position=1.5, velocity=2.5, integral=0.5)
"""The default: a step of 10 cm in height rises in 1.3 s."""
STIFF = PositionGains(position=2.0, velocity=3.0, integral=1.0)
"""Tight tracking, for good state estimates; without lag compensation it oscillates sideways."""

GAINS: dict[str, PositionGains] = {"soft": SOFT, "mid": MID, "stiff": STIFF}
"""The presets by name."""


LOW_PASS, LAST_LAYER = 1, 2
"""Kinds of adaptation, as kernels tell them apart; 0 is none."""
_FASTEST_HZ = 20.0  # The highest frequency that adaptation follows; see docs/adaptation.md


@dataclass(frozen=True)
class MomentumObserver:
    """Adaptation by a momentum observer of the force that the controller does not know.

    De Luca and Mattone (ICRA 2003); Tomic et al. (IEEE Trans. Robotics 33(6), 2017). The force
    follows what velocity and nominal thrust leave over, through a first-order low-pass. That passes
    white noise of the velocity on at all frequencies: where there is 1 cm/s of it, take `Indi`.

    Raises:
        ValueError: the bandwidth is out of its range; see docs/adaptation.md for its reason.
    """

    bandwidth_hz: float = 3.0
    """Frequency at which the estimate has fallen by 3 dB, Hz."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("bandwidth_hz", self.bandwidth_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """The fields of `swarm_envs.tables.SETTINGS` that it gives, for steps of dt, s."""
        kept = 1.0 - low_pass_blend(self.bandwidth_hz, dt)
        return {"adaptation": LOW_PASS, "residual_filter": [kept, 0.0, 0.0, 0.0]}


@dataclass(frozen=True)
class Indi:
    """Adaptation by incremental nonlinear dynamic inversion (INDI) of the velocity's dynamics.

    Smeur et al. (Control Engineering Practice 73, 2018); Tal and Karaman (IEEE Trans. Control
    Systems Technology 29(3), 2021). Acceleration and nominal thrust pass the same second-order
    Butterworth low-pass; what they differ by is compensated. With a `feedforward`, that is left
    out of the difference and compensated at once: learned INDI, as the hybrid method of
    Cobo-Briesewitz et al. (L4DC 2026). The acceleration is the difference of successive velocities,
    and the thrust is that of nominal motors: there is neither an accelerometer nor a tachometer.

    Raises:
        ValueError: the cut-off is out of its range; see docs/adaptation.md for its reason.
    """

    cutoff_hz: float = 4.0
    """Frequency at which the low-pass has fallen by 3 dB, Hz."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("cutoff_hz", self.cutoff_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """The fields of `swarm_envs.tables.SETTINGS` that it gives, for steps of dt, s."""
        return {"adaptation": LOW_PASS, "residual_filter": butterworth(self.cutoff_hz, dt)}


@dataclass(frozen=True)
class NeuralFly:
    """Adaptation of the last layer, as in Neural-Fly (O'Connell et al., Science Robotics, 2022).

    In each axis the basis has three functions: the force that `feedforward` predicts there, over
    the nominal mass; the velocity; and 1. So what is learned in flight is by how much the model is
    too weak or too strong, a drag, and a constant. Their coefficients follow errors of prediction
    and of tracking, with the gain of a Kalman filter.

    Raises:
        ValueError: a number is negative or not finite, or the noise is zero.
    """

    measurement_noise: float = 0.1
    """Square root of R, m/s^2 per sqrt(Hz): noise of the accelerations that are learned from."""
    force_drift: float = 2.0
    """Square root of Q of the constant, m/s^2 per sqrt(s). Over `measurement_noise` it is the
    bandwidth of the constant, rad/s."""
    scale_drift: float = 0.5
    """The same of the factor of the model's force, 1 per sqrt(s)."""
    drag_drift: float = 0.5
    """The same of the drag, 1/s per sqrt(s)."""
    forgetting_rate: float = 0.1
    """Lambda, 1/s: how fast coefficients return to zero where nothing is learned. Were it zero,
    their covariance would grow for ever in hover, where neither model nor drag can be seen."""
    cutoff_hz: float = 10.0
    """Cut-off of the second-order Butterworth low-pass of what is learned from, Hz."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for name in ("measurement_noise", "forgetting_rate"):
            check_number(name, getattr(self, name), above=0.0)
        for name in ("force_drift", "scale_drift", "drag_drift"):
            check_number(name, getattr(self, name), at_least=0.0)
        check_number("cutoff_hz", self.cutoff_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """The fields of `swarm_envs.tables.SETTINGS` that it gives, for steps of dt, s."""
        drifts = (self.scale_drift, self.drag_drift, self.force_drift)
        return {
            "adaptation": LAST_LAYER,
            "residual_filter": butterworth(self.cutoff_hz, dt),
            "adaptive_kept": math.exp(-self.forgetting_rate * dt),
            "adaptive_drift": [drift * drift * dt for drift in drifts],
            "adaptive_noise": self.measurement_noise**2 / dt,
        }


@dataclass(frozen=True)
class ControllerConfig:
    """Configuration of the tracking controller of Neural-Swarm2, Sec. VI.

    Attitude gains come in two parts: `tilt` for roll and pitch, `yaw` for the weak axis, whose
    torque is small. With `lag_compensation` off, both lead terms of eq. (22) are left out.

    Raises:
        ValueError: a number is not positive and finite, a fraction is not below one, or the gains
            are not `PositionGains`.
        TypeError: the feedforward is no model.
    """

    gains: PositionGains = MID
    """Gains of the position loop, eqs. (18) and (19)."""
    feedforward: InteractionModel | ForceFunction | None = None
    """The interaction model, or the function of positions, velocities and types (see
    `swarm_envs.interactions.load`), whose forces the controller compensates; None for no
    compensation. Functions are called at the environment's `force_rate`, with the true state."""
    lag_compensation: bool = True
    """Whether the motors' lag is compensated, eq. (22)."""
    adaptation: MomentumObserver | Indi | NeuralFly | None = None
    """What estimates the force that `feedforward` does not explain, and compensates it as well;
    None for nothing."""

    attitude_tilt: float = 20.0
    """Lambda_q in roll and pitch, 1/s: rate asked for per unit of the error quaternion's vector."""
    attitude_yaw: float = 6.0
    """Lambda_q in yaw, 1/s."""
    rate_tilt: float = 25.0
    """K_omega / J in roll and pitch, 1/s."""
    rate_yaw: float = 6.0
    """K_omega / J in yaw, 1/s."""
    rate_integral_tilt: float = 20.0
    """Gamma_omega / J in roll and pitch, 1/s^2."""
    rate_integral_yaw: float = 6.0
    """Gamma_omega / J in yaw, 1/s^2."""

    thrust_rate_cutoff_hz: float = 20.0
    """Cut-off of the low-pass on the derivative of the desired thrust, Hz."""
    rate_error_cutoff_hz: float = 40.0
    """Cut-off of the low-pass on the derivative of the body-rate error, Hz."""
    desired_rate_cutoff_hz: float = 10.0
    """Cut-off of the low-pass on the desired body rate, Hz."""

    velocity_integral_limit: float = INTEGRAL_LIMIT
    """Largest |integral of the velocity error| per axis, m: anti-windup. It gives at most
    (K_v / m) Gamma_v m limit of force: with the default gains 3.0 g for a small drone and 6.0 g for
    a large one, which holds the errors of mass and thrust of the world `"hall"`."""
    rate_integral_limit: float = 0.2
    """Largest |integral of the body-rate error| per axis, rad: anti-windup."""
    min_vertical_thrust_fraction: float = 0.2
    """Lower limit of the desired force's vertical part, as a fraction of the weight: a drone that
    may never pull less than its weight cannot descend."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_type("gains", self.gains, PositionGains)
        check_bool("lag_compensation", self.lag_compensation)
        check_type("adaptation", self.adaptation, MomentumObserver | Indi | NeuralFly | None)
        for name in (
            "attitude_tilt",
            "attitude_yaw",
            "rate_tilt",
            "rate_yaw",
            "rate_integral_tilt",
            "rate_integral_yaw",
            "thrust_rate_cutoff_hz",
            "rate_error_cutoff_hz",
            "desired_rate_cutoff_hz",
            "velocity_integral_limit",
            "rate_integral_limit",
        ):
            check_number(name, getattr(self, name), above=0.0)
        check_number(
            "min_vertical_thrust_fraction", self.min_vertical_thrust_fraction, above=0.0, below=1.0
        )
        model = self.feedforward
        is_model = callable(model) or callable(getattr(model, "forces", None))
        if model is not None and not is_model:
            raise TypeError(
                f"feedforward is {model!r:.80}, but must be an InteractionModel, such "
                "as load('learned'), a function, or None"
            )


def low_pass_blend(cutoff_hz: float, step: float) -> float:
    """Share of a sample held for a step, s, in a first-order low-pass (3 dB at the cut-off, Hz)."""
    return -math.expm1(-2.0 * math.pi * cutoff_hz * step)


def butterworth(cutoff_hz: float, step: float) -> list[float]:
    """Transition over a step of a second-order Butterworth low-pass, exact for a held input u.

    Returns (a, b, c, d) with x - u <- a (x - u) + b x' and x' <- c (x - u) + d x'; b in s, c in
    1/s.
    """
    half = math.pi * math.sqrt(2.0) * cutoff_hz  # both poles are half (-1 +- i), in 1/s
    decay, cos, sin = math.exp(-half * step), math.cos(half * step), math.sin(half * step)
    return [decay * (cos + sin), decay * sin / half, -2.0 * half * decay * sin, decay * (cos - sin)]


_SAME = (
    "attitude_tilt",
    "attitude_yaw",
    "rate_tilt",
    "rate_yaw",
    "rate_integral_tilt",
    "rate_integral_yaw",
    "velocity_integral_limit",
    "rate_integral_limit",
    "min_vertical_thrust_fraction",
)
"""Fields that go into the settings as they are."""


def gains(config: ControllerConfig, dt: float = STEP) -> dict[str, object]:
    """The fields of `swarm_envs.tables.SETTINGS` that a configuration gives, for a step of dt.

    Raises:
        ValueError: dt, in s, is not positive and finite.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise ValueError(f"dt is {dt!r} s, but must be positive and finite")
    return {
        **{name: float(getattr(config, name)) for name in _SAME},
        "step": float(dt),
        "position_gain": float(config.gains.position),
        "velocity_gain": float(config.gains.velocity),
        "integral_gain": float(config.gains.integral),
        "thrust_rate_blend": low_pass_blend(config.thrust_rate_cutoff_hz, dt),
        "rate_error_blend": low_pass_blend(config.rate_error_cutoff_hz, dt),
        "desired_rate_blend": low_pass_blend(config.desired_rate_cutoff_hz, dt),
        "lead": 1.0 if config.lag_compensation else 0.0,
        **({} if config.adaptation is None else config.adaptation.over(dt)),
    }
