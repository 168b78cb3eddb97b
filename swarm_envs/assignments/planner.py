"""The assignment `distributed-mpc`: six drones, each in its sandbox, with lossy communication.

Each drone plans in rounds of 0.2 s and broadcasts its plan, which other drones may not receive.
Drones are points with limited acceleration that follow their plans exactly. The sandboxes share
only the plans that are received.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from swarm_envs import make
from swarm_envs.errors import check_array
from swarm_envs.grading.assignment import Assignment
from swarm_envs.grading.copies import copied_files, harmless
from swarm_envs.grading.submission import Entry, RemoteWork, WorkFailed
from swarm_envs.state import FloatArray
from swarm_envs.viewing import Recording
from swarm_envs.viewing.record import Recorder

DRONES, HORIZON, ROUND_S, CLOCK_S = 6, 15, 0.2, 12.0
"""Number of drones, rounds of a plan, duration of a round, and time limit."""
MAX_ACCELERATION = 5.0  # Largest acceleration per axis, m/s^2
LEAST_DISTANCE = 0.3  # Smallest allowed distance of two drones, m
ARRIVED = 0.05  # Largest position error per axis, m, and velocity, m/s, at the goal
_SUBSTEPS = 10  # Times per round at which distances are checked
_BOX = np.array([1.2, 1.2, 0.6])  # Half of the size of the volume, m


class Scenario(NamedTuple):
    """An episode of the assignment."""

    starts: FloatArray  # (N, 3) m
    goals: FloatArray  # (N, 3) m
    loss: float  # Probability that a drone does not receive a plan


def draw_scenario(rng: np.random.Generator) -> Scenario:
    """Return random starts, goals at other drones' starts, and a random loss of up to 40 %."""
    starts = rng.uniform(-_BOX, _BOX, (1, 3))
    while len(starts) < DRONES:
        start = rng.uniform(-_BOX, _BOX)
        if np.linalg.norm(starts - start, axis=1).min() >= 2.0 * LEAST_DISTANCE:
            starts = np.vstack([starts, start])
    return Scenario(starts, np.roll(starts, 1, axis=0), float(rng.uniform(0.0, 0.4)))


def positions_of(state: FloatArray, plan: FloatArray) -> FloatArray:
    """Return positions (HORIZON, 3) at the ends of rounds for accelerations (HORIZON, 3)."""
    speed = state[3:] + ROUND_S * np.cumsum(plan, axis=0)
    before = speed - ROUND_S * plan
    return np.asarray(state[:3] + np.cumsum(ROUND_S * (before + speed) / 2.0, axis=0))


def fly_scenario(
    planners: list[RemoteWork], scenario: Scenario, rng: np.random.Generator
) -> dict[str, Any]:
    """Simulate one episode.

    Args:
        planners: a process for each drone.
        scenario: the scenario.
        rng: the generator of lost messages.

    Returns:
        `success`, `collided`, `time_s` until the last drone has arrived or the episode ends,
        `least_distance_m`, `states` (T, N, 6) of the rounds, and `goals`.

    Raises:
        WorkFailed: a planner failed, or its plan is invalid.
    """
    state = np.concatenate([scenario.starts, np.zeros((DRONES, 3))], axis=1)
    states = [state]
    received = np.full((DRONES, DRONES, HORIZON, 3), np.nan)  # receiver, sender
    ages = np.full((DRONES, DRONES), -1.0)
    least = np.inf
    for drone, planner in enumerate(planners):
        planner.ask("reset", {"drone": drone}, [scenario.goals[drone]])
    time_s, arrived = 0.0, False
    while time_s < CLOCK_S and not arrived and least >= LEAST_DISTANCE:
        inputs = zip(planners, state, scenario.goals, received, ages, strict=True)
        plans = np.stack([_plan(planner, *given) for planner, *given in inputs])
        ages[ages >= 0.0] += 1.0
        reaches = rng.random((DRONES, DRONES)) >= scenario.loss
        announced = [positions_of(own, plan) for own, plan in zip(state, plans, strict=True)]
        received[reaches] = np.broadcast_to(announced, received.shape)[reaches]
        ages[reaches] = 1.0
        least = min(least, _least_distance(state, plans[:, 0]))
        state = _after(state, plans[:, 0], ROUND_S)
        states.append(state)
        off = np.abs(state - np.concatenate([scenario.goals, np.zeros((DRONES, 3))], axis=1))
        arrived = bool((off < ARRIVED).all())
        time_s += ROUND_S
    collided = least < LEAST_DISTANCE
    return {
        "success": arrived and not collided,
        "collided": collided,
        "time_s": time_s,
        "least_distance_m": least,
        "states": np.stack(states),
        "goals": scenario.goals,
    }


