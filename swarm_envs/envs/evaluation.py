"""Evaluation of decisions: crashes, success and the end of episodes; and metrics of episodes.

A decision is evaluated in one kernel, since a dozen NumPy calls on arrays of four numbers would
take as long as the physics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE
from swarm_envs.state import FloatArray
from swarm_envs.tables import Record, Records, World
from swarm_envs.tasks.base import NEAR_MISS, ByScore, OwnSuccess, Success, Task, TrackingSuccess
from swarm_envs.tasks.motion import stage_at
from swarm_envs.vehicles import GRAM_FORCE

_ROUNDING = 1e-9
HIT_DRONE, HIT_FLOOR, HIT_WALL, HIT_OBSTACLE, TUMBLED = 1, 2, 4, 8, 16
"""Codes of contacts and tumbling; the fields `touching` and `incidents` are sums of them."""


def success_rules(
    success: Success | TrackingSuccess | ByScore | OwnSuccess,
) -> dict[str, float | bool]:
    """Return the fields of `swarm_envs.tables.SETTINGS` for a task's criterion of success."""
    if callable(success):  # the task's method decides: the kernel must never report success
        radius, hold_s, settle_s = Success.radius, math.inf, 0.0
    elif isinstance(success, ByScore):
        radius, hold_s, settle_s = success.radius, math.inf, 0.0
    elif isinstance(success, TrackingSuccess):
        radius, hold_s, settle_s = success.worst_error, 0.0, success.settle_s
    else:
        radius, hold_s, settle_s = success.radius, success.hold_s, 0.0
    return {
        "tracks": isinstance(success, TrackingSuccess),
        "exchanges": isinstance(success, Success) and not success.named,
        "success_radius": float(radius),
        "hold_s": float(hold_s),
        "settle_s": float(settle_s),
        "least_score": success.least if isinstance(success, ByScore) else math.inf,
    }


