"""What is kept of a flight so that it can be plotted and filmed afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Team

if TYPE_CHECKING:
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.envs.view import View


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
    """(T, N, 3) where the drones should have been, m."""
    force: FloatArray
    """(T, N, 3) interaction force, N."""

    def height_error_cm(self, drone: int = -1) -> FloatArray:
        """Height over the reference (T,) of a drone, cm; by default of the lowest, the last."""
        return (self.position[:, drone, 2] - self.reference[:, drone, 2]) * 100.0

    def vertical_force_g(self, drone: int = -1) -> FloatArray:
        """Vertical interaction force (T,) on a drone, grams."""
        return np.asarray(self.force[:, drone, 2] / GRAM_FORCE)

    def worst_height_error_cm(self, drone: int = -1) -> float:
        """Largest distance of a drone from the reference's height, cm."""
        return float(np.abs(self.height_error_cm(drone)).max())


class Recorder:
    """Records a flight: give it to `fly_episode` as `watch`."""

    def __init__(self) -> None:
        self._team: Team = ()
        self._rows: list[tuple[FloatArray, ...]] = []

    def __call__(self, env: SwarmParallelEnv) -> None:
        """Take a sample of the environment's truth."""
        view = env.view
        self._team = view.team
        self._rows.append(_sample(view))

    def record(self) -> FlightRecord:
        """Everything so far.

        Raises:
            RuntimeError: nothing was recorded.
        """
        if not self._rows:
            raise RuntimeError("nothing was recorded; call the recorder after reset and steps")
        columns = (np.array(column) for column in zip(*self._rows, strict=True))
        return FlightRecord(self._team, *columns)


def _sample(view: View) -> tuple[FloatArray, ...]:
    state, reference = view.state, view.reference(view.time)
    arrays = (state.position, state.quaternion, reference.position, view.oracle_force)
    return (np.float64(view.time) * np.ones(()), *(array.copy() for array in arrays))


@dataclass(frozen=True)
class Comparison:
    """The same flights by two controllers: flight `i` of one has the same task as of the other."""

    title: str
    """Such as `L2S`."""
    without: Sequence[FlightRecord]
    """Flown without compensation."""
    compensated: Sequence[FlightRecord]
    """Flown with it."""

    @property
    def without_cm(self) -> FloatArray:
        """Worst height error of the lowest drone in each flight without compensation, cm."""
        return np.array([flight.worst_height_error_cm() for flight in self.without])

    @property
    def compensated_cm(self) -> FloatArray:
        """Worst height error of the lowest drone in each flight with compensation, cm."""
        return np.array([flight.worst_height_error_cm() for flight in self.compensated])
