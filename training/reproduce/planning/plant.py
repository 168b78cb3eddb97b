"""The plant of Fig. 6 and 7: the planner's own model of the robots, tracked by a PID.

As published (Sec. VII-D): "we also implement a PID controller, which uses the planned controls as
feed-forward term", and forward propagate the dynamics with the learned model of f_a, whether the
plan knew it or not. A robot is a double integrator, dv/dt = u + f_a / m; no force is compensated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.control.config import MID, PositionGains
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Team


@dataclass(frozen=True)
class PidGains:
    """Gains of the PID on position, the same in x, y and z. The paper gives none."""

    proportional: float
    """1/s^2."""
    derivative: float
    """1/s."""
    integral: float
    """1/s^3."""

    @classmethod
    def like(cls, gains: PositionGains) -> PidGains:
        """The PID that eqs. (18) and (19) are, without f_hat, multiplied out."""
        a, k, i = gains.position, gains.velocity, gains.integral
        return cls(a * (k + i) + k * i, a + k + i, a * k * i)


PID = PidGains.like(MID)
"""As stiff as the default tracking controller."""


@dataclass(frozen=True)
class Track:
    """A plan and what became of it, sampled at every step of the plant. World frame, SI."""

    time: FloatArray
    """(K,) s."""
    planned: FloatArray
    """(K, N, 3) planned positions, m."""
    position: FloatArray
    """(K, N, 3) positions, m."""
    velocity: FloatArray
    """(K, N, 3) velocities, m/s."""
    force: FloatArray
    """(K, N, 3) forces that blew, N."""

    @property
    def error(self) -> FloatArray:
        """(K, N) distance to the plan, m."""
        return np.asarray(np.linalg.norm(self.position - self.planned, axis=-1))


def plan_at(plan: Trajectories, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions (K, N, 3), velocities and controls of a plan between its knots.

    Between knots the motion is the cubic that meets position and velocity at both; where these fit
    a held acceleration, as the planner's do, it is that motion. Controls are held. After the last
    knot the plan stays there without control.

    Args:
        plan: a plan of T steps.
        times: (K,) s from the plan's beginning, not negative.
    """
    knot = np.clip((times / plan.dt + 1e-9).astype(np.int64), 0, plan.steps - 1)
    s = np.clip(times / plan.dt - knot, 0.0, 1.0)[:, None, None]
    p0, p1 = plan.position[knot], plan.position[knot + 1]
    v0, v1 = plan.velocity[knot], plan.velocity[knot + 1]
    way = p1 - p0 - v0 * plan.dt
    turn = (v1 - v0) * plan.dt
    quadratic, cubic = 3.0 * way - turn, turn - 2.0 * way
    position = p0 + s * (v0 * plan.dt + s * (quadratic + s * cubic))
    velocity = v0 + s * (2.0 * quadratic + 3.0 * s * cubic) / plan.dt
    over = (times > plan.duration + 1e-9)[:, None, None]
    return position, np.where(over, 0.0, velocity), np.where(over, 0.0, plan.controls[knot])


def track_plan(
    plan: Trajectories,
    team: Team,
    model: InteractionModel,
    gains: PidGains = PID,
    dt: float = TIME_STEP,
) -> Track:
    """Let a PID track a plan on double integrators that feel the model's forces.

    Forces and controls are held over a step, which is then exact. The robots start where the plan
    starts, and are followed until it ends.

    Args:
        plan: of N robots.
        team: their N vehicles.
        model: the forces that blow; the plan may have been made with another, or with none.
        gains: of the PID.
        dt: length of a step, s.

    Raises:
        ValueError: the plan is of another number of robots, or empty.
    """
    if plan.states.shape[1] != len(team) or plan.steps < 1:
        raise ValueError(
            f"the plan has {plan.steps} steps of {plan.states.shape[1]} robots, but must have at "
            f"least one step and the team's {len(team)}"
        )
    times: FloatArray = dt * np.arange(math.floor(plan.duration / dt + 1e-6) + 1.0)
    planned, moving, controls = plan_at(plan, times)
    mass = np.array([vehicle.mass for vehicle in team])[:, None]
    position, velocity = plan.position[0].copy(), plan.velocity[0].copy()
    integral = np.zeros_like(position)
    found = np.empty((3, *planned.shape))
    for k in range(len(times)):
        force = model.forces(position[None], velocity[None], team)[0]
        found[:, k] = position, velocity, force
        error, error_rate = position - planned[k], velocity - moving[k]
        integral += dt * error
        control = (
            controls[k]
            - gains.proportional * error
            - gains.derivative * error_rate
            - gains.integral * integral
        )
        acceleration = control + force / mass
        position = position + dt * velocity + 0.5 * dt**2 * acceleration
        velocity = velocity + dt * acceleration
    return Track(times, planned, *found)
