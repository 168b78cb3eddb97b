"""Agents that only teach: `--dagger.teacher swarm_envs/training/rl/teachers.py:NAME`.

Some are privileged: their labels depend on the true state, which the student does not observe.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from swarm_envs.agents import Actions, Observations, Safety, SafetyFilter
from swarm_envs.agents.avoiding import TUNED, Cruise, RoundaboutAgent
from swarm_envs.agents.registry import controller_of
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.baselines.neural_swarm.downwash import place_heavy_on_top
from swarm_envs.envs.actions import ACCELERATION_LAG
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.physics.contact import BOX
from swarm_envs.state import FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT

__all__ = ["DeliveryInTime", "SetpointTeacher", "SprintInTime", "TimedTeacher"]


def wide_roundabout(speed_mps: float = 1.9) -> SafetyFilter:
    """Return `roundabout` with a higher speed and a larger margin.

    A student's errors use part of the margin, and it is somewhat slower than its teacher.
    """
    shipped = TUNED["roundabout"]
    cruise = replace(shipped.cruise, position_gain=16.0, velocity_gain=6.0, speed_mps=speed_mps)
    safety = Safety(margin_m=0.2, horizon_s=0.5, response_s=0.126, rate=8.73, downwash=1.15)
    return replace(shipped, cruise=cruise, safety=safety).agent()


def slow_roundabout() -> SafetyFilter:
    """Return `wide_roundabout` at 1.5 m/s, for teams of 32: near misses fall from 4.7 to 0.4 %."""
    return wide_roundabout(1.5)


def tracking_20() -> TrackingAgent:
    """Return `tracking` with a decision rate of 20 Hz, for goals that move."""
    return TrackingAgent(decision_rate=20)


class CoreAgent(ABC):
    """Base class of agents with `teach`, which can also be evaluated."""

    requires: Mapping[str, Any] = MappingProxyType({})
    privileged = True

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Store the environment."""
        self._env = env

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the labels of the environment's current state."""
        actions = np.clip(self.teach(self._env.core)[0], -1.0, 1.0)
        return dict(zip(observations, actions, strict=True))

    @abstractmethod
    def teach(self, core: SwarmCore) -> FloatArray:
        """Return actions (E, N, width) in the current state."""


class SetpointTeacher(CoreAgent):
    """Teacher whose set-points follow the reference, or fly straight to goals at rest.

    The speed is limited by the braking distance. If any drone may take any goal, large drones are
    placed above small ones, as with `downwash-aware`.
    """

    controller = "downwash-aware"
    slope, braking_mps2, speed_mps = 6.0, 3.0, 1.9
    approach = 5.0  # Velocity per distance to a moving reference, 1/s

    def __init__(self) -> None:
        flown = controller_of(self.controller)
        self.requires = {"action": "velocity", "decision_rate": 48, "controller": flown}
        self._places: FloatArray | None = None

    def teach(self, core: SwarmCore) -> FloatArray:
        """Return velocities of the set-points."""
        drones = core.world.drones
        if not getattr(core.task.success, "named", True):
            velocity = self._towards(drones, self.assigned_places(core))
        elif core.task.motion.rests:
            velocity = self._towards(drones, drones["goal"] + self.shift(core))
        else:
            ahead = ACCELERATION_LAG * drones["reference_acceleration"]
            place = drones["reference_position"] + self.shift(core)
            velocity = drones["reference_velocity"] + ahead
            velocity = velocity + self.approach * (place - drones["setpoint_position"])
        return np.asarray(velocity / SPEED_LIMIT)

    def _towards(self, drones: Records, places: FloatArray) -> FloatArray:
        """Return velocities: linear in the distance near the goal, then with its square root."""
        delta = places - drones["setpoint_position"]
        distance = np.linalg.norm(delta, axis=-1, keepdims=True)
        least = self.braking_mps2 / self.slope
        root = 2.0 * self.braking_mps2 * distance - least**2
        near = np.minimum(self.slope * distance, np.sqrt(np.maximum(root, least**2)))
        return np.asarray(delta / np.maximum(distance, 1e-9) * np.minimum(near, self.speed_mps))

    def assigned_places(self, core: SwarmCore) -> FloatArray:
        """Return the goals (E, N, 3) that are assigned to drones at the start of an episode."""
        if self._places is None:
            self._places = np.array(core.world.drones["goal"])
        for e in np.flatnonzero(core.world.environments["decisions"] == 0):
            goals = np.array(core.world.drones["goal"][e])
            self._places[e] = place_heavy_on_top(goals, core.tasks[e].team)
        return self._places + self.shift(core)

    def shift(self, core: SwarmCore) -> FloatArray | float:
        """Return the shift of set-points from their places, m, which may compensate forces."""
        return 0.0


