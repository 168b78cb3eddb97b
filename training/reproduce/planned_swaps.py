"""Swaps of Neural-Swarm2's Fig. 6 and 7, planned with and without the forces, and flown.

Both planners have identical parameters; they differ in the model alone, which is none for the one
that does not know. Their plans are flown (a) as published, on the planner's own model of the robots
and the forces, tracked by a PID; (b) by quadrotors, with forces that the planner does not know.

As published (Sec. VII-D): "we also implement a PID controller, which uses the planned controls as
feed-forward term", and forward propagate the dynamics with the learned model of f_a, whether the
plan knew it or not. A robot is a double integrator, dv/dt = u + f_a / m; no force is compensated.
What that leaves out is in (b): attitude, rotor lag, thrust limits, and a force that differs from
the one with which the plan was made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import FlightTest
from swarm_envs.baselines.neural_swarm.planner.pipeline import plan_swarm
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G, PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.control.config import MID, ControllerConfig, PositionGains
from swarm_envs.envs.core import SwarmCore
from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray
from swarm_envs.tasks.placing import derangement
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.reproduce.study import Cell
from swarm_envs.vehicles import GRAM_FORCE, Team, parse_team

SCENARIOS = ("SS", "SL", "LL", "SSS", "SSL", "SLL", "LLL")
"""Teams of two and three. The paper's text names SL, LL and SSL; its picture is not extracted."""
TRIALS = 5  # Trials of each scenario in the paper
SPACING_M = 1.0  # Distance between neighbouring places in y, m
_HEIGHT_M = 1.2  # mean height of the places, m
JITTER_M = 0.15  # Each place lies at most so far from its mean in y and in z, m


class _PlannedSwap(NamedTuple):
    """One trial: where robots start and end."""

    team: str  # who changes places
    starts: FloatArray  # (N, 3) m, all at x = 0
    goals: FloatArray  # (N, 3) m: each the start of another robot


def draw_swap(team: str, seed: int) -> _PlannedSwap:
    """Draw a trial by a seed: places in a row, robots in random order, of whom none stays."""
    count = len(parse_team(team))
    if count < 2:
        raise ValueError(f"team {team!r} has {count} robot, but a swap takes two; name more")
    rng = np.random.default_rng(seed)
    places = np.zeros((count, 3))
    places[:, 1] = SPACING_M * (np.arange(count) - 0.5 * (count - 1))
    places[:, 2] = _HEIGHT_M
    places[:, 1:] += rng.uniform(-JITTER_M, JITTER_M, (count, 2))
    starts = places[rng.permutation(count)]
    return _PlannedSwap(team, starts, starts[derangement(rng, count)])


def figure_6_swap() -> _PlannedSwap:
    """Fig. 6's swap, unpublished: the means of `draw_swap`; the large one begins in between."""
    y = SPACING_M * np.array([-1.0, 1.0, 0.0])
    starts = np.column_stack([np.zeros(3), y, np.full(3, _HEIGHT_M)])
    return _PlannedSwap("SSL", starts, starts[[1, 2, 0]])


@dataclass(frozen=True)
class PidGains:
    """Gains of the PID on position, the same in x, y and z. The paper gives none."""

    proportional: float  # 1/s^2
    derivative: float  # 1/s
    integral: float  # 1/s^3

    @classmethod
    def like(cls, gains: PositionGains) -> PidGains:
        """The PID that eqs. (18) and (19) are, without f_hat, multiplied out."""
        a, k, i = gains.position, gains.velocity, gains.integral
        return cls(a * (k + i) + k * i, a + k + i, a * k * i)


PID = PidGains.like(MID)  # As stiff as the default tracking controller


@dataclass(frozen=True)
class Track:
    """A plan and what became of it, sampled at every step of the plant. World frame, SI."""

    time: FloatArray  # (K,) s
    planned: FloatArray  # (K, N, 3) planned positions, m
    position: FloatArray  # (K, N, 3) positions, m
    velocity: FloatArray  # (K, N, 3) velocities, m/s
    force: FloatArray  # (K, N, 3) true forces, N

    @property
    def error(self) -> FloatArray:
        """(K, N) distance to the plan, m."""
        return np.asarray(np.linalg.norm(self.position - self.planned, axis=-1))


