"""Scripted agents: hover, random, straight-line, detour, and base classes of planners.

The detour agent is a geometric baseline for any task and team. All drones fly from rest to rest in
the same time, each along a straight path plus a bump, a vector that is the deviation from the
straight path at its middle. The drones choose bumps from a fixed family one after another, each
with the least cost given the choices of the others, until none changes. These are best responses in
a potential game, so the iteration terminates. Costs are proximity to other drones, with a larger
vertical distance because of downwash, proximity to obstacles, and length.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from swarm_envs.agents.protocol import Actions, Observations, RowAgent
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT, ByScore, Task
from swarm_envs.tasks.motion import LINES
from swarm_envs.tasks.obstacles import obstacle_distances, obstacle_rows
from swarm_envs.trajectories import Reference, rest_to_rest

__all__ = ["DetourAgent", "PlannedAgent", "SetpointAgent"]


class HoverAgent:
    """Agent that hovers at the start: its accelerations are zero."""

    requires: Mapping[str, Any] = MappingProxyType({"action": "acceleration"})
    privileged = False

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Do nothing, as the agent has no memory."""

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return zeros for every drone."""
        return {agent: np.zeros(3, dtype=np.float32) for agent in observations}


class RandomAgent:
    """Agent with uniformly random actions in [-1, 1], for bounded action spaces."""

    requires: Mapping[str, Any] = MappingProxyType({})
    privileged = False

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._width = 0

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Seed the generator; raise ValueError if the action space is not bounded."""
        space = env.action_space(env.possible_agents[0])
        if not space.is_bounded():
            raise ValueError(
                f"RandomAgent needs bounded actions, but action={env.core.config.action!r} is not "
                "bounded; make the environment with action='acceleration'"
            )
        self._rng, self._width = np.random.default_rng(seed), int(space.shape[0])

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return random actions for every drone."""
        return {
            agent: self._rng.uniform(-1.0, 1.0, self._width).astype(np.float32)
            for agent in observations
        }


class StraightLineAgent(RowAgent):
    """Agent that flies straight to its goal without collision avoidance, by PD control.

    The acceleration is 4 / s^2 (goal - position) - 4 / s velocity, where goal - position is clipped
    to 1 m.
    """

    requires: Mapping[str, Any] = MappingProxyType(
        {"action": "acceleration", "observation": "flat", "decision_rate": 48}
    )
    most_crossing: int | None = 13
    """The largest number of drones whose paths may intersect in one point with a safety filter: on
    circles of 13 drones all episodes succeed, of 14 two in five, of 15 none. None for agents that
    do not fly straight."""

    def __init__(self) -> None:
        self._goal = self._velocity = slice(0)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Store the columns of goal and velocity."""
        columns = {field.name: field.where for field in env.observation_layout}
        self._goal, self._velocity = columns["task.goal"], columns["self.velocity"]

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return actions (..., 3) for observation rows (..., row width) of drones."""
        offset, velocity = rows[..., self._goal], SPEED_LIMIT * rows[..., self._velocity]
        distance = np.sqrt(np.square(offset).sum(axis=-1, keepdims=True))
        return steer(4.0 * offset / np.maximum(distance, 1.0) - 4.0 * velocity)


def steer(desired: FloatArray | Float32Array) -> Float32Array:
    """Return actions for accelerations (..., 3), m/s^2, scaled to the limit if they exceed it."""
    size = np.abs(desired).max(axis=-1, keepdims=True) / ACCELERATION_LIMIT
    return (desired / ACCELERATION_LIMIT / np.maximum(size, 1.0)).astype(np.float32)


class SetpointAgent(ABC):
    """Base class of privileged agents whose actions are the set-points of a reference.

    Args:
        requires: options of the environment.
    """

    privileged = True

    def __init__(self, requires: Mapping[str, Any]) -> None:
        self.requires = requires
        self._agents: list[str] = []

    def check(self, task: Task) -> None:
        """Raise ValueError if the agent does not support a task; this class supports all."""

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Store the drones' names.

        Raises:
            ValueError: the agent does not support the task.
        """
        self.check(env.core.task)
        self._agents = list(env.agents)

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return position, velocity, acceleration and jerk of the reference, with zero yaw.

        Raises:
            ValueError: there is no view.
        """
        if view is None:
            raise ValueError(
                f"{type(self).__name__} is privileged: pass env.view as the view, for its goals"
            )
        reference = self.reference(view)
        rows = np.concatenate([*reference, np.zeros((len(self._agents), 2))], axis=1)
        return dict(zip(self._agents, rows, strict=True))

    @abstractmethod
    def reference(self, view: View) -> Reference:
        """Return the reference of the drones at this decision: arrays (N, 3)."""

    @staticmethod
    def goals_rest(task: Task) -> bool:
        """Return True if goals are final positions, not references to follow at every time."""
        return task.motion.rests or task.motion.kind == LINES

    def check_rest(self, task: Task) -> None:
        """Raise ValueError if the goals of a task move."""
        if not self.goals_rest(task):
            raise ValueError(
                f"{type(self).__name__} plans to goals at rest, but those of {task.name} move; "
                "use swap or formation, or the agent 'tracking+compensated'"
            )


class Flyable(Protocol):
    """The protocol of a plan."""

    def reference(self, time: float) -> Reference:
        """Return the reference at a time since the start, s: arrays (N, 3)."""


P = TypeVar("P", bound=Flyable)


class PlannedAgent(SetpointAgent, Generic[P]):
    """Base class of agents that plan when goals are set, and follow the plan."""

    def __init__(self, requires: Mapping[str, Any]) -> None:
        super().__init__(requires)
        self.plans: list[P] = []
        """The plans of the episode, one for each set of goals."""
        self._task: Task | None = None
        self._goals, self._began, self._seed = np.zeros((0, 3)), 0.0, 0

    @abstractmethod
    def plan(self, task: Task, view: View, seed: int) -> P:
        """Return a plan from the current set-points to the goals."""

    def check(self, task: Task) -> None:
        """Raise ValueError if the goals of a task move."""
        self.check_rest(task)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Plan the paths to the first goals; the seed is that of the planner.

        Raises:
            ValueError: the task is not supported, or there is no plan for its starts and goals.
        """
        super().reset(env, seed)
        self._task, self._seed, self.plans = env.core.task, seed, []
        self._plan(env.view)

    def reference(self, view: View) -> Reference:
        """Return the reference of the plan; plan again if the goals have changed."""
        if not np.array_equal(view.goals, self._goals):
            self._plan(view)
        return self.plans[-1].reference(view.time - self._began)

    def _plan(self, view: View) -> None:
        assert self._task is not None
        self._goals, self._began = view.goals.copy(), view.time
        self.plans.append(self.plan(self._task, view, self._seed))


