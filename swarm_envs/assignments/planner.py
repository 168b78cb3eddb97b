"""The assignment `distributed-mpc`: six drones, a sandbox each, and a lossy radio.

Each drone plans in rounds of 0.2 s and announces its plan; every other drone hears it, or does not.
Drones are points with limited acceleration that fly their plans exactly: what is graded is what
they promise each other. The sandboxes share nothing but what this radio delivers.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from swarm_envs import make
from swarm_envs.agents.evaluation import rate_interval
from swarm_envs.errors import check_array
from swarm_envs.grading.assignment import Assignment
from swarm_envs.grading.copies import copied_files, harmless
from swarm_envs.grading.submission import Entry, RemoteWork, WorkFailed
from swarm_envs.state import FloatArray
from swarm_envs.viewing import Recording
from swarm_envs.viewing.record import Recorder

DRONES, HORIZON, ROUND_S, CLOCK_S = 6, 15, 0.2, 12.0
"""Drones, rounds of a plan, length of a round, and the time in which all are to arrive."""
MAX_ACCELERATION = 5.0  # Of each axis, m/s^2
LEAST_DISTANCE = 0.3  # Between two drones; less is a crash, m
ARRIVED = 0.05  # From its goal, at less than this many m/s too: a drone has arrived, m
_SUBSTEPS = 10  # at which distances are looked at, each round
_BOX = np.array([1.2, 1.2, 0.6])  # half of the volume, m


class Scenario(NamedTuple):
    """An episode of the assignment."""

    starts: FloatArray  # (N, 3) m
    goals: FloatArray  # (N, 3) m
    loss: float  # Probability that a drone does not hear a plan


def draw_scenario(rng: np.random.Generator) -> Scenario:
    """Starts and goals at random, goals being others' starts, and a loss of up to 40 %."""
    starts = rng.uniform(-_BOX, _BOX, (1, 3))
    while len(starts) < DRONES:
        place = rng.uniform(-_BOX, _BOX)
        if np.linalg.norm(starts - place, axis=1).min() >= 2.0 * LEAST_DISTANCE:
            starts = np.vstack([starts, place])
    return Scenario(starts, np.roll(starts, 1, axis=0), float(rng.uniform(0.0, 0.4)))


def positions_of(state: FloatArray, plan: FloatArray) -> FloatArray:
    """(HORIZON, 3) positions at the rounds' ends under accelerations (HORIZON, 3), exactly."""
    speed = state[3:] + ROUND_S * np.cumsum(plan, axis=0)
    before = speed - ROUND_S * plan
    return np.asarray(state[:3] + np.cumsum(ROUND_S * (before + speed) / 2.0, axis=0))


def fly_scenario(
    planners: list[RemoteWork], scenario: Scenario, rng: np.random.Generator
) -> dict[str, Any]:
    """Fly one episode.

    Args:
        planners: a process for each drone.
        scenario: what is flown.
        rng: decides what is lost.

    Returns:
        `success`, `collided`, `time_s` until the last one has arrived or the end,
        `least_distance_m`, `states` (T, N, 6) of the rounds, and `goals`.

    Raises:
        WorkFailed: a planner failed, or planned what no drone can fly.
    """
    state = np.concatenate([scenario.starts, np.zeros((DRONES, 3))], axis=1)
    places = [state]
    heard = np.full((DRONES, DRONES, HORIZON, 3), np.nan)  # receiver, sender
    ages = np.full((DRONES, DRONES), -1.0)
    least = np.inf
    for drone, planner in enumerate(planners):
        planner.ask("reset", {"drone": drone}, [scenario.goals[drone]])
    time_s, arrived = 0.0, False
    while time_s < CLOCK_S and not arrived and least >= LEAST_DISTANCE:
        asked = zip(planners, state, scenario.goals, heard, ages, strict=True)
        plans = np.stack([_plan(planner, *given) for planner, *given in asked])
        ages[ages >= 0.0] += 1.0
        reaches = rng.random((DRONES, DRONES)) >= scenario.loss
        announced = [positions_of(own, plan) for own, plan in zip(state, plans, strict=True)]
        heard[reaches] = np.broadcast_to(announced, heard.shape)[reaches]
        ages[reaches] = 1.0
        least = min(least, _least_distance(state, plans[:, 0]))
        state = _after(state, plans[:, 0], ROUND_S)
        places.append(state)
        off = np.abs(state - np.concatenate([scenario.goals, np.zeros((DRONES, 3))], axis=1))
        arrived = bool((off < ARRIVED).all())
        time_s += ROUND_S
    collided = least < LEAST_DISTANCE
    return {
        "success": arrived and not collided,
        "collided": collided,
        "time_s": time_s,
        "least_distance_m": least,
        "states": np.stack(places),
        "goals": scenario.goals,
    }


