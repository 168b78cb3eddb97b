"""Who commands the rotors between two decisions: the tracking loop, a part of it, or the agent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.control.config import ControlGains, ControllerConfig, compile_gains
from swarm_envs.control.rates import hold_rates
from swarm_envs.control.state import ControllerState, Setpoint, forget_flight, hold
from swarm_envs.control.tracking import extrapolate, track_env
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.crowd import Crowd, crowd_forces
from swarm_envs.interactions.field import ForceField
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.physics.step import World
from swarm_envs.state import FloatArray, IntArray, Parameters, SwarmState, parameters
from swarm_envs.vehicles import Team

SETPOINTS, RATES, ROTORS = 0, 1, 2
"""What an agent commands: set-points of the tracking loop, thrust and body rates, or the rotors."""


class Pilot(NamedTuple):
    """Who commands the rotors: the tracking loop, its inner part, or the agent itself."""

    level: int
    """SETPOINTS, RATES or ROTORS: where actions enter. At ROTORS the agent writes `commands`."""
    setpoint: Setpoint
    """What the tracking loop follows."""
    asked: FloatArray
    """(E, N, 4) at RATES: total thrust, N, and body rates, rad/s."""
    memory: ControllerState
    """The loop's integrals and filters."""
    gains: ControlGains
    """The loop's gains."""
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


def new_pilot(
    team: Team, num_envs: int, config: ControllerConfig, belief: InteractionModel, level: int
) -> Pilot:
    """A pilot of E environments that has not flown.

    Args:
        team: the N vehicles of every environment.
        num_envs: E.
        config: of the tracking loop.
        belief: the force model in which the loop believes, if it compensates one.
        level: SETPOINTS, RATES or ROTORS: where actions enter.

    Raises:
        ValueError: the belief does not know a vehicle's type.
    """
    drones = len(team)
    return Pilot(
        level=level,
        setpoint=Setpoint.zeros(num_envs, drones),
        asked=np.zeros((num_envs, drones, 4)),
        memory=ControllerState.zeros(num_envs, drones),
        gains=compile_gains(config),
        nominal=parameters(team, num_envs),
        believes=config.feedforward is not None,
        belief=belief.field,
        belief_types=np.repeat(belief.type_indices(team)[None], num_envs, axis=0),
        belief_force=np.zeros((num_envs, drones, 3)),
        commands=np.zeros((num_envs, drones, 4)),
    )


@borrowing_kernel
def rest(e: int, state: SwarmState, pilot: Pilot) -> None:
    """Begin anew in environment `e`, on set-points where the drones are, rotors as they turn."""
    forget_flight(e, pilot.memory)
    hold(e, state.position, pilot.setpoint)
    for i in range(pilot.commands.shape[1]):
        total = 0.0
        for k in range(4):
            pilot.commands[e, i, k] = state.rotor_thrust[e, i, k]
            pilot.asked[e, i, k] = 0.0
            total += state.rotor_thrust[e, i, k]
        pilot.asked[e, i, 0] = total
        for k in range(3):
            pilot.belief_force[e, i, k] = 0.0


@borrowing_kernel
def believe(count: int, environments: IntArray, world: World, pilot: Pilot, crowd: Crowd) -> None:
    """Evaluate the force that the controller compensates, if it does, in these environments.

    Args:
        count: how many environments, at most as many as the crowd has places.
        environments: which.
        world: its state is read.
        pilot: its believed force is changed in place.
        crowd: working memory.
    """
    if pilot.believes and pilot.level == SETPOINTS:
        for place in range(count):
            crowd.members[place] = environments[place]
        state, types = world.state, pilot.belief_types
        position, velocity, force = state.position, state.velocity, pilot.belief_force
        crowd_forces(pilot.belief, count, types, position, velocity, crowd, force)


@borrowing_kernel
def decide(e: int, world: World, pilot: Pilot) -> None:
    """One controller step of environment `e`: set-points, belief and state to rotor commands."""
    if pilot.level == ROTORS:
        return
    if pilot.level == RATES:
        world_state, memory = world.state, pilot.memory
        hold_rates(e, world_state, pilot.nominal, memory, pilot.asked, pilot.gains, pilot.commands)
        return
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
