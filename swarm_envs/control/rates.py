"""The inner loop alone: a total thrust and body rates to rotor thrusts, eqs. (20) to (22)."""

from __future__ import annotations

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.control.attitude import axis_acceleration, rotate_back
from swarm_envs.control.config import ControlGains
from swarm_envs.control.mixer import mix_scalars
from swarm_envs.control.state import ControllerState
from swarm_envs.state import FloatArray, Parameters, SwarmState


@borrowing_kernel
def hold_rates(
    e: int,
    state: SwarmState,
    parameters: Parameters,
    memory: ControllerState,
    asked: FloatArray,
    gains: ControlGains,
    out_commands: FloatArray,
) -> None:
    """Make one step of the rate loop for every drone of environment e.

    Args:
        e: index of the environment.
        state: measured state; its angular velocity is in the world frame.
        parameters: what the controller takes the drones to be made of.
        memory: the controller's memory; that of the rate loop is updated in place.
        asked: (E, N, 4) total thrust, N, and body rates about x, y, z, rad/s.
        gains: from `compile_gains`.
        out_commands: (E, N, 4) receives rotor thrust commands, N, in environment e only.
    """
    kt, ky = gains.rate_tilt, gains.rate_yaw
    it, iy = gains.rate_integral_tilt, gains.rate_integral_yaw
    for i in range(asked.shape[1]):
        q, w = state.quaternion[e, i], state.angular_velocity[e, i]
        x, y, z = rotate_back((q[0], q[1], q[2], q[3]), (w[0], w[1], w[2]))
        rx, ry, rz = asked[e, i, 1], asked[e, i, 2], asked[e, i, 3]
        last, rate = memory.rate_error[e, i], memory.rate_error_rate[e, i]
        integral, started = memory.rate_integral[e, i], memory.started[e, i]
        lead = gains.lead / parameters.motor_rate[e, i]
        ex, ey, ez = x - rx, y - ry, z - rz
        bx, rate[0], integral[0] = axis_acceleration(
            ex, last[0], rate[0], integral[0], kt, it, lead, started, gains
        )
        by, rate[1], integral[1] = axis_acceleration(
            ey, last[1], rate[1], integral[1], kt, it, lead, started, gains
        )
        bz, rate[2], integral[2] = axis_acceleration(
            ez, last[2], rate[2], integral[2], ky, iy, lead, started, gains
        )
        last[0], last[1], last[2] = ex, ey, ez
        memory.started[e, i] = True
        inertia = parameters.inertia[e, i]
        lx, ly, lz = inertia[0] * x, inertia[1] * y, inertia[2] * z
        mix_scalars(
            asked[e, i, 0],
            inertia[0] * bx - (ly * rz - lz * ry),
            inertia[1] * by - (lz * rx - lx * rz),
            inertia[2] * bz - (lx * ry - ly * rx),
            parameters.max_rotor_thrust[e, i],
            parameters.rotor_offset[e, i],
            parameters.thrust_to_torque[e, i],
            out_commands[e, i],
        )
