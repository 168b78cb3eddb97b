"""The world `"hall"`: a simulated motion-capture hall.

It adds to the simulation a random force that no model contains, errors of the rotors' thrust, and a
state estimate. `Hall` has the parameters; docs/hall.md lists them. The kernels are in
`swarm_envs.physics.hall_lanes`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarm_envs.errors import check_number, check_numbers
from swarm_envs.state import FloatArray
from swarm_envs.tables import World
from swarm_envs.vehicles import GRAVITY, LARGE, SMALL

__all__ = ["Hall"]

_STEP = 1.0 / 240.0
Shares = tuple[float, float]  # Shares of the weight, for `SMALL` and `LARGE`


@dataclass(frozen=True)
class Hall:
    """The parameters of the motion-capture hall.

    Those whose names begin with `residual` and `offset` were identified by `swarm-envs fit
    --residual` on the 192 measured flights of Neural-Swarm2 (docs/hall.md). Pairs are shares of the
    weight, for vehicles of 34 g (`SMALL`) and 67 g (`LARGE`); they are interpolated by mass, and
    constant beyond.

    Raises:
        ValueError: a number is out of its range; the message names it, the rule and the fix.
    """

    residual_quiet: Shares = (0.016, 0.021)
    """Standard deviation of the random vertical force where the modeled force is 0. Source: fit to
    flights."""
    residual_wake: Shares = (0.088, 0.082)
    """Standard deviation of the random vertical force where the modeled force is large. Source: fit
    to flights."""
    residual_half: tuple[float, float] = (0.053, 0.028)
    """Modeled force at which the standard deviation is halfway between `residual_quiet` and
    `residual_wake`. Source: fit to flights."""
    residual_alone: Shares = (0.011, 0.019)
    """Standard deviation of the random vertical force if no other drone is in the interaction
    volume. Source: fit to flights of one drone."""
    residual_time_s: float = 0.14
    """Correlation time of the random force, an Ornstein-Uhlenbeck process for each drone and axis,
    s. Source: fit to flights."""
    residual_sideways: float = 0.27
    """Horizontal random force along each axis over the vertical one. Source: fit to flights."""
    offset: Shares = (0.018, 0.021)
    """Standard deviation of the constant vertical force of a drone in an episode: errors of mass
    and thrust at hover. Source: fit to flights."""
    thrust_error: float = 0.014
    """Standard deviation of the factor of a drone's rotor forces in an episode. Source: Table I of
    Neural-Swarm2 for the small vehicle, psi1(psi2(f)) / f for forces f of half to one and a half
    times hover at 3.4 to 4.0 V."""

    frame_rate_hz: float = 100.0
    """Frames of motion capture per second. Source: Neural-Swarm2, Sec. VII-A."""
    frame_delay_s: float = 0.010
    """Age of a frame when the drone receives it, s; the drone's velocity is taken as constant over
    it. Source: an assumption, one frame for cameras and radio."""
    frame_loss: float = 0.01
    """Probability that a drone does not receive a frame. Source: an assumption."""
    position_noise_m: float = 0.001
    """Standard deviation of a frame's position along each axis, m. Source: `locSrv.extPosStdDev` of
    Crazyswarm."""
    attitude_noise_rad: float = 0.0045
    """Standard deviation of a frame's attitude about each axis, rad. Source: `extQuatStdDev` of the
    Crazyflie's firmware."""
    accelerometer_noise: float = 0.05
    """Noise density of the measured accelerations, vibrations included, m/s^2/sqrt(Hz). Source:
    `procNoiseAcc_xy` of the firmware's filter, 0.5 m/s^2 at 100 Hz."""
    gyro_noise: float = 0.01
    """Noise density of the measured body rates, rad/s/sqrt(Hz). Source: `measNoiseGyro` of the
    firmware's filter, 0.1 rad/s at 100 Hz."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("residual_quiet", "residual_wake", "residual_alone", "offset"):
            check_numbers(name, getattr(self, name), 2, at_least=0.0, at_most=1.0)
        check_numbers("residual_half", self.residual_half, 2, above=0.0, at_most=1.0)
        check_number("residual_time_s", self.residual_time_s, above=0.0, unit="s")
        check_number("residual_sideways", self.residual_sideways, at_least=0.0)
        check_number("thrust_error", self.thrust_error, at_least=0.0, at_most=0.2)
        check_number("frame_rate_hz", self.frame_rate_hz, at_least=1.0, at_most=240.0, unit="Hz")
        check_number("frame_delay_s", self.frame_delay_s, at_least=0.0, at_most=0.05, unit="s")
        check_number("frame_loss", self.frame_loss, at_least=0.0, below=1.0)
        check_number("position_noise_m", self.position_noise_m, at_least=0.0, at_most=1.0, unit="m")
        check_number(
            "attitude_noise_rad", self.attitude_noise_rad, at_least=0.0, at_most=1.0, unit="rad"
        )
        check_number(
            "accelerometer_noise",
            self.accelerometer_noise,
            at_least=0.0,
            at_most=10.0,
            unit="m/s^2/sqrt(Hz)",
        )
        check_number(
            "gyro_noise", self.gyro_noise, at_least=0.0, at_most=1.0, unit="rad/s/sqrt(Hz)"
        )

    @classmethod
    def of(cls, world: str | Hall) -> Hall | None:
        """Return the hall of an option `world`; None for the ideal world."""
        if isinstance(world, Hall):
            return world
        return cls() if world == "hall" else None

    def draw(self, rng: np.random.Generator, e: int, world: World) -> None:
        """Sample the constant errors and the noise of a new episode of environment `e`."""
        drones = world.drones[e]
        weight = GRAVITY * drones["nominal_mass"]

        def share(pair: Shares) -> FloatArray:
            """Return shares of the weights in newton."""
            masses = (SMALL.mass, LARGE.mass)
            return np.asarray(weight * np.interp(drones["nominal_mass"], masses, pair))

        quiet = share(self.residual_quiet)
        drones["residual_quiet"], drones["residual_half"] = quiet, share(self.residual_half)
        drones["residual_alone"] = share(self.residual_alone)
        drones["residual_more"] = share(self.residual_wake) - quiet
        drones["residual_process"] = rng.standard_normal((len(drones), 3))
        drones["force_offset"] = share(self.offset) * rng.standard_normal(len(drones))
        drones["thrust_gain"] = 1.0 + self.thrust_error * rng.standard_normal(len(drones))
        drones["frame_phase"] = rng.uniform()  # a frame has the poses of all drones
        world.environments["hall_key"][e] = rng.integers(2**63)

    def filter_gains(self) -> tuple[float, float, float]:
        """Return the gains of a frame on position, velocity (1/s) and attitude.

        They are those of a steady-state discrete Kalman filter. Its process noise between frames is
        that of the accelerometer and the gyroscope; it ignores lost frames and the delay.
        """
        time = 1.0 / self.frame_rate_hz
        walk = np.array([[time**3 / 3.0, time**2 / 2.0], [time**2 / 2.0, time]])
        moves = np.array([[1.0, time], [0.0, 1.0]])
        position, velocity = _steady_gain(
            moves, self.accelerometer_noise**2 * walk, self.position_noise_m**2
        )
        drift = np.array([[self.gyro_noise**2 * time]])
        (attitude,) = _steady_gain(np.eye(1), drift, self.attitude_noise_rad**2)
        return float(position), float(velocity), float(attitude)

    def settings(self) -> dict[str, object]:
        """Return the fields of `swarm_envs.tables.SETTINGS` for these parameters."""
        return {
            "residual_kept": math.exp(-_STEP / self.residual_time_s),
            "residual_sideways": float(self.residual_sideways),
            "velocity_walk": self.accelerometer_noise * math.sqrt(_STEP),
            "attitude_walk": self.gyro_noise * math.sqrt(_STEP),
            "frames_per_step": self.frame_rate_hz * _STEP,
            "frame_delay": float(self.frame_delay_s),
            "frame_loss": float(self.frame_loss),
            "frame_noise": (float(self.position_noise_m), float(self.attitude_noise_rad)),
            "frame_gain": self.filter_gains(),
        }


def _steady_gain(moves: FloatArray, process: FloatArray, measured: float) -> FloatArray:
    """Return the steady-state gain of a Kalman filter that measures its first state."""
    if not process.any():
        return np.zeros(len(moves))
    covariance, gain = process, np.zeros(len(moves))
    for _ in range(100_000):
        last, gain = gain, covariance[:, 0] / (covariance[0, 0] + measured)
        covariance = covariance - np.outer(gain, covariance[0])
        covariance = moves @ covariance @ moves.T + process
        if np.allclose(gain, last, rtol=1e-12, atol=0.0):
            break
    return np.asarray(gain)
