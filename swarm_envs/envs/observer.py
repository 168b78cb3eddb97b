"""What the drones of E environments observe: the buffers, and who writes them."""

from __future__ import annotations

from collections.abc import Callable

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
from swarm_envs.state import BoolArray, FloatArray, IntArray, SwarmState
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team


class Observer:
    """Observes what flies, with or without noise.

    Args:
        flight: what flies.
        config: K neighbours, M obstacles, noise.
    """

    def __init__(self, flight: Flight, config: EnvConfig) -> None:
        physics = flight.physics
        envs, drones = physics.num_envs, len(physics.team)
        self.num_neighbors = config.num_neighbors
        self.num_obstacles = config.obstacles_observed(len(physics.obstacles))
        width = observation_width(self.num_neighbors, self.num_obstacles)
        self.rows: Float32Array = np.zeros((envs, drones, width), dtype=np.float32)
        self._whole: Float32Array = np.zeros((envs, drones, observation_width(0)), dtype=np.float32)
        self.noise_key: npt.NDArray[np.uint64] = np.zeros(envs, dtype=np.uint64)
        ranges = config.randomization
        self._noise = ranges.noise if ranges is not None and ranges.noisy else None
        self._physics, self._pilot = physics, flight.pilot
        self._sensed = physics.state if self._noise is None else physics.state.copy()
        self._lent_state, self._lent_sensed = lend(physics.state), lend(self._sensed.read_only())
        self._lent_parameters = lend(physics.parameters)
        self._lent_setpoint = lend(flight.pilot.setpoint)
        self._codes = np.repeat(type_codes(physics.team)[None], envs, axis=0)
        self._write: Callable[..., None] | None = None

    def set_team(self, e: int, team: Team) -> None:
        """Let environment `e` be flown by another team of as many drones."""
        self._codes[e] = type_codes(team)

    def observe(
        self,
        mask: BoolArray,
        decisions: IntArray,
        goal: FloatArray,
        reference: Reference,
        time_left: FloatArray,
    ) -> Float32Array:
        """Write and return the rows (E, N, width): a buffer, valid until the next call.

        Args:
            mask: (E,) environments to observe; the others' rows stay.
            decisions: (E,) how many decisions were flown: each is measured anew.
            goal: (E, N, 3) m.
            reference: arrays (E, N, 3).
            time_left: (E,) share of the clock.
        """
        if self._noise is not None:
            state = self._physics.state
            sense(state, self._noise, self.noise_key, decisions, mask, self._sensed)
        counts, motion = (self.num_neighbors, self.num_obstacles), self._lent_sensed
        return self._write_rows(motion, goal, reference, time_left, counts, mask, self.rows)

    def team_state(
        self, goal: FloatArray, reference: Reference, time_left: FloatArray
    ) -> Float32Array:
        """(E, N, width) the true state of every drone: its `self` and `task` fields, no noise."""
        everywhere, motion = np.ones(len(self._whole), dtype=np.bool_), self._lent_state
        return self._write_rows(motion, goal, reference, time_left, (0, 0), everywhere, self._whole)

    def _write_rows(
        self,
        state: SwarmState,
        goal: FloatArray,
        reference: Reference,
        time_left: FloatArray,
        counts: tuple[int, int],
        mask: BoolArray,
        out: Float32Array,
    ) -> Float32Array:
        """Write and return `out`, whose rows have so many neighbours and obstacles."""
        arguments = (
            state,
            self._lent_parameters,
            self._lent_setpoint,
            self._pilot.level != SETPOINTS,
            goal,
            reference,
            time_left,
            self._codes,
            counts[0],
            self._physics.obstacles,
            counts[1],
            mask,
            out,
        )
        self._write = self._write or entry_point(write_observations, *arguments)
        self._write(*arguments)
        return out