def _plan(planner: RemoteWork, *given: FloatArray) -> FloatArray:
    _, answer = planner.ask("plan", {}, list(given), most=8 * 3 * HORIZON)
    if len(answer) != 1:
        raise WorkFailed("plan() must return one array of accelerations")
    try:
        plan = check_array("what plan() returns", answer[0], (HORIZON, 3))
    except (ValueError, TypeError) as error:
        raise WorkFailed(str(error)) from error
    if np.abs(plan).max() > MAX_ACCELERATION + 1e-6:
        raise WorkFailed(
            f"plan() accelerates by {np.abs(plan).max():.3g} m/s^2 on one axis, but may by at "
            f"most {MAX_ACCELERATION:g}"
        )
    return plan


def _after(state: FloatArray, acceleration: FloatArray, seconds: float) -> FloatArray:
    """(N, 6) states after some time of constant accelerations (N, 3)."""
    position, speed = state[:, :3], state[:, 3:]
    moved = position + seconds * speed + 0.5 * seconds**2 * acceleration
    return np.concatenate([moved, speed + seconds * acceleration], axis=1)


def _least_distance(state: FloatArray, acceleration: FloatArray) -> float:
    """The least distance of two drones in the round that begins."""
    times = ROUND_S * np.arange(1, _SUBSTEPS + 1) / _SUBSTEPS
    places = np.stack([_after(state, acceleration, time)[:, :3] for time in times])
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    return float(apart[:, *np.triu_indices(DRONES, 1)].min())


class DistributedMpc(Assignment):
    """Plan for six drones that hear each other over a lossy radio."""

    name = "distributed-mpc"
    work = "planner.py:MyPlanner"
    metric = "success_rate"
    zero, full = 0.0, 0.95

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return the share of episodes in which all arrive, and of those that count.

        Also Wilson's interval of the first, the median `time_s` of the successes, `copied`, and
        `failure`, a recording of the first episode that was no success.
        """
        with ExitStack() as stack:
            planners = [stack.enter_context(entry.opened())[0] for _ in range(DRONES)]
            flown, failure = [], None
            for seed in entry.seeds:
                rng = np.random.default_rng(seed)
                flown.append(fly_scenario(planners, draw_scenario(rng), rng))
                if entry.shown is not None and failure is None and not flown[-1]["success"]:
                    failure = _recorded(flown[-1], Recorder(entry.shown, seed))
        good = [flight["time_s"] for flight in flown if flight["success"]]
        return {
            "success_rate": len(good) / len(flown),
            "collision_rate": (crashed := sum(f["collided"] for f in flown) / len(flown)),
            "counted": 1.0 - crashed,
            "time_s": float(np.median(good)) if good else None,
            "intervals": {"success_rate": rate_interval(len(good), len(flown))},
            "copied": harmless(copied_files, entry.home, entry.work),
            "failure": failure,
        }


def _recorded(flight: dict[str, Any], recorder: Recorder) -> Recording:
    """A flight of points as one of level drones, a meter and a half above the ground."""
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
    said = {name: flight[name] for name in ("success", "time_s", "least_distance_m")}
    about = replace(recording.about, task="distributed-mpc", metrics=said)
    return replace(recording, about=about)
