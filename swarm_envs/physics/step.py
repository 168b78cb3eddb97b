"""The compiled physics step, in the pieces that both engines put together."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel, kernel
from swarm_envs.interactions.crowd import Crowd, crowd_for, crowd_forces
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.forces import outside_measured_range
from swarm_envs.motors import BatteryArrays, battery_step, rotor_limit
from swarm_envs.physics.contact import Contacts, find_contacts, forget
from swarm_envs.physics.gusts import Gusts
from swarm_envs.physics.rigid_body import (
    TIME_STEP,
    TUMBLING_RATE,
    integrate,
    lag_rotors,
    rotation_entries,
    rotor_wrench,
)
from swarm_envs.state import BoolArray, FloatArray, IntArray, Parameters, SwarmState


class World(NamedTuple):
    """Everything a physics step reads and writes, apart from commands: E environments."""

    state: SwarmState
    """Of every drone, written by each step."""
    parameters: Parameters
    """What each drone is made of."""
    types: IntArray
    """(E, N) interaction types."""
    field: ForceField
    """The force model that blows."""
    force: FloatArray
    """(E, N, 3) interaction force, as last evaluated, N."""
    outside: BoolArray
    """(E, N) whether that force is an extrapolation past what was measured."""
    force_scale: FloatArray
    """(E,) factor of that force."""
    gusts: Gusts
    """The wind's state."""
    age: IntArray
    """(E,) steps since reset."""
    hold: int
    """Steps over which the interaction force is held."""
    rotor_limit: FloatArray
    """(E, N) largest thrust of one rotor now, N."""
    drains: bool
    """Whether batteries empty."""
    battery: BatteryArrays
    """Its rows are all drones of the first environment, then those of the second, and so on."""
    contacts: Contacts
    """What each drone touches."""
    arena: FloatArray
    """(2, 3) corners of the walls, m."""
    obstacles: FloatArray
    """(M, 7) rows of `swarm_envs.physics.obstacles`."""
    order: IntArray
    """(E, N) drones of each environment, as last sorted along x."""


@borrowing_kernel
def refresh(e: int, world: World) -> None:
    """Begin anew in environment `e`, whose state has just been set.

    Bullet keeps quaternions of exactly unit length, so its twin starts from one too.
    """
    q, f, most = world.state.quaternion, world.state.rotor_thrust, world.parameters.max_rotor_thrust
    drones = most.shape[1]
    world.age[e] = 0
    for k in range(3):
        world.gusts.acceleration[e, k] = 0.0
    for i in range(drones):
        square = total = 0.0
        for k in range(4):
            square += q[e, i, k] * q[e, i, k]
            total += f[e, i, k]
        for k in range(4):
            q[e, i, k] /= math.sqrt(square)
        for k in range(3):
            world.force[e, i, k] = 0.0
        world.rotor_limit[e, i] = most[e, i]
        charge = world.state.battery[e, i]
        if world.drains and charge < 1.0:
            row = e * drones + i
            limit = rotor_limit(charge, total, 4.0 * most[e, i], world.battery, row)
            world.rotor_limit[e, i] = limit
    forget(e, world.contacts)


@borrowing_kernel
def refresh_all(mask: BoolArray, world: World) -> None:
    """Begin anew in the environments of the mask."""
    for e in range(mask.shape[0]):
        if mask[e]:
            refresh(e, world)


@borrowing_kernel
def blow(count: int, environments: IntArray, world: World, crowd: Crowd) -> None:
    """Evaluate the interaction force at the present state of environments in which it is due.

    Args:
        count: how many environments, at most as many as the crowd has places.
        environments: which.
        world: its force and age are changed in place.
        crowd: working memory.
    """
    state, drones, due = world.state, world.types.shape[1], 0
    for place in range(count):
        e = environments[place]
        if world.age[e] % world.hold == 0:
            crowd.members[due] = e
            due += 1
        world.age[e] += 1
    if due == 0:
        return
    crowd_forces(world.field, due, world.types, state.position, state.velocity, crowd, world.force)
    m = due * drones
    gathered, moving, outside = crowd.position[:m], crowd.velocity[:m], crowd.outside[:m]
    outside_measured_range(world.field, gathered, moving, crowd.scratch, outside)
    for place in range(due):
        e = crowd.members[place]
        for i in range(drones):
            world.outside[e, i] = outside[place * drones + i]
            for k in range(3):
                world.force[e, i, k] *= world.force_scale[e]


@borrowing_kernel
def drain(e: int, world: World) -> None:
    """Take one step's charge from the batteries of environment `e`; their rotors' limits follow."""
    state, parameters, drones = world.state, world.parameters, world.force.shape[1]
    for i in range(drones):
        total = 0.0
        for r in range(4):
            total += state.rotor_thrust[e, i, r]
        state.battery[e, i], world.rotor_limit[e, i] = battery_step(
            state.battery[e, i],
            total,
            4.0 * parameters.max_rotor_thrust[e, i],
            world.battery,
            e * drones + i,
            TIME_STEP,
        )