class RingLine(SetpointTeacher):
    """`SetpointTeacher` with the gains of `tracking`, which are more robust in the hall."""

    controller = "tracking+compensated+adaptive"


class TimedTeacher(SetpointTeacher):
    """Teacher whose set-points follow minimum-jerk paths of a fixed duration to goals.

    The velocity is the remaining distance times a gain that depends on the time since the stage
    began, so that a student can learn it from these two.
    """

    controller, travel_s = "heavy-on-top", 1.6
    latest = 0.7  # Fraction of the duration after which the gain is constant

    def teach(self, core: SwarmCore) -> FloatArray:
        """Return velocities of the set-points."""
        drones, task = core.world.drones, core.task
        named = getattr(task.success, "named", True)
        places = drones["goal"] + self.shift(core) if named else self.assigned_places(core)
        since, stage_s = np.array(core.world.environments["time"]), task.motion.stage_s
        since = np.mod(since + 1e-9, stage_s) if stage_s else since
        x = np.clip(since / self.travel_s, 0.02, self.latest)[:, None, None]
        left = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        velocity = 30.0 * (x * (1.0 - x)) ** 2 / self.travel_s
        acceleration = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / self.travel_s**2
        gain = (velocity + ACCELERATION_LAG * acceleration) / left
        return np.asarray(gain * (places - drones["setpoint_position"]) / SPEED_LIMIT)


class SprintInTime(TimedTeacher):
    """`TimedTeacher` with the duration of the layout `sprint`."""

    controller, travel_s, latest = "downwash-aware", 0.85, 0.55


class DeliveryInTime(TimedTeacher):
    """`TimedTeacher` with the duration of the task `delivery`, and a force estimate."""

    controller, travel_s, latest = "pid+adaptive", 1.5, 0.8


class Carousel(CoreAgent):
    """Teacher for circles: all drones fly half a turn to the right at one speed.

    Their distances stay constant, so that it works for any circle whose goals do not overlap. It
    reads the starts; a student infers the turn from goal, velocity and neighbors.
    """

    requires = MappingProxyType({"action": "acceleration", "decision_rate": 20, "num_neighbors": 7})
    speed_mps, gain, braking = 1.5, 5.0, 2.0  # Gain and braking: velocity and distance, 1/s
    straight_m = 0.35  # Remaining arc at which it begins to fly straight to the goal

    def teach(self, core: SwarmCore) -> FloatArray:
        """Return accelerations along the arc."""
        drones = core.world.drones
        start, goal, position = drones["start"], drones["goal"], drones["position"]
        middle, delta = 0.5 * (start + goal), goal - position
        radius = 0.5 * np.linalg.norm((goal - start)[..., :2], axis=-1, keepdims=True)
        out, last = (position - middle)[..., :2], (goal - middle)[..., :2]
        distance = np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 0.05)
        out = out / distance
        cross = out[..., 0] * last[..., 1] - out[..., 1] * last[..., 0]
        angle = np.arctan2(cross, (out * last).sum(axis=-1))[..., None]
        left = np.maximum(np.where(angle < -0.2, angle + 2 * np.pi, angle), 0.0) * radius
        speed = np.minimum(self.speed_mps, self.braking * left)
        along = np.stack([-out[..., 1], out[..., 0]], axis=-1)
        level = speed * along + self.braking * (radius - distance) * out
        near = left < self.straight_m
        level = np.where(near, self.braking * delta[..., :2], level)
        wanted = np.concatenate([level, self.braking * delta[..., 2:]], axis=-1)
        acceleration = self.gain * (wanted - drones["velocity"])
        acceleration[..., :2] -= np.where(near, 0.0, speed**2 / radius) * out
        size = np.abs(acceleration).max(axis=-1, keepdims=True) / ACCELERATION_LIMIT
        return np.asarray(acceleration / ACCELERATION_LIMIT / np.maximum(size, 1.0))