@part
def goal_distance(drone: Record, goal: FloatArray) -> float:
    """Return the distance of a drone to a goal (3,), m."""
    x, y, z = drone.position[0] - goal[0], drone.position[1] - goal[1], drone.position[2] - goal[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def exchange_goals(drones: Records, goals: FloatArray, radius: float) -> None:
    """Exchange goals (N, 3) between a drone that has reached another drone's goal and that drone.

    A drone within the radius, m, of its own goal keeps it. An exchange does not count as progress.
    """
    for i in range(drones.shape[0]):
        for j in range(drones.shape[0]):
            own, other = drones[i], drones[j]
            comes = own.active > 0.0 and goal_distance(own, own.goal) >= radius
            keeps = other.active > 0.0 and goal_distance(other, other.goal) < radius
            if comes and not keeps and goal_distance(own, other.goal) < radius:
                for k in range(3):
                    own.goal[k], other.goal[k] = other.goal[k], own.goal[k]
                    goals[i, k], goals[j, k] = own.goal[k], other.goal[k]
                for d in (own, other):
                    d.distance, d.arrival = goal_distance(d, d.goal), np.inf


@part
def survives(d: Record, ends_team: bool, bounces: bool) -> bool:
    """Write contacts and crash of a drone in this decision; return True if it may continue.

    If it may not, but the others may, its own episode ends.
    """
    touching = HIT_FLOOR * (d.touched_floor > 0.0) + HIT_WALL * (d.touched_wall > 0.0)
    touching += HIT_DRONE * (d.touched_drone != NO_DRONE) + TUMBLED * (d.tumbling > 0.0)
    touching += HIT_OBSTACLE * (d.touched_obstacle != NO_OBSTACLE)
    d.crashed = 1.0 if touching & ~int(d.touching) else 0.0
    d.touching, d.incidents = touching, int(d.incidents) | touching
    falls = touching != 0 and (not bounces or d.tumbling > 0.0)
    if falls and not ends_team:
        d.active, d.arrival = 0.0, np.inf
    return not falls


@kernel
def evaluate(  # noqa: C901  # one decision, on one screen
    actions: FloatArray,
    drones: Records,
    environments: Records,
    goals: FloatArray,
    settings: Records,
) -> None:
    """Evaluate the last decision of every running environment.

    A drone that touches something or tumbles has crashed. By the rule `on_contact`, a crash ends
    the episode of the team or of the drone; or the drone continues, unless it tumbles, and crashes
    again when it touches something that it did not touch in the previous decision. A stage is done
    when all active drones have done it; the team succeeds if, in addition, no drone ever crashed.

    Args:
        actions: (E, N, width), those of the decision.
        drones: (E, N) records, with references at the present time.
        environments: (E,) records; `running` becomes False where an episode has ended.
        goals: (E, S, N, 3) goals of every stage, m.
        settings: (1,) the rules.
    """
    rules, size, stages = settings[0], drones.shape[1], goals.shape[1]
    for e in range(drones.shape[0]):
        environment = environments[e]
        environment.achieved = 0.0
        if not environment.running:
            continue
        time, worst, since, left, crash_free = environment.time, 0.0, 0.0, 0, True
        if rules.exchanges:
            exchange_goals(drones[e], goals[e, environment.stage], rules.success_radius)
        scores = time >= rules.settle_s
        environment.scored += scores
        for i in range(size):
            d = drones[e, i]
            if d.active == 0.0:
                d.crashed, crash_free = 0.0, False
                continue
            d.last_distance = d.distance
            if rules.bounded:
                square = 0.0
                for k in range(actions.shape[2]):
                    square += actions[e, i, k] * actions[e, i, k]
                d.effort = square / actions.shape[2]
            to_reference = to_goal = 0.0
            for k in range(3):
                if rules.tracks:
                    d.goal[k] = d.reference_position[k]
                error, offset = d.position[k] - d.reference_position[k], d.position[k] - d.goal[k]
                to_reference += error * error
                to_goal += offset * offset
            d.distance, d.tracking_error = math.sqrt(to_goal), math.sqrt(to_reference)
            d.least_separation = min(d.least_separation, d.separation)
            d.least_clearance = min(d.least_clearance, d.clearance)
            d.least_obstacle_clearance = min(d.least_obstacle_clearance, d.obstacle_clearance)
            if scores:
                height = abs(d.position[2] - d.reference_position[2])
                d.worst_error = max(d.worst_error, d.tracking_error)
                d.worst_height_error = max(d.worst_height_error, height)
                d.squared_error += to_reference
            away = d.distance >= rules.success_radius
            d.arrival = np.inf if away else min(d.arrival, time)
            continues = survives(d, rules.ends_team, rules.bounces)
            crash_free &= d.incidents == 0.0
            if continues:
                left += 1
                worst, since = max(worst, d.worst_error), max(since, d.arrival)
        lost = left == 0 or (rules.ends_team and left < size)
        ended = time >= rules.horizon_s - _ROUNDING
        if rules.tracks:
            done = ended and worst < rules.success_radius and environment.scored > 0
        else:
            done = time - since >= rules.hold_s - _ROUNDING
        if done and not lost and not environment.held:
            environment.held = True
            environment.reached += 1
            environment.crash_free_stages += crash_free
            environment.achieved = 1.0 / stages
            environment.succeeded = crash_free and environment.reached == stages
        won = rules.end_on_success and environment.reached == stages and not rules.tracks
        environment.terminated = lost or won
        environment.truncated = ended and not environment.terminated
        environment.running = not (environment.terminated or environment.truncated)
        if stages > 1 and environment.running:
            stage = stage_at(time, rules.stage_s, stages)
            if stage != environment.stage:
                environment.stage, environment.held = stage, False
                for i in range(size):  # drones have the goals of the next stage from now on
                    d = drones[e, i]
                    to_goal = 0.0
                    for k in range(3):
                        d.goal[k] = goals[e, stage, i, k]
                        to_goal += (d.position[k] - d.goal[k]) * (d.position[k] - d.goal[k])
                    d.distance = math.sqrt(to_goal)
                    near = d.distance < rules.success_radius and d.active > 0.0
                    d.arrival = time if near else np.inf


def metrics(
    world: World, task: Task, environments: Sequence[int], on_contact: str = "end_team"
) -> list[dict[str, Any]]:
    """Return the metrics of these environments' episodes so far, in their order.

    - `success`: True if the task was done without a crash; `stages_reached` of `stages`: sets of
      goals that the whole team reached without a crash; `length_s`: length of the episode.
    - `arrived_fraction`, where contact does not end the team's episode: share of drones that are
      active and at their goals, or have always been near their references.
    - `collided_drones`, `collided_floor`, `collided_wall`, `collided_obstacle`, `tumbled`:
      number of drones to which that happened; `near_misses`: number of drones that came within
      1.5 times the sum of radii of another without contact.
    - `minimum_separation_m`: smallest distance between two drones (None for one drone);
      `minimum_obstacle_distance_m`: from a drone's center to an obstacle (None without one).
    - `worst_tracking_error_m`, `rms_tracking_error_m`, `worst_height_error_m`: errors with respect
      to the reference, over all drones; the lists `..._by_drone_m` have those of each drone. None
      if the task has no reference, or before errors count (in `ring`, during the start-up). Errors
      are measured at decisions, so compare them at one decision rate.
    - `worst_force_g`: largest aerodynamic force on a drone, from others or the ground, drag
      included; `energy_j`: ideal induced energy of all rotors; `force_bound_violations`:
      drone-steps of 1/240 s with a vertical force above the drone's bound, and
      `fraction_over_force_bound`: their share of all; `fraction_outside_measured_range`: share of
      drone-steps with an extrapolated force.
    - The task's `score_names`, if it has any: its score, and the number of goals reached.
    - `time_to_goal_s`: time from which the last drone has stayed at its goal, in the present stage
      (None if one is not there, or if goals move).
    """
    where = np.array(environments, dtype=np.int64)
    drones, ended = world.drones[where], world.environments[where]
    steps = np.maximum(drones["steps"].sum(axis=1), 1.0)
    over, outside = drones["over_bound"].sum(axis=1), drones["outside_steps"].sum(axis=1)
    incidents = drones["incidents"].astype(np.int64)
    clearance, obstacles = drones["least_clearance"], drones["least_obstacle_clearance"]
    arrival = drones["arrival"].max(axis=1)
    if callable(task.success):  # a method: the time of the team's success
        arrival = np.where(ended["succeeded"], ended["time"], np.inf)
    elif not isinstance(task.success, Success):
        arrival = np.full_like(arrival, np.inf)
    if on_contact == "end_team":
        arrived = {}
    else:
        there = np.isfinite(drones["arrival"])
        if isinstance(task.success, TrackingSuccess):
            there = drones["worst_error"] < task.success.worst_error
        arrived = {"arrived_fraction": (there & (drones["active"] > 0.0)).mean(axis=1)}
    stages = np.full(len(where), world.goals.shape[1])
    ends = {
        "success": ended["succeeded"],
        **arrived,
        "stages": stages,
        "stages_reached": ended["crash_free_stages"],
        "length_s": ended["time"],
        **{name: (incidents & code > 0).sum(axis=1) for name, code in _ACCIDENTS.items()},
        "near_misses": ((clearance >= 1.0) & (clearance < NEAR_MISS)).sum(axis=1),
        "minimum_separation_m": drones["least_separation"].min(axis=1),
        "minimum_obstacle_distance_m": (obstacles * drones["radius"]).min(axis=1),
    }
    sums = {
        "worst_force_g": drones["worst_force"].max(axis=1) / GRAM_FORCE,
        "energy_j": drones["energy"].sum(axis=1),
        "force_bound_violations": over.astype(np.int64),
        "fraction_over_force_bound": over / steps,
        "fraction_outside_measured_range": outside / steps,
        "time_to_goal_s": arrival,
    }
    return [
        {
            **{name: _plain(column[m]) for name, column in ends.items()},
            **_tracking(drones[m], int(ended["scored"][m]), task),
            **{name: _plain(column[m]) for name, column in sums.items()},
            **_scored(ended[m], task),
        }
        for m in range(len(where))
    ]


_ACCIDENTS = {
    "collided_drones": HIT_DRONE,
    "collided_floor": HIT_FLOOR,
    "collided_wall": HIT_WALL,
    "collided_obstacle": HIT_OBSTACLE,
    "tumbled": TUMBLED,
}


def _plain(value: Any) -> Any:
    """Return a NumPy number as Python's; None if it is infinite."""
    number = value.item()
    return number if math.isfinite(number) else None


def _scored(ended: Record, task: Task) -> dict[str, Any]:
    """Return the metrics that a task with a score adds or replaces."""
    if not task.score_names:
        return {}
    scores = float(ended["score"]), int(ended["goals_reached"])
    stages = {"stages": 1, "stages_reached": int(ended["succeeded"])}
    return {**stages, **dict(zip(task.score_names, scores, strict=False))}


def _tracking(drones: Records, scored: int, task: Task) -> dict[str, Any]:
    """Return the tracking errors of the drones (N,) of one environment.

    They are None where drones may exchange goals, which also exchanges their references.
    """
    shared = isinstance(task.success, Success) and not task.success.named
    if task.motion.rests or shared or not scored:
        names = ("worst_tracking_error_m", "rms_tracking_error_m", "worst_height_error_m")
        return dict.fromkeys(names)
    return {
        "worst_tracking_error_m": float(drones["worst_error"].max()),
        "rms_tracking_error_m": float(np.sqrt(drones["squared_error"].mean() / scored)),
        "worst_height_error_m": float(drones["worst_height_error"].max()),
        "worst_tracking_error_by_drone_m": drones["worst_error"].tolist(),
        "worst_height_error_by_drone_m": drones["worst_height_error"].tolist(),
    }