def plan_at(plan: Trajectories, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions (K, N, 3), velocities and controls of a plan at times (K,) since its beginning, s.

    Between knots the motion is the cubic that meets position and velocity at both; where these fit
    a held acceleration, as the planner's do, it is that motion. Controls are held. After the last
    knot the plan stays there without control.
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
    """Let a PID track a plan on double integrators with a model's forces, held over dt, s."""
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


_DECISION_RATE = 48  # set-points a second, and samples of what is measured


def fly_plan(
    plan: SwarmPlan,
    controller: ControllerConfig,
    truth: str | InteractionModel = "learned",
    engine: str = "batch",
) -> tuple[Track, bool]:
    """Fly a plan; the track, sampled after each decision, and whether it ended by a crash."""
    horizon_s = round(plan.duration * _DECISION_RATE) / _DECISION_RATE
    test = FlightTest(SwapTask(plan.team, "random"), truth, engine, horizon_s=horizon_s)
    core = test.core(1, action="setpoint", decision_rate=_DECISION_RATE, controller=controller)
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
    """Fields of a `Track` at this instant."""
    time, state = float(core.time[0]), core.physics.state
    planned = plan.reference(time).position
    flown = (state.position, state.velocity, core.physics.force)
    return time, planned, *(array[0].copy() for array in flown)


PLANNERS = ("unaware", "aware")
"""Who plans: without the forces, the paper's BL, and with them, its NN."""


SIDES = ("plain", "compensated")
"""Who flies the plan in the unknown air: the tracking controller without belief, and with."""

PLANNED_SHARE = 0.9
"""Share of the force bounds that plans may use; the rest is left to tracking errors, and to what
acts between knots. The same for both planners."""
ATTEMPTS = 6  # How often either planner may restart while its plan breaks a bound


@dataclass(frozen=True)
class TrialSettings:
    """What all trials share."""

    model: InteractionModel
    """The force model of the aware planner and the compensating controller; the plant of (a)."""
    truth: str | InteractionModel = "learned"  # The true force model in (b)
    engine: str = "batch"  # Of (b): `bullet` or `batch`
    bounds: PlanningBounds = PlanningBounds(
        force_g={token: PLANNED_SHARE * bound for token, bound in FORCE_BOUNDS_G.items()}
    )
    """What every plan shall keep to."""

    def plan(self, swap: _PlannedSwap, planner: str, seed: int) -> SwarmPlan:
        """Plan a swap in the y-z plane, with everything equal but the model."""
        check_name("planner", planner, PLANNERS)
        model = self.model if planner == "aware" else None
        return plan_swarm(
            swap.starts,
            swap.goals,
            swap.team,
            model,
            self.bounds,
            seed,
            plane="yz",
            attempts=ATTEMPTS,
        )


def kept_plan(
    path: Path, settings: TrialSettings, swap: _PlannedSwap, planner: str, seed: int
) -> SwarmPlan:
    """The plan that the file keeps, or one that is made now and kept there."""
    if not path.is_file():
        plan = settings.plan(swap, planner, seed)
        plan.save(path)
        return plan
    plan = SwarmPlan.load(path)
    model = settings.model if planner == "aware" else load("none")
    same = (
        plan.team == parse_team(swap.team)
        and np.array_equal(plan.starts, swap.starts)
        and np.array_equal(plan.goals, swap.goals)
        and (plan.seed, plan.bounds) == (seed, settings.bounds)
        and plan.model_fingerprint == model.fingerprint
    )
    if not same:
        raise ValueError(
            f"{str(path)!r} keeps a plan of another swap, model, seed or bounds; choose another "
            "folder by --out, or delete it"
        )
    return plan


def fly_trial(
    settings: TrialSettings, swap: _PlannedSwap, plan: SwarmPlan, planner: str, seed: int
) -> Cell:
    """Track a plan on the planner's own model, and fly it in the unknown air."""
    track = track_plan(plan.trajectories, plan.team, settings.model)
    cell: Cell = {
        "scenario": swap.team,
        "planner": planner,
        "seed": seed,
        "plan": {
            "status": plan.status,
            "reason": plan.reason,
            "duration_s": round(plan.duration, 6),
            "energy": round(plan.trajectories.energy, 6),
            "predicted_force_ratio": round(plan.check.force_ratio, 4),
            "seconds": round(sum(plan.seconds.values()), 1),
        },
        "model_plant": measure_track(track, plan.team),
    }
    for side in SIDES:
        believed = settings.model if side == "compensated" else None
        controller = ControllerConfig(feedforward=believed)
        flown, crashed = fly_plan(plan, controller, settings.truth, settings.engine)
        cell[side] = {**measure_track(flown, plan.team), "crashed": crashed}
    return cell


def measure_track(track: Track, team: Team) -> dict[str, Any]:
    """What Fig. 7 shows of one tracked plan, and how near robots came.

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
    """Smallest distance of two robots over the sum of their radii, over positions (K, N, 3), m."""
    radius = np.array([vehicle.radius for vehicle in team])
    first, second = np.triu_indices(len(team), 1)
    apart = np.linalg.norm(position[:, first] - position[:, second], axis=-1)
    return float((apart / (radius[first] + radius[second])).min())


def check_planned(options: Any) -> None:
    """Refuse a truth for which no belief ships, and teams that cannot swap."""
    load_belief(options.truth or "learned")
    for team in options.scenarios:
        draw_swap(team, options.seed)
