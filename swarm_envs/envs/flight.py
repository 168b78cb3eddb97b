"""Flying between two decisions: controller and physics at 240 Hz, on either engine.

The compiled engine does all steps of all environments in one call; Bullet's bodies are moved one
step at a time, with the same controller and the same bookkeeping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from swarm_envs.borrowed import lend
from swarm_envs.compiled import borrowing_kernel, entry_point
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.pilot import Pilot, believe, decide, new_pilot, rest
from swarm_envs.envs.tally import Airframe, Tally, airframe_of, clear_tally, count, new_tally
from swarm_envs.envs.workers import Workers
from swarm_envs.interactions import load
from swarm_envs.interactions.crowd import Crowd, crowd_for
from swarm_envs.physics import BulletPhysics, Physics
from swarm_envs.physics.contact import forget
from swarm_envs.physics.gusts import gust
from swarm_envs.physics.step import World, blow, prepare_wrench, refresh, step_environment
from swarm_envs.state import (
    BoolArray,
    FloatArray,
    IntArray,
    SwarmState,
    hover_state,
    parameters,
    replace_rows,
    take_state,
)
from swarm_envs.vehicles import Team


@borrowing_kernel
def begin_flight(
    mask: BoolArray, new: SwarmState, world: World, pilot: Pilot, tally: Tally
) -> None:
    """Place the drones in the environments of the mask, as if nothing had been flown.

    Args:
        mask: (E,) environments that begin.
        new: their state.
        world: changed in place.
        pilot: rests on the drones' positions.
        tally: begins anew.
    """
    for e in range(mask.shape[0]):
        if mask[e]:
            take_state(e, new, world.state)
            refresh(e, world)
            rest(e, new, pilot)
            clear_tally(e, tally)


@borrowing_kernel
def fly_together(
    flown: int,
    together: IntArray,
    world: World,
    pilot: Pilot,
    tally: Tally,
    airframe: Airframe,
    external: FloatArray,
    total: FloatArray,
    steps: int,
    crowd: Crowd,
    belief_crowd: Crowd,
) -> None:
    """Fly the environments in the first `flown` places of `together` step by step."""
    for place in range(flown):
        forget(together[place], world.contacts)
    for _ in range(steps):
        believe(flown, together, world, pilot, belief_crowd)
        for place in range(flown):
            decide(together[place], world, pilot)
        blow(flown, together, world, crowd)
        for place in range(flown):
            e = together[place]
            count(e, world, tally, airframe)
            gust(e, world.age[e], world.gusts, world.parameters.mass, external)
            step_environment(e, world, pilot.commands, external, total)


@borrowing_kernel
def fly_compiled(
    first: int,
    last: int,
    running: BoolArray,
    steps: int,
    world: World,
    pilot: Pilot,
    tally: Tally,
    airframe: Airframe,
    external: FloatArray,
    total: FloatArray,
    together: IntArray,
    crowd: Crowd,
    belief_crowd: Crowd,
) -> None:
    """Fly `steps` physics steps of the running environments first to last - 1, compiled.

    Args:
        first: the first environment to fly.
        last: one past the last.
        running: (E,) environments to fly.
        steps: number of steps of 1/240 s.
        world: changed in place.
        pilot: changed in place.
        tally: changed in place.
        airframe: what the tally knows of the drones.
        external: (E, N, 3) force of gusts, N; zeros without.
        total: (E, N, 3) scratch.
        together: (C,) scratch: the environments that are flown together.
        crowd: working memory for C environments and the world's force model.
        belief_crowd: the same for the controller's.
    """
    e = first
    while e < last:
        flown = 0
        while e < last and flown < len(together):
            if running[e]:
                together[flown] = e
                flown += 1
            e += 1
        if flown > 0:
            fly_together(
                flown,
                together,
                world,
                pilot,
                tally,
                airframe,
                external,
                total,
                steps,
                crowd,
                belief_crowd,
            )


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
    together: IntArray,
    crowd: Crowd,
    belief_crowd: Crowd,
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
        together: scratch.
        crowd: working memory for the world's force model.
        belief_crowd: the same for the controller's.
    """
    if first:
        forget(e, world.contacts)
    together[0] = e
    believe(1, together, world, pilot, belief_crowd)
    decide(e, world, pilot)
    blow(1, together, world, crowd)
    count(e, world, tally, airframe)
    gust(e, world.age[e], world.gusts, world.parameters.mass, external)
    prepare_wrench(e, world, pilot.commands, external, wrench)


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
        self.physics, self.belief = physics, belief
        self.pilot = new_pilot(physics.team, envs, config, belief, level)
        shape = (envs, drones)
        self.tally = new_tally(*shape)
        external = np.zeros((envs, drones, 3))
        self._bounds_g = bounds_g
        self._airframe = airframe_of(physics.team, bounds_g, envs)
        tuples = (physics.world, self.pilot, self.tally, self._airframe)
        lent, total = (*map(lend, tuples), external), np.zeros((envs, drones, 3))
        memory = self._memory()
        self._in_bullet: tuple[Any, ...] = ()
        if isinstance(physics, BulletPhysics):
            self._in_bullet = (*lent, physics.wrench, *memory)
        self.workers = Workers(envs, threads, len(memory[0]))
        memories = [memory, *(self._memory() for _ in range(self.workers.threads - 1))]
        self._by_thread: list[tuple[Any, ...]] = [(*lent, total, *own) for own in memories]
        self._entry: Callable[..., None] | None = None
        self.start = physics.hover(np.zeros((*shape, 3)))
        """State in which the next episodes begin: at rest, with full batteries, unless changed."""
        self._begun: tuple[Any, ...] = (lend(self.start), *lent[:3])
        self._begin: Callable[..., None] | None = None

    def _memory(self) -> tuple[IntArray, Crowd, Crowd]:
        """Working memory of a thread."""
        drones, fields = len(self.physics.team), (self.physics.world.field, self.belief.field)
        crowd, belief_crowd = (crowd_for(field, drones) for field in fields)
        return np.zeros_like(crowd.members), lend(crowd), lend(belief_crowd)

    def set_team(self, e: int, team: Team) -> None:
        """Let environment `e` be flown by another team of as many drones, from its next reset on.

        Raises:
            ValueError: as of `Physics.set_team`; or the belief does not know a vehicle's type.
        """
        types = self.belief.type_indices(team)
        self.physics.set_team(e, team)
        self.start.rotor_thrust[e] = hover_state(team, self.start.position[e]).rotor_thrust[0]
        self.pilot.belief_types[e] = types
        replace_rows(self.pilot.nominal, e, parameters(team))
        replace_rows(self._airframe, e, airframe_of(team, self._bounds_g))

    def reset(self, mask: BoolArray) -> None:
        """Let the environments of the mask begin in the state `start`, on their set-points."""
        if self._begin is None:
            self._begin = entry_point(begin_flight, mask, *self._begun)
        self._begin(mask, *self._begun)
        self.physics.place_bodies(mask)

    def fly(self, steps: int, running: BoolArray) -> None:
        """Fly `steps` physics steps in the running environments (E,)."""
        if isinstance(self.physics, BulletPhysics):
            self._fly_bullet(self.physics, steps, running)
        else:
            self._fly_compiled(steps, running)

    def close(self) -> None:
        """Let the worker threads end."""
        self.workers.close()

    def _fly_compiled(self, steps: int, running: BoolArray) -> None:
        if self._entry is None:
            self._entry = entry_point(fly_compiled, 0, 0, running, steps, *self._by_thread[0])
        self.workers.share(self._entry, (running, steps), self._by_thread)

    def _fly_bullet(self, physics: BulletPhysics, steps: int, running: BoolArray) -> None:
        arguments = self._in_bullet
        if self._entry is None:
            self._entry = entry_point(prepare_flight, 0, True, *arguments)
        for e in np.flatnonzero(running).tolist():
            for k in range(steps):
                self._entry(e, k == 0, *arguments)
                physics.move_bodies(e)
            physics.settle(e)
