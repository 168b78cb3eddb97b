"""One trial of Fig. 6 and 7: swaps planned with and without a force model, and simulated.

Both planners have the same parameters except for the force model. Their plans are simulated (a) as
published, with the planner's own model of the robots and the forces and a PID controller, and (b)
with quadrotors and forces that differ from those of the planner.

As published (Sec. VII-D): "we also implement a PID controller, which uses the planned controls as
feed-forward term", and forward propagate the dynamics with the learned model of f_a, also for
plans without it. A robot is a double integrator, dv/dt = u + f_a / m; no force is compensated.
(b) adds attitude, rotor lag, thrust limits, and a force that differs from that of the plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from swarm_envs.baselines.neural_swarm import SearchConfig, SwarmPlan, plan_swarm
from swarm_envs.baselines.neural_swarm.flights import FlightTest
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G, PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.control.config import MID, ControllerConfig, PositionGains
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray
from swarm_envs.tasks.placing import derangement
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import GRAM_FORCE, Team, parse_team

SPACING_M = 1.0  # distance between neighboring places in y, m
HEIGHT_M = 1.2  # mean height of the places, m
JITTER_M = 0.15  # each place lies at most so far from its mean in y and in z, m
DECISION_RATE = 48  # set-points a second, and samples of what is measured
PLANNERS = ("unaware", "aware")
"""Planner without the forces, the paper's BL, and with them, its NN."""
SIDES = ("plain", "compensated")
"""Tracking controller that flies the plan in (b): without a force model, and with one."""
ATTEMPTS = 6  # how often either planner may restart while its plan breaks a bound
BOUNDS = PlanningBounds(force_g={token: 0.9 * bound for token, bound in FORCE_BOUNDS_G.items()})
"""Bounds of every plan: 90 % of the force bounds, for the rest is left to tracking errors, and to
what acts between knots."""


class PlannedSwap(NamedTuple):
    """Starts and goals of one trial."""

    team: str
    starts: FloatArray  # (N, 3) m, all at x = 0
    goals: FloatArray  # (N, 3) m: each the start of another robot


def draw_swap(team: str, seed: int) -> PlannedSwap:
    """Draw a trial by a seed: places in a row, robots in random order, none of which stays.

    Raises:
        ValueError: the team has fewer than two robots.
    """
    count = len(parse_team(team))
    if count < 2:
        raise ValueError(f"team {team!r} has {count} robot, but a swap takes two; name more")
    rng = np.random.default_rng(seed)
    places = np.zeros((count, 3))
    places[:, 1] = SPACING_M * (np.arange(count) - 0.5 * (count - 1))
    places[:, 2] = HEIGHT_M
    places[:, 1:] += rng.uniform(-JITTER_M, JITTER_M, (count, 2))
    starts = places[rng.permutation(count)]
    return PlannedSwap(team, starts, starts[derangement(rng, count)])


def figure_6_swap() -> PlannedSwap:
    """Return a swap like Fig. 6's, which is not published: the large robot begins in the middle."""
    y = SPACING_M * np.array([-1.0, 1.0, 0.0])
    starts = np.column_stack([np.zeros(3), y, np.full(3, HEIGHT_M)])
    return PlannedSwap("SSL", starts, starts[[1, 2, 0]])


def plan_swap(swap: PlannedSwap, model: InteractionModel, planner: str, seed: int) -> SwarmPlan:
    """Plan a swap in the y-z plane, knowing the model unless the planner is `unaware`.

    The planner `published` searches by plain AO-RRT, as in the paper.
    """
    known = None if planner == "unaware" else model
    search = SearchConfig.published() if planner == "published" else None
    return plan_swarm(
        *(swap.starts, swap.goals, swap.team, known, BOUNDS, seed),
        plane="yz",
        attempts=ATTEMPTS if search is None else 1,
        search=search,
    )


@dataclass(frozen=True)
class PidGains:
    """Gains of the PID controller on position, the same in x, y and z. The paper gives none."""

    proportional: float  # 1/s^2
    derivative: float  # 1/s
    integral: float  # 1/s^3

    @classmethod
    def like(cls, gains: PositionGains) -> PidGains:
        """Return eqs. (18) and (19), without f_hat, multiplied out."""
        a, k, i = gains.position, gains.velocity, gains.integral
        return cls(a * (k + i) + k * i, a + k + i, a * k * i)


PID = PidGains.like(MID)  # as stiff as the default tracking controller


@dataclass(frozen=True)
class Track:
    """A plan and how it was followed, sampled K times. World frame, SI."""

    time: FloatArray  # (K,) s
    planned: FloatArray  # (K, N, 3) planned positions, m
    position: FloatArray  # (K, N, 3) m
    velocity: FloatArray  # (K, N, 3) m/s
    force: FloatArray  # (K, N, 3) true forces, N

    @property
    def error(self) -> FloatArray:
        """(K, N) distance to the plan, m."""
        return np.asarray(np.linalg.norm(self.position - self.planned, axis=-1))


