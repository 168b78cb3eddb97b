"""Recordings of flights, which can be plotted, rendered, replayed and written to a file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.state import BoolArray, FloatArray, IntArray, SwarmState
from swarm_envs.vehicles import GRAM_FORCE, Team

if TYPE_CHECKING:
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.tasks.obstacles import Obstacle

__all__ = ["About", "FlightRecord", "Recorder", "Recording", "Solid"]

_SIDES = 20  # Number of sides of the prism that approximates a cylinder


class Solid(NamedTuple):
    """An axis-aligned box, or the largest upright cylinder inside it."""

    round: bool
    """True for the cylinder."""
    low: tuple[float, float, float]
    """Lowest corner of the box, m."""
    high: tuple[float, float, float]
    """Highest corner of the box, m."""

    def rings(self) -> FloatArray:
        """Return the outlines (2, K, 3) of bottom and top, m, counter-clockwise from above."""
        low, high = np.array(self.low), np.array(self.high)
        if self.round:
            angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
            unit = 0.5 + 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        outline = low[:2] + unit * (high - low)[:2]
        return np.stack(
            [np.column_stack([outline, np.full(len(unit), z)]) for z in (low[2], high[2])]
        )


def solids(obstacles: Iterable[Obstacle], ceiling: float) -> tuple[Solid, ...]:
    """Return the obstacles of a task as solids, in the same order.

    They are clipped at the height of the arena, `ceiling`, m.
    """
    found = []
    for obstacle in obstacles:
        low, high = obstacle.corners
        top = min(float(high[2]), ceiling)
        lowest = (float(low[0]), float(low[1]), float(low[2]))
        highest = (float(high[0]), float(high[1]), top)
        found.append(Solid(hasattr(obstacle, "radius"), lowest, highest))
    return tuple(found)


@dataclass(frozen=True)
class FlightRecord:
    """A flight of N drones, sampled T times. World frame, SI."""

    team: Team
    """The N vehicles."""
    time: FloatArray
    """(T,) s since the start."""
    position: FloatArray
    """(T, N, 3) m."""
    quaternion: FloatArray
    """(T, N, 4) attitude, (x, y, z, w), body to world."""
    reference: FloatArray
    """(T, N, 3) reference positions, m."""
    force: FloatArray
    """(T, N, 3) interaction force, N."""

    def state(self, index: int) -> SwarmState:
        """Return the poses of a sample for a camera, with zero velocities."""
        rest, n = np.zeros_like(self.position[index]), len(self.team)
        pose = self.position[index], self.quaternion[index]
        return SwarmState(pose[0], rest, pose[1], rest, np.zeros((n, 4)), np.ones(n))

    def height_error_cm(self, drone: int = -1) -> FloatArray:
        """Return a drone's height above the reference (T,), cm; by default of the last drone."""
        return (self.position[:, drone, 2] - self.reference[:, drone, 2]) * 100.0

    def vertical_force_g(self, drone: int = -1) -> FloatArray:
        """Return the vertical interaction force (T,) on a drone, grams."""
        return np.asarray(self.force[:, drone, 2] / GRAM_FORCE)

    def worst_height_error_cm(self, drone: int = -1) -> float:
        """Return the largest absolute height error of a drone, cm."""
        return float(np.abs(self.height_error_cm(drone)).max())


@dataclass(frozen=True)
class About:
    """The constants of a recorded episode."""

    task: str
    """Versioned name, such as `swap_v1`."""
    agent: str
    """Name of the agent; empty if unknown."""
    seed: int | None
    """Seed of the episode; None if unknown."""
    physics: str
    """Physics engine: `bullet` or `batch`."""
    decision_rate: int
    """Samples per second, Hz: one for each decision."""
    arena: tuple[tuple[float, ...], ...]
    """The two corners of the arena, m."""
    solids: tuple[Solid, ...]
    """The static obstacles."""
    metrics: Mapping[str, Any]
    """Metrics of the episode; empty if it had not ended."""