@borrowing_kernel
def spin_rotors(e: int, world: World, commands: FloatArray) -> None:
    """Rotor lag and battery of environment `e` over one step, towards `commands` (E, N, 4), N."""
    thrust = world.state.rotor_thrust
    lag_rotors(e, thrust, world.parameters, world.rotor_limit, commands, TIME_STEP)
    if world.drains:
        drain(e, world)


@borrowing_kernel
def touch(e: int, world: World) -> None:
    """Add what environment `e` touches now to the contacts."""
    state = world.state
    find_contacts(
        e,
        state.position,
        state.angular_velocity,
        world.parameters.radius,
        world.arena,
        world.obstacles,
        world.order[e],
        TUMBLING_RATE,
        world.contacts,
    )


@borrowing_kernel
def step_environment(
    e: int, world: World, commands: FloatArray, external: FloatArray, total: FloatArray
) -> None:
    """One whole physics step of environment `e` on the compiled engine, the air's force given.

    Args:
        e: the environment.
        world: changed in place; its force is that at the state before the step.
        commands: (E, N, 4) rotor thrusts, N.
        external: (E, N, 3) further force, N.
        total: (E, N, 3) scratch.
    """
    spin_rotors(e, world, commands)
    for i in range(total.shape[1]):
        for k in range(3):
            total[e, i, k] = world.force[e, i, k] + external[e, i, k]
    integrate(e, world.state, world.parameters, total, TIME_STEP)
    touch(e, world)


@kernel
def step_all(world: World, commands: FloatArray, external: FloatArray, total: FloatArray) -> None:
    """One physics step of every environment on the compiled engine."""
    crowd, environments = crowd_for(world.field, total.shape[1]), np.arange(total.shape[0])
    places = len(crowd.members)
    for first in range(0, len(environments), places):
        part = environments[first : first + places]
        blow(len(part), part, world, crowd)
        for e in part:
            step_environment(e, world, commands, external, total)


@kernel
def blow_and_prepare(
    e: int, world: World, commands: FloatArray, external: FloatArray, out: FloatArray
) -> None:
    """`blow`, then `prepare_wrench`."""
    blow(1, np.array([e]), world, crowd_for(world.field, out.shape[0]))
    prepare_wrench(e, world, commands, external, out)


@borrowing_kernel
def prepare_wrench(
    e: int, world: World, commands: FloatArray, external: FloatArray, out: FloatArray
) -> None:
    """What comes after `blow` and before the bodies move, for an engine that moves them.

    Args:
        e: the environment.
        world: rotor thrusts and batteries are advanced in place.
        commands: (E, N, 4) rotor thrusts, N.
        external: (E, N, 3) further force, N.
        out: (N, 6) force (N) and torque (N m) on each body, in its own frame.
    """
    spin_rotors(e, world, commands)
    q, f, parameters = world.state.quaternion, world.state.rotor_thrust, world.parameters
    for i in range(out.shape[0]):
        thrust, out[i, 3], out[i, 4], out[i, 5] = rotor_wrench(
            f[e, i, 0],
            f[e, i, 1],
            f[e, i, 2],
            f[e, i, 3],
            parameters.rotor_offset[e, i],
            parameters.thrust_to_torque[e, i],
        )
        r = rotation_entries(q[e, i, 0], q[e, i, 1], q[e, i, 2], q[e, i, 3])
        x = world.force[e, i, 0] + external[e, i, 0]
        y = world.force[e, i, 1] + external[e, i, 1]
        z = world.force[e, i, 2] + external[e, i, 2]
        out[i, 0] = r[0] * x + r[3] * y + r[6] * z
        out[i, 1] = r[1] * x + r[4] * y + r[7] * z
        out[i, 2] = r[2] * x + r[5] * y + r[8] * z + thrust


@borrowing_kernel
def take_bodies(e: int, world: World, moved: FloatArray) -> None:
    """Take over where another engine has moved the bodies of environment `e`; what touches?

    Args:
        e: the environment.
        world: changed in place.
        moved: (N, 13) position, quaternion, velocity, angular velocity.
    """
    state = world.state
    p, q, v, w = state.position, state.quaternion, state.velocity, state.angular_velocity
    for i in range(moved.shape[0]):
        for k in range(3):
            p[e, i, k] = moved[i, k]
            v[e, i, k] = moved[i, 7 + k]
            w[e, i, k] = moved[i, 10 + k]
        for k in range(4):
            q[e, i, k] = moved[i, 3 + k]
    touch(e, world)
