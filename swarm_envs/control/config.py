"""Configuration of the tracking controller: gains, filters, limits, feed-forward, adaptation."""

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
"""Default of `velocity_integral_limit`, m: 9 % of the weight, three standard deviations of the
errors in the world `"hall"` (for a large drone a force of 2.7 % and 1.4 % of its thrust)."""

STEP = 1.0 / 240.0  # Duration of a controller step, which is a physics step, s


@dataclass(frozen=True)
class PositionGains:
    """Gains of the position loop, 1/s, the same in x, y and z (Neural-Swarm2, eqs. 18 and 19).

    Raises:
        ValueError: a gain is not positive and finite; the message names the gain.
    """

    position: float
    """Lambda_p: desired velocity per position error."""
    velocity: float
    """K_v / m: acceleration per velocity error."""
    integral: float
    """Gamma_v: rate at which the velocity error is integrated."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("position", "velocity", "integral"):
            check_number(name, getattr(self, name), above=0.0)


SOFT = PositionGains(position=1.0, velocity=2.0, integral=0.5)
"""Slow and smooth tracking, which tolerates noisy positions."""
MID = PositionGains(position=1.5, velocity=2.5, integral=0.5)
"""The default: the rise time of a step of 10 cm in height is 1.3 s."""
STIFF = PositionGains(position=2.0, velocity=3.0, integral=1.0)
"""Tight tracking, for good state estimates; without lag compensation it oscillates laterally."""

GAINS: dict[str, PositionGains] = {"soft": SOFT, "mid": MID, "stiff": STIFF}
"""The presets by name."""

LOW_PASS, LAST_LAYER = 1, 2
"""Kinds of adaptation in kernels; 0 is none."""
_FASTEST_HZ = 20.0  # Largest bandwidth of adaptation; see docs/adaptation.md


@dataclass(frozen=True)
class MomentumObserver:
    """Adaptation by a momentum observer of unmodeled forces.

    De Luca and Mattone (ICRA 2003); Tomic et al. (IEEE Trans. Robotics 33(6), 2017). The estimate
    is a first-order low-pass of the force that velocity and nominal thrust imply. It passes white
    noise of the velocity at all frequencies: for a noise of 1 cm/s, use `Indi`.

    Raises:
        ValueError: the bandwidth is out of its range; docs/adaptation.md gives the reason.
    """

    bandwidth_hz: float = 3.0
    """Bandwidth (-3 dB) of the estimate, Hz."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("bandwidth_hz", self.bandwidth_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """Return its fields of `swarm_envs.tables.SETTINGS` for steps of dt, s."""
        kept = 1.0 - low_pass_blend(self.bandwidth_hz, dt)
        return {"adaptation": LOW_PASS, "residual_filter": [kept, 0.0, 0.0, 0.0]}


@dataclass(frozen=True)
class Indi:
    """Adaptation by incremental nonlinear dynamic inversion (INDI) of the velocity dynamics.

    Smeur et al. (Control Engineering Practice 73, 2018); Tal and Karaman (IEEE Trans. Control
    Systems Technology 29(3), 2021). Acceleration and nominal thrust pass the same second-order
    Butterworth low-pass, and their difference is compensated. A `feedforward` force is subtracted
    from the difference and compensated at once, as in the hybrid method of Cobo-Briesewitz et al.
    (L4DC 2026). The acceleration is the difference of successive velocities, and the thrust is that
    of nominal motors: neither an accelerometer nor a tachometer is simulated.

    Raises:
        ValueError: the cut-off is out of its range; docs/adaptation.md gives the reason.
    """

    cutoff_hz: float = 4.0
    """Cut-off (-3 dB) of the low-pass, Hz."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("cutoff_hz", self.cutoff_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """Return its fields of `swarm_envs.tables.SETTINGS` for steps of dt, s."""
        return {"adaptation": LOW_PASS, "residual_filter": butterworth(self.cutoff_hz, dt)}


@dataclass(frozen=True)
class NeuralFly:
    """Adaptation of the last layer, as in Neural-Fly (O'Connell et al., Science Robotics, 2022).

    In each axis the basis has three functions: the force that `feedforward` predicts, over the
    nominal mass; the velocity; and 1. The coefficients, which are a correction factor of the model,
    a drag and a constant, are updated by prediction and tracking errors, with the gain of a Kalman
    filter.

    Raises:
        ValueError: a number is negative or not finite, or the noise is zero.
    """

    measurement_noise: float = 0.1
    """Square root of R, m/s^2 per sqrt(Hz): the noise of measured accelerations."""
    force_drift: float = 2.0
    """Square root of Q of the constant, m/s^2 per sqrt(s). Its ratio to `measurement_noise` is the
    bandwidth of the constant, rad/s."""
    scale_drift: float = 0.5
    """Square root of Q of the model's correction factor, 1 per sqrt(s)."""
    drag_drift: float = 0.5
    """Square root of Q of the drag, 1/s per sqrt(s)."""
    forgetting_rate: float = 0.1
    """Lambda, 1/s: rate at which coefficients decay to zero without measurements. It bounds their
    covariance in hover, where neither the model's factor nor the drag is observable."""
    cutoff_hz: float = 10.0
    """Cut-off of the second-order Butterworth low-pass of measured accelerations, Hz."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("measurement_noise", "forgetting_rate"):
            check_number(name, getattr(self, name), above=0.0)
        for name in ("force_drift", "scale_drift", "drag_drift"):
            check_number(name, getattr(self, name), at_least=0.0)
        check_number("cutoff_hz", self.cutoff_hz, above=0.0, at_most=_FASTEST_HZ, unit="Hz")

    def over(self, dt: float) -> dict[str, object]:
        """Return its fields of `swarm_envs.tables.SETTINGS` for steps of dt, s."""
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

    Attitude gains differ between `tilt`, for roll and pitch, and `yaw`, whose torque is small.
    Without `lag_compensation`, both lead terms of eq. (22) are left out.

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
    """True to compensate the motor lag, eq. (22)."""
    adaptation: MomentumObserver | Indi | NeuralFly | None = None
    """The estimator of the force that `feedforward` does not explain, which is then compensated
    too; None for none."""

    attitude_tilt: float = 20.0
    """Lambda_q in roll and pitch, 1/s: desired rate per error quaternion's vector part."""
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
    """Largest |integral of the velocity error| per axis, m (anti-windup). The integral contributes
    a force of at most (K_v / m) Gamma_v m limit: with the default gains 3.0 g for a small drone and
    6.0 g for a large one, enough for the errors of mass and thrust in the world `"hall"`."""
    rate_integral_limit: float = 0.2
    """Largest |integral of the body-rate error| per axis, rad (anti-windup)."""
    min_vertical_thrust_fraction: float = 0.2
    """Lower limit of the vertical component of the desired force, as a fraction of the weight."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
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
    """Return the weight of a new sample in a first-order low-pass, for a step, s."""
    return -math.expm1(-2.0 * math.pi * cutoff_hz * step)


def butterworth(cutoff_hz: float, step: float) -> list[float]:
    """Return the transition matrix of a second-order Butterworth low-pass over a step, s.

    It is (a, b, c, d) with x - u <- a (x - u) + b x' and x' <- c (x - u) + d x', exact for a
    constant input u; b is in s, c in 1/s.
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
"""Fields that are copied to the settings."""


def gains(config: ControllerConfig, dt: float = STEP) -> dict[str, object]:
    """Return the fields of `swarm_envs.tables.SETTINGS` of a configuration, for steps of dt, s.

    Raises:
        ValueError: dt is not positive and finite.
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
