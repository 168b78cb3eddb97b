"""Flying between two decisions: controller and physics at 240 Hz, on either engine.

The compiled engine does all steps of all environments in one call; Bullet's bodies are moved one
step at a time, with the same controller and the same bookkeeping.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import entry_point, inlined_kernel, kernel
from swarm_envs.control.config import ControlGains, ControllerConfig, compile_gains
from swarm_envs.control.state import ControllerState, Setpoint
from swarm_envs.control.tracking import extrapolate, track_env
from swarm_envs.interactions import load
from swarm_envs.interactions.blocks import Scratch, scratch_for
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.forces import swarm_forces
from swarm_envs.physics import BulletPhysics, Physics
from swarm_envs.physics.contact import NO_DRONE, Contacts
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.physics.step import World, blow, prepare_wrench, step_environment
from swarm_envs.state import (
    BoolArray,
    FloatArray,
    IntArray,
    Parameters,
    SwarmState,
    parameters,
)
from swarm_envs.vehicles import Team

AIR_DENSITY = 1.225
"""Density of air at sea level, kg/m^3."""


class Pilot(NamedTuple):
    """Who commands the rotors: the tracking loop, or the agent itself."""

    direct: bool
    """Whether the agent writes `commands` itself; else they follow the set-points."""
    setpoint: Setpoint
    memory: ControllerState
    gains: ControlGains
    nominal: Parameters
    """What the controller takes the drones to be."""
    believes: bool
    """Whether the controller compensates a force."""
    belief: ForceField
    """The force model in which it believes."""
    belief_types: IntArray
    """(E, N) interaction types of that model."""
    belief_force: FloatArray
    """(E, N, 3) the force it compensates now, N."""
    commands: FloatArray
    """(E, N, 4) commanded rotor thrusts, N."""


class Tally(NamedTuple):
    """What an episode's physics adds up to: arrays (E, N)."""

    worst_force: FloatArray
    """Largest interaction force so far, N."""
    energy: FloatArray
    """Ideal induced energy of the rotors, J: the integral of T^1.5 / sqrt(2 rho A) per rotor."""
    outside: IntArray
    """Physics steps with an interaction force extrapolated past what was measured."""
    steps: IntArray
    """Physics steps flown."""

    def clear(self, mask: BoolArray) -> None:
        """Begin anew in the environments of the mask."""
        for array in self:
            array[mask] = 0


@inlined_kernel
def decide(e: int, world: World, pilot: Pilot, scratch: Scratch) -> None:
    """One controller step of environment `e`: set-points, belief and state to rotor commands."""
    if pilot.direct:
        return
    if pilot.believes:
        position, velocity = world.state.position[e], world.state.velocity[e]
        types, force = pilot.belief_types[e], pilot.belief_force[e]
        swarm_forces(pilot.belief, len(types), types, position, velocity, scratch, force)
    track_env(
        e,
        world.state,
        pilot.nominal,
        pilot.memory,
        pilot.setpoint,
        pilot.belief_force[e],
        pilot.gains,
        pilot.commands,
    )
    extrapolate(pilot.setpoint, e, TIME_STEP)


@inlined_kernel
def count(e: int, world: World, tally: Tally, disc_area: FloatArray) -> None:
    """Add one physics step of environment `e`, its force just evaluated, to the tally.

    Args:
        e: the environment.
        world: its state, at the beginning of the step.
        tally: changed in place.
        disc_area: (N,) swept area of one rotor, m^2.
    """
    force, thrust = world.force, world.state.rotor_thrust
    for i in range(disc_area.shape[0]):
        size = 0.0
        for k in range(3):
            size += force[e, i, k] * force[e, i, k]
        tally.worst_force[e, i] = max(tally.worst_force[e, i], math.sqrt(size))
        power = 0.0
        for r in range(4):
            power += thrust[e, i, r] * math.sqrt(max(thrust[e, i, r], 0.0))
        scale = TIME_STEP / math.sqrt(2.0 * AIR_DENSITY * disc_area[i])
        tally.energy[e, i] += power * scale
        tally.outside[e, i] += world.outside[e, i]
        tally.steps[e, i] += 1


@kernel
def forget(e: int, contacts: Contacts) -> None:
    """Forget what environment `e` touched, before the next decision is flown."""
    for i in range(contacts.drone.shape[1]):
        contacts.drone[e, i] = NO_DRONE
        contacts.floor[e, i] = contacts.wall[e, i] = contacts.tumbling[e, i] = False
        contacts.separation[e, i] = contacts.clearance[e, i] = np.inf