def _plan(planner: RemoteWork, *given: FloatArray) -> FloatArray:
    _, answer = planner.ask("plan", {}, list(given), most=8 * 3 * HORIZON)
    if len(answer) != 1:
        raise WorkFailed("plan() must return one array of accelerations")
    try:
        plan = check_array("the result of plan()", answer[0], (HORIZON, 3))
    except (ValueError, TypeError) as error:
        raise WorkFailed(str(error)) from error
    if np.abs(plan).max() > MAX_ACCELERATION + 1e-6:
        raise WorkFailed(
            f"plan() accelerates by {np.abs(plan).max():.3g} m/s^2 on an axis, but must not exceed "
            f"{MAX_ACCELERATION:g}"
        )
    return plan


def _after(state: FloatArray, acceleration: FloatArray, seconds: float) -> FloatArray:
    """Return states (N, 6) after some time of constant accelerations (N, 3)."""
    position, speed = state[:, :3], state[:, 3:]
    moved = position + seconds * speed + 0.5 * seconds**2 * acceleration
    return np.concatenate([moved, speed + seconds * acceleration], axis=1)


def _least_distance(state: FloatArray, acceleration: FloatArray) -> float:
    """Return the smallest distance of two drones in the next round."""
    times = ROUND_S * np.arange(1, _SUBSTEPS + 1) / _SUBSTEPS
    positions = np.stack([_after(state, acceleration, time)[:, :3] for time in times])
    apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    return float(apart[:, *np.triu_indices(DRONES, 1)].min())


class DistributedMpc(Assignment):
    """Plan for six drones with lossy communication."""

    name = "distributed-mpc"
    work = "planner.py:MyPlanner"
    metric = "success_rate"
    zero, full = 0.0, 0.95

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return the success rate, and the share of episodes that count.

        Also `copied`, and `failure`, a recording of the first episode that failed.
        """
        with ExitStack() as stack:
            planners = [stack.enter_context(entry.opened())[0] for _ in range(DRONES)]
            flown, failure = [], None
            for seed in entry.seeds:
                rng = np.random.default_rng(seed)
                flown.append(fly_scenario(planners, draw_scenario(rng), rng))
                if entry.shown is not None and failure is None and not flown[-1]["success"]:
                    failure = _recorded(flown[-1], Recorder(entry.shown, seed))
        crashed = sum(flight["collided"] for flight in flown) / len(flown)
        return {
            "success_rate": sum(flight["success"] for flight in flown) / len(flown),
            "collision_rate": crashed,
            "counted": 1.0 - crashed,
            "copied": harmless(copied_files, entry.home, entry.work),
            "failure": failure,
        }


def _recorded(flight: dict[str, Any], recorder: Recorder) -> Recording:
    """Return an episode of points as a recording of level drones, shifted up by 1.5 m."""
    env = make("swap_v1", num_drones=DRONES, physics="batch", layout="random")
    drones, environments, _ = env.core.world
    env.reset(seed=0)
    for number, state in enumerate(flight["states"]):
        drones["position"][0], drones["velocity"][0] = state[:, :3] + [0.0, 0.0, 1.5], state[:, 3:]
        drones["goal"][0] = flight["goals"] + [0.0, 0.0, 1.5]
        environments["time"] = ROUND_S * number
        recorder.take(env)
    env.close()
    recording = recorder.record()
    metrics = {name: flight[name] for name in ("success", "time_s", "least_distance_m")}
    about = replace(recording.about, task="distributed-mpc", metrics=metrics)
    return replace(recording, about=about)