@dataclass(frozen=True)
class Recording(FlightRecord):
    """An episode of N drones: T samples, one after the reset and one after each decision.

    World frame, SI. Contacts and rewards are those of the decision that ends at the sample.
    """

    velocity: FloatArray
    """(T, N, 3) m/s."""
    rotor_thrust: FloatArray
    """(T, N, 4) thrust of each rotor, N."""
    goal: FloatArray
    """(T, N, 3) goals, m."""
    setpoint: FloatArray
    """(T, N, 3) position set-points of the tracking controller, m."""
    contact_drone: IntArray
    """(T, N) index of the drone in contact, or -1."""
    contact_floor: BoolArray
    """(T, N) True for a contact with the floor."""
    contact_wall: BoolArray
    """(T, N) True for a contact with a wall or the ceiling."""
    contact_obstacle: IntArray
    """(T, N) index of the obstacle in contact, or -1."""
    tumbling: BoolArray
    """(T, N) True if the drone rotates faster than 150 rad/s."""
    reward: FloatArray
    """(T, N) weighted sum of the reward terms; NaN if unknown."""
    reward_terms: Mapping[str, FloatArray]
    """(T, N) each reward term before its weight; NaN if unknown."""
    about: About
    """The constants of the episode."""


class Recorder:
    """Recorder of an episode: pass it to `fly_episode` as `watch`, or call `take`.

    Args:
        agent: name of the agent, stored in the recording.
        seed: seed of the episode, stored in the recording.
    """

    def __init__(self, agent: str = "", seed: int | None = None) -> None:
        self._agent, self._seed = agent, seed
        self._team: Team = ()
        self._about: About | None = None
        self._rows: list[dict[str, Any]] = []
        self._terms: tuple[str, ...] = ()

    def __call__(self, env: SwarmParallelEnv) -> None:
        """Record a sample of the true state, without rewards."""
        self.take(env)

    def take(
        self,
        env: SwarmParallelEnv,
        rewards: Mapping[str, float] | None = None,
        infos: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Record a sample of the true state, and the rewards and infos of the step."""
        task, agents = env.core.task, env.possible_agents
        self._team, self._terms = env.view.team, task.reward_names
        by_drone = [(infos or {}).get(agent, {}) for agent in agents]
        self._about = About(
            task=task.name,
            agent=self._agent,
            seed=self._seed,
            physics=env.physics_name,
            decision_rate=env.core.config.decision_rate,
            arena=tuple(map(tuple, task.arena.tolist())),
            solids=solids(task.obstacles, float(task.arena[1, 2])),
            metrics=next((i["episode_metrics"] for i in by_drone if "episode_metrics" in i), {}),
        )
        row = _sample(env)
        row["reward"] = np.array([(rewards or {}).get(agent, np.nan) for agent in agents])
        terms = [info.get("reward_terms", {}) for info in by_drone]
        row["terms"] = np.array([[t.get(name, np.nan) for t in terms] for name in self._terms])
        self._rows.append(row)

    def record(self) -> Recording:
        """Return the recording of all samples; raise RuntimeError if there is none."""
        if self._about is None:
            raise RuntimeError("nothing was recorded; call the recorder after reset and each step")
        columns: dict[str, Any] = {
            name: np.array([row[name] for row in self._rows]) for name in self._rows[0]
        }
        terms = columns.pop("terms")
        named = {name: terms[:, k].copy() for k, name in enumerate(self._terms)}
        return Recording(self._team, reward_terms=named, about=self._about, **columns)


def _sample(env: SwarmParallelEnv) -> dict[str, Any]:
    view = env.view
    state, contacts = view.state, view.contacts
    row = {
        "time": np.float64(view.time),
        "position": state.position,
        "quaternion": state.quaternion,
        "reference": view.reference(view.time).position,
        "force": view.oracle_force,
        "velocity": state.velocity,
        "rotor_thrust": state.rotor_thrust,
        "goal": view.goals,
        "setpoint": view.setpoint.position,
        "contact_drone": contacts.drone,
        "contact_floor": contacts.floor,
        "contact_wall": contacts.wall,
        "contact_obstacle": contacts.obstacle,
        "tumbling": contacts.tumbling,
    }
    return {name: np.array(value) for name, value in row.items()}