@kernel
def fly_compiled(
    world: World,
    pilot: Pilot,
    tally: Tally,
    disc_area: FloatArray,
    still: FloatArray,
    total: FloatArray,
    running: BoolArray,
    steps: int,
) -> None:
    """Fly `steps` physics steps of every running environment on the compiled engine.

    Args:
        world: changed in place.
        pilot: changed in place.
        tally: changed in place.
        disc_area: (N,) swept area of one rotor, m^2.
        still: (E, N, 3) zeros, N: the external force.
        total: (E, N, 3) scratch.
        running: (E,) environments to fly.
        steps: number of steps of 1/240 s.
    """
    drones = total.shape[1]
    scratch, belief_scratch = scratch_for(world.field, drones), scratch_for(pilot.belief, drones)
    for e in range(total.shape[0]):
        if running[e]:
            forget(e, world.contacts)
            for _ in range(steps):
                decide(e, world, pilot, belief_scratch)
                blow(e, world, scratch)
                count(e, world, tally, disc_area)
                step_environment(e, world, pilot.commands, still, total)


@kernel
def prepare_flight(
    e: int,
    first: bool,
    world: World,
    pilot: Pilot,
    tally: Tally,
    disc_area: FloatArray,
    still: FloatArray,
    wrench: FloatArray,
) -> None:
    """One step of environment `e` up to the wrench, for Bullet.

    Args:
        e: the environment.
        first: whether it is the first step of a decision.
        world: changed in place.
        pilot: changed in place.
        tally: changed in place.
        disc_area: (N,) swept area of one rotor, m^2.
        still: (E, N, 3) zeros, N: the external force.
        wrench: (N, 6) force (N) and torque (N m) on each body in its own frame, written.
    """
    if first:
        forget(e, world.contacts)
    drones = wrench.shape[0]
    decide(e, world, pilot, scratch_for(pilot.belief, drones))
    blow(e, world, scratch_for(world.field, drones))
    count(e, world, tally, disc_area)
    prepare_wrench(e, world, pilot.commands, still, wrench)


def disc_areas(team: Team) -> FloatArray:
    """Swept area (N,) of one rotor of each vehicle, m^2."""
    return np.array([math.pi * vehicle.rotor_radius**2 for vehicle in team])


class Flight:
    """The controller and the physics of E environments, flown from decision to decision.

    Args:
        physics: the engine.
        config: of the tracking loop.
        direct: whether the agent commands rotors itself.
    """

    def __init__(self, physics: Physics, config: ControllerConfig, direct: bool) -> None:
        envs, drones = physics.num_envs, len(physics.team)
        belief = load("none" if config.feedforward is None else config.feedforward)
        self.physics = physics
        self.pilot = Pilot(
            direct=direct,
            setpoint=Setpoint.zeros(envs, drones),
            memory=ControllerState.zeros(envs, drones),
            gains=compile_gains(config),
            nominal=parameters(physics.team, envs),
            believes=config.feedforward is not None,
            belief=belief.field,
            belief_types=np.repeat(belief.type_indices(physics.team)[None], envs, axis=0),
            belief_force=np.zeros((envs, drones, 3)),
            commands=np.zeros((envs, drones, 4)),
        )
        shape = (envs, drones)
        self.tally = Tally(
            np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        )
        still = np.zeros((envs, drones, 3))
        self._arguments = (physics.world, self.pilot, self.tally, disc_areas(physics.team), still)
        self._total = np.zeros((envs, drones, 3))
        self._entry: Callable[..., None] | None = None

    def reset(self, state: SwarmState, mask: BoolArray) -> None:
        """Place the drones, at rest on their set-points, in the environments of the mask."""
        self.physics.reset(state, mask)
        self.pilot.memory.reset(mask)
        self.pilot.belief_force[mask] = 0.0
        self.pilot.commands[mask] = state.rotor_thrust[mask]
        self.pilot.setpoint.assign(Setpoint.hold(state.position), mask)
        self.tally.clear(mask)

    def fly(self, steps: int, running: BoolArray) -> None:
        """Fly `steps` physics steps in the running environments (E,)."""
        if isinstance(self.physics, BulletPhysics):
            self._fly_bullet(self.physics, steps, running)
        else:
            arguments = (*self._arguments, self._total, running, steps)
            if self._entry is None:
                self._entry = entry_point(fly_compiled, *arguments)
            self._entry(*arguments)

    def _fly_bullet(self, physics: BulletPhysics, steps: int, running: BoolArray) -> None:
        arguments = (*self._arguments, physics.wrench)
        if self._entry is None:
            self._entry = entry_point(prepare_flight, 0, True, *arguments)
        for e in np.flatnonzero(running).tolist():
            for k in range(steps):
                self._entry(e, k == 0, *arguments)
                physics.move_bodies(e)