def plan_at(plan: Trajectories, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions (K, N, 3), velocities and controls of a plan at times (K,), s.

    Between knots the motion is the cubic that has the position and velocity of both; where these
    fit a held acceleration, as the planner's do, it is that motion. Controls are held. After the
    last knot the plan stays there without control.
    """
    curve = CubicHermiteSpline(plan.times, plan.position, plan.velocity)
    at = np.minimum(times, plan.duration)
    knot = np.clip((times / plan.dt + 1e-9).astype(np.int64), 0, plan.steps - 1)
    over = (times > plan.duration + 1e-9)[:, None, None]
    velocity, control = curve(at, nu=1), plan.controls[knot]
    return curve(at), np.where(over, 0.0, velocity), np.where(over, 0.0, control)


def track_plan(
    plan: Trajectories,
    team: Team,
    model: InteractionModel,
    gains: PidGains = PID,
    dt: float = TIME_STEP,
) -> Track:
    """Track a plan by a PID controller on double integrators with forces held over dt, s: (a)."""
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


def fly_plan(
    plan: SwarmPlan,
    controller: ControllerConfig,
    truth: str | InteractionModel = "learned",
    engine: str = "batch",
) -> tuple[Track, bool]:
    """Fly a plan by quadrotors: the track, sampled after each decision, and if it crashed: (b)."""
    horizon_s = round(plan.trajectories.duration * DECISION_RATE) / DECISION_RATE
    test = FlightTest(SwapTask(plan.team, "random"), truth, engine, horizon_s=horizon_s)
    core = test.core(1, action="setpoint", decision_rate=DECISION_RATE, controller=controller)
    try:
        straight = np.zeros((len(plan.team), 2))
        core.reset([0], options={"start": plan.starts, "goal": plan.goals})
        samples: list[tuple[Any, ...]] = []
        while core.running[0]:
            reference = plan.reference(float(core.time[0]))
            core.step(np.concatenate([*reference, straight], axis=1)[None])
            samples.append(_sample(core, plan))
        track = Track(*(np.array(column) for column in zip(*samples, strict=True)))
        return track, bool((core.world.drones["crashed"][0] > 0.0).any())
    finally:
        core.close()


def _sample(core: SwarmCore, plan: SwarmPlan) -> tuple[Any, ...]:
    """Return the fields of a `Track` at this instant."""
    time, state = float(core.time[0]), core.physics.state
    planned = plan.reference(time).position
    flown = (state.position, state.velocity, core.physics.force)
    return time, planned, *(array[0].copy() for array in flown)


def fly_trial(
    swap: PlannedSwap,
    plan: SwarmPlan,
    planner: str,
    seed: int,
    model: InteractionModel,
    truth: str,
    engine: str,
) -> dict[str, Any]:
    """Track a plan on the planner's own model, and fly it where the force is another.

    Args:
        swap: what was planned.
        plan: its plan.
        planner: `aware` or `unaware`.
        seed: of the plan.
        model: force model of the aware planner and the compensating controller; the plant of (a).
        truth: force model of the environment in (b).
        engine: of (b), `bullet` or `batch`.

    Returns:
        Ready for JSON: `plan`; `model_plant`, `plain` and `compensated` with `measure_track`.
    """
    track = track_plan(plan.trajectories, plan.team, model)
    trial: dict[str, Any] = {
        "scenario": swap.team,
        "planner": planner,
        "seed": seed,
        "plan": {
            "status": plan.status,
            "reason": plan.reason,
            "duration_s": round(plan.trajectories.duration, 6),
            "energy": round(plan.trajectories.energy, 6),
            "predicted_force_ratio": round(plan.check.force_ratio, 4),
            "seconds": round(sum(plan.seconds.values()), 1),
        },
        "model_plant": measure_track(track, plan.team),
    }
    for side in SIDES:
        controller = ControllerConfig(feedforward=model if side == "compensated" else None)
        flown, crashed = fly_plan(plan, controller, truth, engine)
        trial[side] = {**measure_track(flown, plan.team), "crashed": crashed}
    return trial


def measure_track(track: Track, team: Team) -> dict[str, Any]:
    """Return what Fig. 7 shows of one tracked plan, and how near robots came.

    `error_cm`, worst tracking error of each robot; `force_g`, largest |f_a,z| on each;
    `over_bound`, the largest over all robots relative to its bound; `clearance`, the smallest
    distance between two robots over the sum of their radii.
    """
    force = np.abs(track.force[..., 2]).max(axis=0) / GRAM_FORCE
    bound = np.array([FORCE_BOUNDS_G[vehicle.token] for vehicle in team])
    return {
        "error_cm": np.round(100.0 * track.error.max(axis=0), 4).tolist(),
        "force_g": np.round(force, 4).tolist(),
        "over_bound": round(float((force / bound).max()), 4),
        "clearance": round(clearance(track.position, team), 4),
    }


def clearance(position: FloatArray, team: Team) -> float:
    """Return the smallest distance of two robots over the sum of their radii, at (K, N, 3) m."""
    radius = np.array([vehicle.radius for vehicle in team])
    first, second = np.triu_indices(len(team), 1)
    apart = np.linalg.norm(position[:, first] - position[:, second], axis=-1)
    return float((apart / (radius[first] + radius[second])).min())
