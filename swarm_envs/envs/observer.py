"""What the drones of E environments observe: the buffers, and who writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.borrowed import lend
from swarm_envs.compiled import entry_point
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.flight import Flight
from swarm_envs.envs.observation import Float32Array, observation_width, type_codes
from swarm_envs.envs.pilot import SETPOINTS
from swarm_envs.envs.rows import write_observations
from swarm_envs.envs.sensing import sense
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team


class Aims(NamedTuple):
    """Where drones belong, and when: what is looked at anew in each observation."""

    goal: FloatArray
    """(E, N, 3) m."""
    reference: Reference
    """Arrays (E, N, 3)."""
    time: FloatArray
    """(E,) s."""
    horizon_s: float
    """The clock, s."""


class Observer:
    """Observes what flies, with or without noise.

    Args:
        flight: what flies.
        config: K neighbours, M obstacles, noise.
        aims: where drones belong, and when.
    """

    def __init__(self, flight: Flight, config: EnvConfig, aims: Aims) -> None:
        physics = flight.physics
        envs, drones = physics.num_envs, len(physics.team)
        self.num_neighbors = config.num_neighbors
        self.num_obstacles = config.obstacles_observed(len(physics.obstacles))
        self.rows = _rows(envs, drones, self.num_neighbors, self.num_obstacles)
        self._whole = _rows(envs, drones)
        self.noise_key: npt.NDArray[np.uint64] = np.zeros(envs, dtype=np.uint64)
        ranges = config.randomization
        self._noise = ranges.noise if ranges is not None and ranges.noisy else None
        self._physics, self._sensed = physics, physics.state
        if self._noise is not None:
            self._sensed = physics.state.copy()
        self._codes = np.repeat(type_codes(physics.team)[None], envs, axis=0)
        self._write: Callable[..., None] | None = None
        direct = flight.pilot.level != SETPOINTS
        shared: tuple[Any, ...] = (
            lend(physics.parameters),
            lend(flight.pilot.setpoint),
            direct,
            aims.goal,
            lend(aims.reference),
            aims.time,
            aims.horizon_s,
            self._codes,
            physics.world.order,
            physics.obstacles,
        )
        self._workers = flight.workers
        self._measured = (lend(self._sensed.read_only()), *shared, self.num_obstacles)
        self._true = (lend(physics.state.read_only()), *shared, 0)
        self._scratch = [_scratch(self.num_neighbors) for _ in range(self._workers.threads)]

    def set_team(self, e: int, team: Team) -> None:
        """Let environment `e` be flown by another team of as many drones."""
        self._codes[e] = type_codes(team)

    def observe(self, mask: BoolArray, decisions: IntArray) -> Float32Array:
        """Write and return the rows (E, N, width): a buffer, valid until the next call.

        Args:
            mask: (E,) environments to observe; the others' rows stay.
            decisions: (E,) how many decisions were flown: each is measured anew.
        """
        if self._noise is not None:
            state = self._physics.state
            sense(state, self._noise, self.noise_key, decisions, mask, self._sensed)
        self._write_rows((mask, self.rows, *self._measured), self._scratch)
        return self.rows

    def team_state(self) -> Float32Array:
        """(E, N, width) the true state of every drone: its `self` and `task` fields, no noise."""
        everywhere = np.ones(len(self._whole), dtype=np.bool_)
        nobody = [_scratch(0)] * self._workers.threads
        self._write_rows((everywhere, self._whole, *self._true), nobody)
        return self._whole

    def _write_rows(self, given: tuple[Any, ...], scratch: Sequence[_Scratch]) -> None:
        if self._write is None:
            self._write = entry_point(write_observations, 0, 0, *given, *scratch[0])
        self._workers.share(self._write, given, scratch)


_Scratch = tuple[IntArray, FloatArray]


def _scratch(num_neighbors: int) -> _Scratch:
    return np.zeros(num_neighbors, np.int64), np.zeros(num_neighbors)


def _rows(envs: int, drones: int, num_neighbors: int = 0, num_obstacles: int = 0) -> Float32Array:
    width = observation_width(num_neighbors, num_obstacles)
    return np.zeros((envs, drones, width), dtype=np.float32)