class _RoundaboutWithoutObstacles(RoundaboutAgent):
    """The roundabout without the avoidance of obstacles, which `WayFinder` adds."""

    def _around(self, rows: Float32Array, wanted: Float32Array) -> Float32Array:
        return wanted


class WayFinder(CoreAgent):
    """Teacher that passes obstacles on the shorter side and goals at speed, with a safety filter.

    Obstacles are treated as columns up to the ceiling. It reads the positions of all of them; the
    filter reads those of neighbors from rows without noise.
    """

    past_m, keep_m = 0.1, 0.28
    """Distance beyond a goal at which it aims, and clearance to obstacles, m."""

    def __init__(self) -> None:
        shipped = TUNED["roundabout"]
        cruise = Cruise(position_gain=12.0, velocity_gain=6.0, speed_mps=1.9)
        safety = Safety(margin_m=0.15, horizon_s=0.4, response_s=0.126, rate=8.73, downwash=1.15)
        self._pilot = SafetyFilter(_RoundaboutWithoutObstacles(cruise, shipped.roundabout), safety)
        self.requires = {**self._pilot.requires, "num_obstacles": 3, "observe_load": False}

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Reset the filtered agent, and store the obstacles."""
        super().reset(env, seed)
        self._pilot.reset(env, seed)
        self._form = env.core.form[1:]
        self._goal = {f.name: f.where for f in env.observation_layout}["task.goal"]
        rows = env.core.physics.obstacles
        box = rows[:, :1] == BOX
        self._middle = np.where(box, (rows[:, 1:3] + rows[:, 4:6]) / 2.0, rows[:, 1:3])
        half = (rows[:, 4] - rows[:, 1]) / 2.0
        self._radius = np.where(box[:, 0], 1.15 * half, rows[:, 3])

    def teach(self, core: SwarmCore) -> FloatArray:
        """Return accelerations toward the next point of the path."""
        rows = core.true_rows(*self._form)
        position, delta = core.world.drones["position"], rows[..., self._goal].astype(np.float64)
        length = np.linalg.norm(delta, axis=-1, keepdims=True)
        turned = self._turned(position[..., :2], delta[..., :2])
        delta = np.concatenate([turned, delta[..., 2:]], axis=-1)
        rows[..., self._goal] = delta * (1.0 + self.past_m / np.maximum(length, 0.05))
        return np.asarray(self._pilot.act_batch(rows), np.float64)

    def _turned(self, at: FloatArray, delta: FloatArray) -> FloatArray:
        """Return horizontal displacements (..., 2), turned past the first obstacle, m."""
        if not len(self._radius):
            return delta
        length = np.maximum(np.linalg.norm(delta, axis=-1, keepdims=True), 1e-6)
        ahead, side = delta / length, np.stack([-delta[..., 1], delta[..., 0]], axis=-1) / length
        place = self._middle - at[..., None, :]  # (..., M, 2)
        along = np.einsum("...mk,...k->...m", place, ahead)
        beside = np.einsum("...mk,...k->...m", place, side)
        away = np.linalg.norm(place, axis=-1)
        to_goal = np.linalg.norm(place - delta[..., None, :], axis=-1)
        keep = np.minimum(self._radius + self.keep_m, np.minimum(0.98 * away, 0.98 * to_goal))
        hit = (np.abs(beside) < keep) & (along > 0.0) & (along < length)
        first = np.where(hit, along, np.inf).argmin(axis=-1)[..., None]
        picked = [np.take_along_axis(a, first, -1)[..., 0] for a in (beside, away, keep, along)]
        offset, distance, clear, forward = picked
        angle = np.arctan2(offset, forward)
        tangent = np.arcsin(np.clip(clear / distance, 0.0, 1.0))
        turn = np.where(offset > 0.0, angle - tangent, angle + tangent)
        turn = np.where(hit.any(axis=-1), turn, 0.0)[..., None]
        return np.asarray(np.cos(turn) * delta + np.sin(turn) * side * length)
