"""Flying between two decisions: controller and physics at 240 Hz, on either engine.

The compiled engine does all steps of all environments in one call; Bullet's bodies are moved one
step at a time, with the same controller and the same bookkeeping.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.borrowed import lend
from swarm_envs.compiled import borrowing_kernel, entry_point
from swarm_envs.control.config import ControlGains, ControllerConfig, compile_gains
from swarm_envs.control.rates import hold_rates
from swarm_envs.control.state import ControllerState, Setpoint
from swarm_envs.control.tracking import extrapolate, track_env
from swarm_envs.envs.tally import Airframe, Tally, airframe_of, count, new_tally
from swarm_envs.interactions import load
from swarm_envs.interactions.blocks import Scratch, scratch_for
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.forces import swarm_forces
from swarm_envs.physics import BulletPhysics, Physics
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE, Contacts
from swarm_envs.physics.gusts import gust
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

SETPOINTS, RATES, ROTORS = 0, 1, 2
"""What an agent commands: set-points of the tracking loop, thrust and body rates, or the rotors."""


class Pilot(NamedTuple):
    """Who commands the rotors: the tracking loop, its inner part, or the agent itself."""

    level: int
    """SETPOINTS, RATES or ROTORS: where actions enter. At ROTORS the agent writes `commands`."""
    setpoint: Setpoint
    asked: FloatArray
    """(E, N, 4) at RATES: total thrust, N, and body rates, rad/s."""
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


@borrowing_kernel
def decide(e: int, world: World, pilot: Pilot, scratch: Scratch) -> None:
    """One controller step of environment `e`: set-points, belief and state to rotor commands."""
    if pilot.level == ROTORS:
        return
    if pilot.level == RATES:
        world_state, memory = world.state, pilot.memory
        hold_rates(e, world_state, pilot.nominal, memory, pilot.asked, pilot.gains, pilot.commands)
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


@borrowing_kernel
def forget(e: int, contacts: Contacts) -> None:
    """Forget what environment `e` touched, before the next decision is flown."""
    for i in range(contacts.drone.shape[1]):
        contacts.drone[e, i] = NO_DRONE
        contacts.floor[e, i] = contacts.wall[e, i] = contacts.tumbling[e, i] = False
        contacts.separation[e, i] = contacts.clearance[e, i] = np.inf
        contacts.obstacle[e, i], contacts.obstacle_clearance[e, i] = NO_OBSTACLE, np.inf


@borrowing_kernel
def fly_compiled(
    world: World,
    pilot: Pilot,
    tally: Tally,
    airframe: Airframe,
    external: FloatArray,
    total: FloatArray,
    running: BoolArray,
    steps: int,
    first: int,
    last: int,
    scratch: Scratch,
    belief_scratch: Scratch,
) -> None:
    """Fly `steps` physics steps of the running environments first to last - 1, compiled.

    Args:
        world: changed in place.
        pilot: changed in place.
        tally: changed in place.
        airframe: what the tally knows of the drones.
        external: (E, N, 3) force of gusts, N; zeros without.
        total: (E, N, 3) scratch.
        running: (E,) environments to fly.
        steps: number of steps of 1/240 s.
        first: the first environment to fly.
        last: one past the last.
        scratch: working memory for the world's force model.
        belief_scratch: the same for the controller's.
    """
    for e in range(first, last):
        if running[e]:
            forget(e, world.contacts)
            for _ in range(steps):
                decide(e, world, pilot, belief_scratch)
                blow(e, world, scratch)
                count(e, world, tally, airframe)
                gust(e, world.age[e], world.gusts, world.parameters.mass, external)
                step_environment(e, world, pilot.commands, external, total)


@borrowing_kernel
def prepare_flight(
    e: int,
    first: bool,
    world: World,
    pilot: Pilot,
    tally: Tally,
    airframe: Airframe,
    external: FloatArray,
    wrench: FloatArray,
    scratch: Scratch,
    belief_scratch: Scratch,
) -> None:
    """One step of environment `e` up to the wrench, for Bullet.

    Args:
        e: the environment.
        first: whether it is the first step of a decision.
        world: changed in place.
        pilot: changed in place.
        tally: changed in place.
        airframe: what the tally knows of the drones.
        external: (E, N, 3) force of gusts, N; zeros without.
        wrench: (N, 6) force (N) and torque (N m) on each body in its own frame, written.
        scratch: working memory for the world's force model.
        belief_scratch: the same for the controller's.
    """
    if first:
        forget(e, world.contacts)
    decide(e, world, pilot, belief_scratch)
    blow(e, world, scratch)
    count(e, world, tally, airframe)
    gust(e, world.age[e], world.gusts, world.parameters.mass, external)
    prepare_wrench(e, world, pilot.commands, external, wrench)


def parts(num_envs: int, threads: int) -> list[tuple[int, int]]:
    """Contiguous ranges (first, last + 1) of environments, one a thread, as equal as can be."""
    edges = np.linspace(0, num_envs, min(threads, num_envs) + 1).round().astype(int).tolist()
    return list(itertools.pairwise(edges))


class Flight:
    """The controller and the physics of E environments, flown from decision to decision.

    Args:
        physics: the engine.
        config: of the tracking loop.
        level: SETPOINTS, RATES or ROTORS: where actions enter.
        bounds_g: as for `airframe_of`.
        threads: how many fly the environments of a batch, each its part of them.
    """

    def __init__(
        self,
        physics: Physics,
        config: ControllerConfig,
        level: int,
        bounds_g: Mapping[str, float],
        threads: int = 1,
    ) -> None:
        envs, drones = physics.num_envs, len(physics.team)
        belief = load("none" if config.feedforward is None else config.feedforward)
        self.physics = physics
        self.pilot = Pilot(
            level=level,
            setpoint=Setpoint.zeros(envs, drones),
            asked=np.zeros((envs, drones, 4)),
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
        self.tally = new_tally(*shape)
        external = np.zeros((envs, drones, 3))
        airframe = airframe_of(physics.team, bounds_g)
        tuples = (physics.world, self.pilot, self.tally, airframe)
        self._arguments: tuple[Any, ...] = (*map(lend, tuples), external)
        self._total = np.zeros((envs, drones, 3))
        self._parts = parts(envs, threads)
        self._scratch = [
            tuple(lend(scratch_for(field, drones)) for field in (physics.world.field, belief.field))
            for _ in self._parts
        ]
        self._workers = ThreadPoolExecutor(threads - 1) if len(self._parts) > 1 else None
        self._entry: Callable[..., None] | None = None

    def reset(self, state: SwarmState, mask: BoolArray) -> None:
        """Place the drones, at rest on their set-points, in the environments of the mask."""
        self.physics.reset(state, mask)
        self.pilot.memory.reset(mask)
        self.pilot.belief_force[mask] = 0.0
        self.pilot.commands[mask] = state.rotor_thrust[mask]
        self.pilot.asked[mask] = 0.0
        self.pilot.asked[mask, :, 0] = state.rotor_thrust[mask].sum(axis=-1)
        self.pilot.setpoint.assign(Setpoint.hold(state.position), mask)
        self.tally.clear(mask)

    def fly(self, steps: int, running: BoolArray) -> None:
        """Fly `steps` physics steps in the running environments (E,)."""
        if isinstance(self.physics, BulletPhysics):
            self._fly_bullet(self.physics, steps, running)
        else:
            self._fly_compiled(steps, running)

    def close(self) -> None:
        """Let the worker threads end."""
        if self._workers is not None:
            self._workers.shutdown()

    def _fly_compiled(self, steps: int, running: BoolArray) -> None:
        shared = (*self._arguments, self._total, running, steps)
        calls: list[tuple[Any, ...]] = [
            (*shared, *part, *own) for part, own in zip(self._parts, self._scratch, strict=True)
        ]
        if self._entry is None:
            self._entry = entry_point(fly_compiled, *calls[0])
        fly: Callable[..., None] = self._entry
        workers = self._workers
        waiting = [] if workers is None else [workers.submit(fly, *call) for call in calls[1:]]
        fly(*calls[0])
        for future in waiting:
            future.result()

    def _fly_bullet(self, physics: BulletPhysics, steps: int, running: BoolArray) -> None:
        arguments = (*self._arguments, physics.wrench, *self._scratch[0])
        if self._entry is None:
            self._entry = entry_point(prepare_flight, 0, True, *arguments)
        for e in np.flatnonzero(running).tolist():
            for k in range(steps):
                self._entry(e, k == 0, *arguments)
                physics.move_bodies(e)
            physics.settle(e)
