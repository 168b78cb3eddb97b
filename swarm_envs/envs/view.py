"""Read-only access to the true state of an environment, for privileged agents and plots."""

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
    """The true state of one environment, float64, valid until the next step.

    Arrays are read-only views: copy those that should last, and those for libraries that reject
    read-only arrays, such as SciPy's `Rotation.from_quat`.
    """

    _core: SwarmCore
    _e: int = 0

    @property
    def team(self) -> Team:
        """The N vehicles of this episode."""
        return self._core.tasks[self._e].team

    @property
    def time(self) -> float:
        """The time since the beginning of the episode, s."""
        return float(self._core.time[self._e])

    @property
    def horizon_s(self) -> float:
        """The time limit, after which the episode is truncated, s."""
        return float(self._core.settings["horizon_s"][0])

    @property
    def stage_s(self) -> float:
        """The time between changes of goals, s; the time limit if there is one set of goals."""
        return self._core.task.motion.stage_s or self.horizon_s

    @property
    def state(self) -> SwarmState:
        """The state of the drones; arrays have shape (N, ...)."""
        return SwarmState(*(array[self._e] for array in self._core.physics.state))

    @property
    def goals(self) -> FloatArray:
        """The goal positions (N, 3), m."""
        return _frozen(self._core.world.drones["goal"][self._e])

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The static obstacles."""
        return self._core.task.obstacles

    @property
    def setpoint(self) -> Setpoint:
        """The present set-points of the tracking controller; arrays have shape (N, ...)."""
        drones = self._core.world.drones[self._e]
        return Setpoint(*(_frozen(drones[f"setpoint_{name}"]) for name in Setpoint._fields))

    @property
    def contacts(self) -> Contacts:
        """The contacts of the drones in the last decision; arrays have shape (N,)."""
        return Contacts(*(_frozen(array[self._e]) for array in self._core.physics.contacts))

    @property
    def oracle_force(self) -> FloatArray:
        """The environment's interaction force (N, 3) of the last physics step, N, world frame.

        It is for plots and oracles: a real controller cannot measure it.
        """
        return _frozen(self._core.physics.force[self._e])

    @property
    def reference_moves(self) -> bool:
        """True if the task has a reference trajectory; else the reference rests at the goals."""
        return not self._core.task.motion.rests

    def reference(self, time: float) -> Reference:
        """Return the reference at `time`, s; arrays have shape (N, 3)."""
        times = np.full(self._core.num_envs, time)
        full = self._core.task.reference(self._core.world, times)
        return Reference(*(_frozen(array[self._e]) for array in full))


def _frozen(array: _Array) -> _Array:
    view = array.view()
    view.flags.writeable = False
    return view
