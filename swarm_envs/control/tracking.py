"""The tracking controller of Neural-Swarm2, Sec. VI (version 1): from set-points to rotor thrusts.

Position loop, eqs. (18) and (19); attitude loop, eqs. (20) and (21); compensation of the motors'
lag, eq. (22), which adds to the desired thrust its low-passed derivative over lambda, and to the
torque the derivative of the rate error. One step at 240 Hz is one call of `track_env`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.control.attitude import (
    Vector,
    desired_rate,
    desired_torque,
    rotate_back,
    tilt_towards,
)
from swarm_envs.control.config import ControlGains, ControllerConfig, compile_gains
from swarm_envs.control.mixer import mix_scalars
from swarm_envs.control.state import ControllerState, Setpoint
from swarm_envs.errors import check_array
from swarm_envs.state import BoolArray, FloatArray, Parameters, SwarmState, parameters
from swarm_envs.vehicles import GRAVITY, Vehicle


@borrowing_kernel
def axis_force(
    position_error: float,
    velocity: float,
    setpoint_velocity: float,
    setpoint_acceleration: float,
    integral: float,
    mass: float,
    gains: ControlGains,
) -> tuple[float, float]:
    """Desired force along one world axis, N, without gravity and f_hat: eqs. (18) and (19).

    Args:
        position_error: p - p_d, m.
        velocity: v, m/s.
        setpoint_velocity: derivative of p_d, m/s.
        setpoint_acceleration: its second derivative, m/s^2.
        integral: integral of the velocity error until the last step, m.
        mass: m, kg.
        gains: the controller's gains.

    Returns:
        The force, and the integral with this step.
    """
    reference = setpoint_velocity - gains.position * position_error
    reference_rate = setpoint_acceleration - gains.position * (velocity - setpoint_velocity)
    error = velocity - reference
    limit = gains.velocity_integral_limit
    integral = min(max(integral + error * gains.step, -limit), limit)
    damping = (gains.velocity + gains.integral) * error
    return mass * (reference_rate - damping - gains.velocity * gains.integral * integral), integral


@borrowing_kernel
def desired_force(
    position: FloatArray,
    velocity: FloatArray,
    goal: FloatArray,
    goal_velocity: FloatArray,
    goal_acceleration: FloatArray,
    feedforward: FloatArray,
    integral: FloatArray,
    mass: float,
    gains: ControlGains,
) -> Vector:
    """Desired thrust vector f_d of one drone, world frame, N: eq. (19).

    Its vertical part is kept above a fraction of the weight, so that it always points up. The
    arrays are (3,), in the world frame, SI; the integral of the velocity error is updated.
    """
    p, v, g, gv, ga = position, velocity, goal, goal_velocity, goal_acceleration
    x, integral[0] = axis_force(p[0] - g[0], v[0], gv[0], ga[0], integral[0], mass, gains)
    y, integral[1] = axis_force(p[1] - g[1], v[1], gv[1], ga[1], integral[1], mass, gains)
    z, integral[2] = axis_force(p[2] - g[2], v[2], gv[2], ga[2], integral[2], mass, gains)
    weight = mass * GRAVITY
    floor = gains.min_vertical_thrust_fraction * weight
    return x - feedforward[0], y - feedforward[1], max(z + weight - feedforward[2], floor)


@borrowing_kernel
def lead_thrust(
    e: int, i: int, thrust: float, motor_rate: float, memory: ControllerState, gains: ControlGains
) -> float:
    """Thrust command T_d + (dT_d/dt) / lambda of eq. (22), N, its derivative low-passed."""
    if memory.started[e, i]:
        raw = (thrust - memory.thrust[e, i]) / gains.step
        memory.thrust_rate[e, i] += gains.thrust_rate_blend * (raw - memory.thrust_rate[e, i])
    memory.thrust[e, i] = thrust
    return thrust + gains.lead * memory.thrust_rate[e, i] / motor_rate


@borrowing_kernel
def track_env(
    e: int,
    state: SwarmState,
    parameters: Parameters,
    memory: ControllerState,
    setpoint: Setpoint,
    feedforward: FloatArray,
    gains: ControlGains,
    out_commands: FloatArray,
) -> None:
    """Make one controller step for every drone of environment e.

    Args:
        e: index of the environment.
        state: measured state; its angular velocity is in the world frame.
        parameters: what the controller takes the drones to be made of.
        memory: the controller's memory, updated in place.
        setpoint: what to follow, at this instant.
        feedforward: (N, 3) interaction forces that the controller believes, world frame, N.
        gains: from `compile_gains`.
        out_commands: (E, N, 4) receives rotor thrust commands in [0, max_rotor_thrust], N, in
            environment e only.
    """
    for i in range(state.position.shape[1]):
        qx, qy, qz, qw = state.quaternion[e, i]
        attitude = (qx, qy, qz, qw)
        wx, wy, wz = state.angular_velocity[e, i]
        omega = rotate_back(attitude, (wx, wy, wz))
        mass, motor_rate = parameters.mass[e, i], parameters.motor_rate[e, i]

        fx, fy, fz = desired_force(
            state.position[e, i],
            state.velocity[e, i],
            setpoint.position[e, i],
            setpoint.velocity[e, i],
            setpoint.acceleration[e, i],
            feedforward[i],
            memory.velocity_integral[e, i],
            mass,
            gains,
        )
        thrust = (
            2.0 * (qx * qz + qw * qy) * fx
            + 2.0 * (qy * qz - qw * qx) * fy
            + (1.0 - 2.0 * (qx * qx + qy * qy)) * fz
        )
        thrust = lead_thrust(e, i, thrust, motor_rate, memory, gains)

        tilt = tilt_towards(fx, fy, fz)
        half_yaw = 0.5 * setpoint.yaw[e, i]
        s, c = (half_yaw, 1.0) if half_yaw == 0.0 else (math.sin(half_yaw), math.cos(half_yaw))
        omega_desired = desired_rate(e, i, tilt, s, c, setpoint.yaw_rate[e, i], memory, gains)
        desired = (
            tilt[0] * c + tilt[1] * s,
            tilt[1] * c - tilt[0] * s,
            tilt[3] * s,
            tilt[3] * c,
        )
        torque = desired_torque(
            attitude,
            omega,
            desired,
            omega_desired,
            parameters.inertia[e, i],
            motor_rate,
            memory.rate_integral[e, i],
            memory.rate_error[e, i],
            memory.rate_error_rate[e, i],
            memory.started[e, i],
            gains,
        )
        memory.started[e, i] = True
        mix_scalars(
            thrust,
            torque[0],
            torque[1],
            torque[2],
            parameters.max_rotor_thrust[e, i],
            parameters.rotor_offset[e, i],
            parameters.thrust_to_torque[e, i],
            out_commands[e, i],
        )


@borrowing_kernel
def extrapolate(setpoint: Setpoint, e: int, dt: float) -> None:
    """Advance the set-points of environment e by dt, in s, with their jerk; in place."""
    for i in range(setpoint.position.shape[1]):
        for axis in range(3):
            v = setpoint.velocity[e, i, axis]
            a = setpoint.acceleration[e, i, axis]
            j = setpoint.jerk[e, i, axis]
            setpoint.position[e, i, axis] += dt * (v + dt * (a / 2.0 + dt * j / 6.0))
            setpoint.velocity[e, i, axis] += dt * (a + dt * j / 2.0)
            setpoint.acceleration[e, i, axis] += dt * j
        setpoint.yaw[e, i] += dt * setpoint.yaw_rate[e, i]


@borrowing_kernel
def track_all(
    state: SwarmState,
    parameters: Parameters,
    memory: ControllerState,
    setpoint: Setpoint,
    feedforward: FloatArray,
    gains: ControlGains,
    out_commands: FloatArray,
) -> None:
    """Make one controller step in every environment; `feedforward` is (E, N, 3)."""
    for e in range(state.position.shape[0]):
        track_env(e, state, parameters, memory, setpoint, feedforward[e], gains, out_commands)


class TrackingController:
    """The tracking controller of a team, for use outside environments.

    It owns its memory: call `commands` once per step of 1/240 s, and `reset` when a flight begins.

    Args:
        team: the vehicles, N of them.
        num_envs: E, number of teams that fly at once.
        config: gains, filters and the interaction model to compensate.
        dt: length of a controller step, s.

    Raises:
        ValueError: `num_envs` is below one, or dt is not positive.
    """

    def __init__(
        self,
        team: Sequence[Vehicle],
        num_envs: int = 1,
        config: ControllerConfig | None = None,
        dt: float = 1.0 / 240.0,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}, but there must be at least 1 environment")
        self.team = tuple(team)
        self.num_envs = num_envs
        self.config = ControllerConfig() if config is None else config
        self.parameters = parameters(self.team, num_envs)
        self.memory = ControllerState.zeros(num_envs, len(self.team))
        self._gains = compile_gains(self.config, dt)

    def reset(self, mask: BoolArray | None = None) -> None:
        """Forget all that was, in the environments of the (E,) mask or in every one."""
        self.memory.reset(mask)

    def commands(
        self, state: SwarmState, setpoint: Setpoint, feedforward: FloatArray | None = None
    ) -> FloatArray:
        """Rotor thrust commands (E, N, 4), N, for one step.

        Args:
            state: the measured state.
            setpoint: what to follow, at this instant.
            feedforward: (E, N, 3) interaction forces to compensate, world frame, N. None asks the
                configuration's model, or takes zero if it has none.

        Raises:
            ValueError: an array has the wrong shape or an entry that is not finite; the memory is
                then unchanged.
        """
        shape = (self.num_envs, len(self.team))
        self._check(state, setpoint)
        if feedforward is None and self.config.feedforward is not None:
            model = self.config.feedforward
            feedforward = model.forces(state.position, state.velocity, self.team)
        if feedforward is None:
            force = np.zeros((*shape, 3))
        else:
            force = check_array("feedforward", feedforward, (*shape, 3))
        out = np.empty((*shape, 4))
        track_all(state, self.parameters, self.memory, setpoint, force, self._gains, out)
        return out

    def _check(self, state: SwarmState, setpoint: Setpoint) -> None:
        shape = (self.num_envs, len(self.team))
        for owner, names in (
            (state, ("position", "velocity", "quaternion", "angular_velocity")),
            (setpoint, Setpoint._fields),
        ):
            for name in names:
                value = getattr(owner, name)
                width = () if name.startswith("yaw") else (4 if name == "quaternion" else 3,)
                check_array(f"{type(owner).__name__}.{name}", value, (*shape, *width))