SHARE = 0.75  # Duration of a path as a fraction of the duration of a stage
SAMPLES = 61  # Times at which paths are compared
SWEEPS = 12  # Largest number of choices of each drone
BESIDE_M, BELOW_M = 0.25, 0.6
"""Semi-axes, beyond the sum of radii, of the ellipsoid in which proximity has a cost, m."""
TOUCHING_M = 0.12
"""Distance beyond the sum of radii within which the cost is a hundred times as large, m."""
_HARD = 100.0
_LENGTH = 0.02
_AMPLITUDES = (0.3, 0.6, 0.9, 1.2, 1.5)
_TURNS = 12
_BUMP = np.polynomial.Polynomial([0.0, 1.0, -1.0]) ** 4 * 256.0
"""Scale of the bump over the fraction of time: 1 in the middle; 0 at both ends, with three zero
derivatives."""


def bumps(start: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the family of bumps (N, M, 3), m; the first is zero.

    Args:
        start: (N, 3) m.
        goal: (N, 3) m.
    """
    delta = goal - start
    level = np.stack([-delta[:, 1], delta[:, 0], np.zeros(len(delta))], axis=1)
    size = np.linalg.norm(level, axis=1, keepdims=True)
    side = np.where(size > 1e-6, level / np.maximum(size, 1e-6), [1.0, 0.0, 0.0])
    angle = 2 * np.pi * np.arange(_TURNS) / _TURNS
    sideways = side[:, None] * np.cos(angle)[:, None]
    upwards = np.array([0.0, 0.0, 1.0]) * np.sin(angle)[:, None]
    turned = [amplitude * (sideways + upwards) for amplitude in _AMPLITUDES]
    return np.concatenate([np.zeros((len(delta), 1, 3)), *turned], axis=1)


def along(
    start: FloatArray, goal: FloatArray, bump: FloatArray, duration: float, time: FloatArray | float
) -> Reference:
    """Return the path with a bump: arrays (..., 3), of arguments (..., 3) and times (...), s."""
    straight = rest_to_rest(start, goal, duration, time)
    u = np.clip(np.asarray(time, dtype=np.float64) / duration, 0.0, 1.0)
    parts = []
    for k, part in enumerate(straight):
        share = _BUMP.deriv(k)(u) if k else _BUMP(u)
        parts.append(part + bump * (share / duration**k)[..., None])
    return Reference(*parts)


def choose_bumps(
    start: FloatArray,
    goal: FloatArray,
    radius: FloatArray,
    arena: FloatArray,
    obstacles: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return bumps (N, 3), m, from best responses of the drones.

    Args:
        start: (N, 3) m.
        goal: (N, 3) m.
        radius: (N,) radii of the drones, m.
        arena: (2, 3) corners, m.
        obstacles: (M, 7) rows of `swarm_envs.physics.contact`.
        rng: the generator of the order of choices.
    """
    family, times = bumps(start, goal), np.linspace(0.0, 1.0, SAMPLES)
    paths = along(
        start[:, None, None], goal[:, None, None], family[:, :, None], 1.0, times
    ).position  # (N, M, T, 3)
    own = _LENGTH * np.linalg.norm(family, axis=-1) + _obstacle_cost(
        paths, radius, arena, obstacles
    )
    chosen = np.zeros(len(start), dtype=np.int64)
    for _ in range(SWEEPS):
        before = chosen.copy()
        for i in rng.permutation(len(start)).tolist():
            others = np.delete(np.arange(len(start)), i)
            met = paths[others, chosen[others]]
            chosen[i] = (
                own[i] + _proximity_cost(paths[i], met, radius[i] + radius[others])
            ).argmin()
        if (chosen == before).all():
            break
    return family[np.arange(len(start)), chosen]


def _proximity_cost(paths: FloatArray, others: FloatArray, touching: FloatArray) -> FloatArray:
    """Return the cost (M,) of paths (M, T, 3) near others (K, T, 3) with contact distances (K,)."""
    cost = np.zeros(len(paths))
    for other, contact in zip(others, touching, strict=True):
        square = np.square(paths - other)
        level, height = square[..., 0] + square[..., 1], square[..., 2]
        for beside, below, weight in (
            (BESIDE_M, BELOW_M, 1.0),
            (TOUCHING_M, TOUCHING_M, _HARD),
        ):
            ratio = level / (contact + beside) ** 2 + height / (contact + below) ** 2
            cost += weight * np.square(np.maximum(1.0 - ratio, 0.0)).mean(axis=1)
    return cost


def _obstacle_cost(
    paths: FloatArray, radius: FloatArray, arena: FloatArray, obstacles: FloatArray
) -> FloatArray:
    """Return the cost (N, M) of paths (N, M, T, 3) that leave the arena or are near obstacles."""
    margin = (radius + TOUCHING_M)[:, None, None]
    inside = np.minimum(paths - arena[0], arena[1] - paths).min(axis=-1)
    cost = np.square(np.maximum(1.0 - inside / margin, 0.0)).mean(axis=-1)
    if len(obstacles):
        near = obstacle_distances(obstacles, paths).min(axis=-1)
        cost += np.square(np.maximum(1.0 - near / margin, 0.0)).mean(axis=-1)
    return np.asarray(_HARD * cost)


class DetourAgent(SetpointAgent):
    """Agent that follows the paths of `choose_bumps`, or the task's reference if that moves.

    Args:
        controller: configuration of the tracking controller; None for the default, which does not
            compensate forces.
    """

    def __init__(self, controller: ControllerConfig | None = None) -> None:
        super().__init__({"action": "setpoint", "controller": controller or ControllerConfig()})
        self._arena: FloatArray = np.empty(0)
        self._rng = np.random.default_rng(0)
        self._plan: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self._since = self._duration = 0.0

    def check(self, task: Task) -> None:
        """Raise ValueError if the goals of a task change one at a time."""
        if isinstance(task.success, ByScore) and task.motion.rests:
            raise ValueError(
                f"DetourAgent plans the paths of all drones together, but in {task.name} each "
                "drone receives a new goal when it reaches one; use 'roundabout'"
            )

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Discard the plan of the last episode, and seed the order of the drones' choices.

        Raises:
            ValueError: the agent does not support the task.
        """
        super().reset(env, seed)
        self._arena = env.core.task.arena
        self._rng, self._plan = np.random.default_rng(seed), None

    def reference(self, view: View) -> Reference:
        """Return the reference of the path at this time, or the task's reference if that moves."""
        if view.reference_moves:
            return view.reference(view.time)
        if self._plan is None or not np.array_equal(self._plan[1], view.goals):
            start = np.array(view.state.position) if self._plan is None else self._plan[1]
            goal = np.array(view.goals)
            radius = np.array([vehicle.radius for vehicle in view.team])
            rows = obstacle_rows(view.obstacles)
            bump = choose_bumps(start, goal, radius, self._arena, rows, self._rng)
            self._plan, self._since = (start, goal, bump), view.time
            self._duration = SHARE * view.stage_s
        start, goal, bump = self._plan
        since = view.time - self._since
        return along(start, goal, bump, self._duration, np.full(len(goal), since))
