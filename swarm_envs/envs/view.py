"""What a privileged agent sees: the true state, read-only, of a single environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.control.state import Setpoint
from swarm_envs.state import FloatArray, SwarmState
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


@dataclass(frozen=True)
class View:
    """The truth about environment `e`, float64, valid until the next step."""

    core: SwarmCore
    e: int = 0

    @property
    def team(self) -> Team:
        """The N vehicles."""
        return self.core.task.team

    @property
    def time(self) -> float:
        """Seconds since the episode began."""
        return float(self.core.time[self.e])

    @property
    def state(self) -> SwarmState:
        """State whose arrays lead with N alone."""
        return SwarmState(*(array[self.e] for array in self.core.physics.state))

    @property
    def goals(self) -> FloatArray:
        """(N, 3) goal positions, m."""
        return _frozen(self.core.mission.goal[self.e])

    @property
    def setpoint(self) -> Setpoint:
        """What the tracking loop follows now; arrays lead with N alone."""
        return Setpoint(*(_frozen(array[self.e]) for array in self.core.flight.pilot.setpoint))

    @property
    def force(self) -> FloatArray:
        """(N, 3) interaction force of the last physics step, N, world frame: the environment's."""
        return _frozen(self.core.physics.force[self.e])

    def reference(self, time: float) -> Reference:
        """Where the drones should be at `time`, s: arrays (N, 3)."""
        times = np.full(self.core.num_envs, time)
        full = self.core.task.reference(self.core.mission, times)
        return Reference(*(_frozen(array[self.e]) for array in full))


def _frozen(array: FloatArray) -> FloatArray:
    view = array.view()
    view.flags.writeable = False
    return view
