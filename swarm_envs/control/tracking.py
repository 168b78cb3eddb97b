"""The tracking controller of Neural-Swarm2, Sec. VI, for use outside environments.

Rotors: 1 front right, 2 back right, 3 back left, 4 front left; body x forward, y left, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from swarm_envs.control.config import ControllerConfig, gains
from swarm_envs.errors import check_array
from swarm_envs.interactions import load
from swarm_envs.physics.base import BatchPhysics
from swarm_envs.physics.step import SETPOINTS
from swarm_envs.state import BoolArray, FloatArray, Setpoint, SwarmState
from swarm_envs.vehicles import Vehicle

__all__ = ["TrackingController"]


class TrackingController:
    """The tracking controller of a team, for use outside environments.

    It has a state: call `commands` once per step of dt, and `reset` when a flight begins.

    Args:
        team: the N vehicles.
        num_envs: E, the number of teams.
        config: the configuration; None for the default.
        dt: duration of a controller step, s.

    Raises:
        ValueError: `num_envs` is below one, or dt is not positive.
    """

    def __init__(
        self,
        team: Sequence[Vehicle],
        num_envs: int = 1,
        config: ControllerConfig | None = None,
        dt: float = 1.0 / 240.0,
    ) -> None:
        self.config = ControllerConfig() if config is None else config
        self.team, self.num_envs = tuple(team), num_envs
        own = replace(self.config, feedforward=None)  # the force is written by `commands`
        self._loop = BatchPhysics(
            self.team, num_envs, interactions="none", level=SETPOINTS, controller=own
        )
        for name, value in gains(own, dt).items():
            self._loop.settings[name] = value
        drones = self._loop.world.drones
        drones["nominal_motor_decay"] = np.exp(-drones["nominal_motor_rate"] * dt)
        self.reset()

    def reset(self, mask: BoolArray | None = None) -> None:
        """Reset the controller's state in the environments of the mask (E,), by default in all."""
        where = np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask
        self._loop.begin(np.flatnonzero(where), at_rest=False)

    def commands(
        self, state: SwarmState, setpoint: Setpoint, feedforward: FloatArray | None = None
    ) -> FloatArray:
        """Return the rotor thrust commands (E, N, 4), N, of one step.

        Args:
            state: the measured state.
            setpoint: the present set-points.
            feedforward: (E, N, 3) interaction forces to compensate, N, world frame; None for those
                of the configuration's model, or zero without one.

        Raises:
            ValueError: an array has a wrong shape or an entry that is not finite. The controller's
                state was not changed.
        """
        shape = (self.num_envs, len(self.team))
        drones = self._loop.world.drones
        measured = ("position", "velocity", "quaternion", "angular_velocity")
        given = {name: getattr(state, name) for name in measured}
        given |= {f"setpoint_{name}": array for name, array in setpoint._asdict().items()}
        for name, value in given.items():
            owner = "Setpoint" if name.startswith("setpoint_") else "SwarmState"
            width = drones.dtype[name].shape
            check_array(f"{owner}.{name.removeprefix('setpoint_')}", value, (*shape, *width))
        if feedforward is None and self.config.feedforward is not None:
            model = load(self.config.feedforward)
            feedforward = model.forces(state.position, state.velocity, self.team)
        force = np.zeros((*shape, 3)) if feedforward is None else feedforward
        given["feedforward_force"] = check_array("feedforward", force, (*shape, 3))
        for name, value in given.items():
            drones[name] = value
        self._loop.control()
        return drones["commands"].copy()
