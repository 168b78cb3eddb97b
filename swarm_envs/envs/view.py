"""What a privileged agent sees: the true state, read-only, of a single environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from swarm_envs.physics.contact import Contacts
from swarm_envs.state import FloatArray, Setpoint, SwarmState
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore

__all__ = ["View"]

_Array = TypeVar("_Array", bound=npt.NDArray[Any])


@dataclass(frozen=True)
class View:
    """The truth about one environment, float64, valid until the next step.

    Arrays are read-only views: copy what should last, or what goes to a library that refuses
    read-only arrays, as scipy's `Rotation.from_quat` does.
    """

    _core: SwarmCore
    _e: int = 0

    @property
    def team(self) -> Team:
        """The N vehicles that fly this episode."""
        return self._core.tasks[self._e].team

    @property
    def time(self) -> float:
        """Seconds since the episode began."""
        return float(self._core.time[self._e])

    @property
    def horizon_s(self) -> float:
        """Time limit, s, after which the episode is truncated."""
        return float(self._core.settings["horizon_s"][0])

    @property
    def stage_s(self) -> float:
        """Time between goal changes, s; the time limit where there is one set of goals."""
        return self._core.task.motion.stage_s or self.horizon_s

    @property
    def state(self) -> SwarmState:
        """State whose arrays lead with N alone."""
        return SwarmState(*(array[self._e] for array in self._core.physics.state))

    @property
    def goals(self) -> FloatArray:
        """(N, 3) goal positions, m."""
        return _frozen(self._core.world.drones["goal"][self._e])

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Static obstacles, the same in every episode."""
        return self._core.task.obstacles

    @property
    def setpoint(self) -> Setpoint:
        """What the tracking loop follows now; arrays lead with N alone."""
        drones = self._core.world.drones[self._e]
        return Setpoint(*(_frozen(drones[f"setpoint_{name}"]) for name in Setpoint._fields))

    @property
    def contacts(self) -> Contacts:
        """What the drones touched in the last decision; arrays lead with N alone."""
        return Contacts(*(_frozen(array[self._e]) for array in self._core.physics.contacts))

    @property
    def oracle_force(self) -> FloatArray:
        """(N, 3) the environment's own force of the last physics step, N, world frame.

        For plots and oracles: a controller that reads it knows what no real one could.
        """
        return _frozen(self._core.physics.force[self._e])

    @property
    def reference_moves(self) -> bool:
        """Whether the task says how to get there; else its reference rests at the goals."""
        return not self._core.task.motion.rests

    def reference(self, time: float) -> Reference:
        """Where the drones should be at `time`, s: arrays (N, 3)."""
        times = np.full(self._core.num_envs, time)
        full = self._core.task.reference(self._core.world, times)
        return Reference(*(_frozen(array[self._e]) for array in full))


def _frozen(array: _Array) -> _Array:
    view = array.view()
    view.flags.writeable = False
    return view
