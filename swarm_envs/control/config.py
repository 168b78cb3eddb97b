"""Configuration of the tracking controller: gains, filters, limits, and feed-forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from swarm_envs.arguments import POSITIVE, Range, typed

if TYPE_CHECKING:
    from swarm_envs.interactions.base import InteractionModel

__all__ = ["GAINS", "MID", "ControllerConfig", "PositionGains", "gains"]

STEP = 1.0 / 240.0
"""Length of one controller step, which is one physics step, s."""


@typed
@dataclass(frozen=True)
class PositionGains:
    """Gains of the position loop, 1/s, the same in x, y and z (Neural-Swarm2, eqs. 18 and 19).

    Raises:
        ValueError: a gain is not positive and finite; its message names the gain.
    """

    position: Annotated[float, POSITIVE]
    """Lambda_p: velocity asked for per metre of position error."""
    velocity: Annotated[float, POSITIVE]
    """K_v / m: acceleration per velocity error."""
    integral: Annotated[float, POSITIVE]
    """Gamma_v: rate at which the velocity error is integrated."""


SOFT = PositionGains(position=1.0, velocity=2.0, integral=0.5)
"""Slow and smooth: tolerates noisy positions."""
MID = PositionGains(position=1.5, velocity=2.5, integral=0.5)
"""The default: a step of 10 cm in height rises in 1.3 s."""
STIFF = PositionGains(position=2.0, velocity=3.0, integral=1.0)
"""Tight tracking, for good state estimates; without lag compensation it oscillates sideways."""

GAINS: dict[str, PositionGains] = {"soft": SOFT, "mid": MID, "stiff": STIFF}
"""The presets by name."""


@typed
@dataclass(frozen=True)
class ControllerConfig:
    """Configuration of the tracking controller of Neural-Swarm2, Sec. VI.

    Attitude gains come in two parts: `tilt` for roll and pitch, `yaw` for the weak axis, whose
    torque is small. With `lag_compensation` off, both lead terms of eq. (22) are left out.

    Raises:
        ValueError: a number is not positive and finite, or a fraction is not below one.
        TypeError: the gains are not `PositionGains`.
    """

    gains: PositionGains = MID
    """Gains of the position loop, eqs. (18) and (19)."""
    feedforward: InteractionModel | None = None
    """The interaction model whose forces the controller compensates; None for no compensation."""
    lag_compensation: bool = True
    """Whether the motors' lag is compensated, eq. (22)."""

    attitude_tilt: Annotated[float, POSITIVE] = 20.0
    """Lambda_q in roll and pitch, 1/s: rate asked for per unit of the error quaternion's vector."""
    attitude_yaw: Annotated[float, POSITIVE] = 6.0
    """Lambda_q in yaw, 1/s."""
    rate_tilt: Annotated[float, POSITIVE] = 25.0
    """K_omega / J in roll and pitch, 1/s."""
    rate_yaw: Annotated[float, POSITIVE] = 6.0
    """K_omega / J in yaw, 1/s."""
    rate_integral_tilt: Annotated[float, POSITIVE] = 20.0
    """Gamma_omega / J in roll and pitch, 1/s^2."""
    rate_integral_yaw: Annotated[float, POSITIVE] = 6.0
    """Gamma_omega / J in yaw, 1/s^2."""

    thrust_rate_cutoff_hz: Annotated[float, POSITIVE] = 20.0
    """Cut-off of the low-pass on the derivative of the desired thrust, Hz."""
    rate_error_cutoff_hz: Annotated[float, POSITIVE] = 40.0
    """Cut-off of the low-pass on the derivative of the body-rate error, Hz."""
    desired_rate_cutoff_hz: Annotated[float, POSITIVE] = 10.0
    """Cut-off of the low-pass on the desired body rate, Hz."""

    velocity_integral_limit: Annotated[float, POSITIVE] = 0.05
    """Largest |integral of the velocity error| per axis, m: anti-windup."""
    rate_integral_limit: Annotated[float, POSITIVE] = 0.2
    """Largest |integral of the body-rate error| per axis, rad: anti-windup."""
    min_vertical_thrust_fraction: Annotated[float, Range(0.0, 1.0, above=True, below=True)] = 0.2
    """Lower limit of the desired force's vertical part, as a fraction of the weight: a drone that
    may never pull less than its weight cannot descend."""

    def __post_init__(self) -> None:
        model = self.feedforward
        if model is not None and not callable(getattr(model, "forces", None)):
            raise TypeError(
                f"feedforward is {model!r:.80}, but must be an InteractionModel, such "
                "as load('learned'), or None"
            )


def low_pass_blend(cutoff_hz: float, step: float) -> float:
    """Share of the new sample in a first-order low-pass, exact for an input held over the step.

    Args:
        cutoff_hz: frequency at which the gain has fallen by 3 dB, Hz.
        step: time between samples, s.
    """
    return -math.expm1(-2.0 * math.pi * cutoff_hz * step)


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


def gains(config: ControllerConfig, dt: float = STEP) -> dict[str, float]:
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
    }
