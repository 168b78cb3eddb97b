"""The base class of both physics engines, and the compiled engine.

A physics object simulates E environments of N drones. `step` takes rotor commands and advances all
environments by 1/240 s, including the interaction forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import entry_point
from swarm_envs.control.config import ControllerConfig, gains
from swarm_envs.errors import check_array, check_divisor, check_integer, check_name
from swarm_envs.hall import Hall
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.base import ForceFunction, interaction_types
from swarm_envs.interactions.packed import order_for, scratch_for
from swarm_envs.motors import BatteryModel
from swarm_envs.neighbors import FEW
from swarm_envs.physics.begin import begin_flight
from swarm_envs.physics.contact import (
    NO_WALLS,
    ON_CONTACT,
    ROW,
    Contacts,
    contacts_of,
    no_obstacles,
)
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.physics.step import (
    BEGIN,
    CONTACTS,
    CONTROL,
    FAR,
    FORCES,
    INTEGRATE,
    ROTORS,
    Flight,
    Forces,
    Variations,
    fly,
    new_work,
)
from swarm_envs.physics.workers import Call, Workers
from swarm_envs.state import (
    BoolArray,
    FloatArray,
    IntArray,
    Parameters,
    SwarmState,
    hover_state,
    parameters,
    state_of,
)
from swarm_envs.tables import SETTINGS_TYPE, Records, World, clear_environments, new_world
from swarm_envs.vehicles import GRAM_FORCE, VEHICLES, Team, Vehicle, parse_team

__all__ = ["BatchPhysics"]

MOST_ENVIRONMENTS = 1_000_000  # Upper bound of `num_envs`, beyond any memory
PART = 2048
"""Drones of a part of a batch: their records stay in the cache from one kernel to the next."""
AIR_DENSITY = 1.225  # Density of air at sea level, kg/m^3
FORCE_BOUNDS_G: Mapping[str, float] = {"S": 5.0, "S*": 5.0, "L": 10.0}
"""Bounds on the vertical interaction force by vehicle token, gram-force, of Neural-Swarm2's planner
(Sec. VII-D, Fig. 6)."""

DECISION = BEGIN | CONTROL | FORCES | INTEGRATE | CONTACTS
"""Phases of the steps of a decision on the compiled engine."""


class Physics:
    """The dynamics of E environments of N drones: rigid bodies, rotors and interaction forces.

    Args:
        team: the N vehicles of every environment, or a string such as `"SSL"`.
        num_envs: E.
        interactions: the model of the interaction forces: a name, a path, a model or a function;
            see `swarm_envs.interactions.load`.
        arena: (2, 3) corners of the walls for the collision test, m; None for no walls.
        battery: the model of batteries; None for ideal batteries.
        force_rate: evaluations of the interaction force per second, 240 or a divisor; the force is
            held between them.
        gusts: standard deviation (m/s^2) and correlation time (s) of the acceleration by gusts in
            environments; None for none. `step` ignores them.
        hall: parameters of the world `"hall"`; None for the ideal world.
        interaction_torque: True to let the interaction force also exert a torque.
        obstacles: (M, 7) rows of `swarm_envs.physics.contact`; None for none.
        level: input of commands: SETPOINTS, RATES or ROTORS of `swarm_envs.physics.step`.
        controller: configuration of the tracking controller, for SETPOINTS and RATES.
        threads: number of threads, which share the environments.
        num_stages: S, the number of sets of goals of an episode.
        force_bounds_g: bounds on the vertical interaction force by vehicle token, gram-force;
            metrics count violations. Other types have no bound.
        on_contact: one of `ON_CONTACT`. With `bounce`, drones bounce off each other, the floor,
            walls and obstacles; see `swarm_envs.physics.contact`. Otherwise bodies pass through
            each other, except in Bullet with `end_team`, which computes contact forces.

    Raises:
        ValueError: an argument is invalid.
    """

    name: str
    """The name of the engine."""

    def __init__(
        self,
        team: str | Sequence[Vehicle],
        num_envs: int = 1,
        interactions: str | Path | InteractionModel | ForceFunction = "learned",
        *,
        arena: npt.ArrayLike | None = None,
        battery: BatteryModel | None = None,
        force_rate: int = PHYSICS_RATE,
        gusts: tuple[float, float] | None = None,
        hall: Hall | None = None,
        interaction_torque: bool = False,
        obstacles: npt.ArrayLike | None = None,
        level: int = ROTORS,
        controller: ControllerConfig | None = None,
        threads: int = 1,
        num_stages: int = 1,
        force_bounds_g: Mapping[str, float] = FORCE_BOUNDS_G,
        on_contact: str = "end_team",
    ) -> None:
        check_integer("num_envs", num_envs, at_least=1, at_most=MOST_ENVIRONMENTS)
        check_divisor("force_rate", force_rate, PHYSICS_RATE)
        check_integer("threads", threads, at_least=1)
        check_name("on_contact", on_contact, ON_CONTACT)
        self.team = parse_team(team)
        self.teams = [self.team] * num_envs
        self.num_envs = num_envs
        self.interactions = load(interactions)
        config = controller or ControllerConfig()
        self.feedforward = load("none" if config.feedforward is None else config.feedforward)
        self.arena = NO_WALLS if arena is None else check_array("arena", arena, (2, 3))
        rows = np.asarray(no_obstacles() if obstacles is None else obstacles)
        self.obstacles = check_array("obstacles", rows, (*rows.shape[:1], ROW), "(M, 7)")
        self.hall = hall
        self._battery = BatteryModel() if battery is None else battery
        self._bounds_g = force_bounds_g
        drones = len(self.team)
        self.world: World = new_world(num_envs, drones, num_stages)
        self._columns = self.world.columns
        for name in ("force_scale", "noise_scale"):
            self.world.environments[name] = 1.0
        self.settings: Records = np.zeros(1, SETTINGS_TYPE)
        strength, correlation_s = gusts or (0.0, 1.0)
        self._set(
            level=level,
            hold=PHYSICS_RATE // force_rate,
            compensates=config.feedforward is not None and self.feedforward.function is None,
            drains=battery is not None,
            gusty=strength > 0.0,
            twists=interaction_torque,
            gust_kept=float(np.exp(-TIME_STEP / correlation_s)),
            gust_strength=strength,
            arena=self.arena,
            ends_team=on_contact == "end_team",
            bounces=on_contact == "bounce",
            idle_current=self._battery.idle_current_a,
            current_per_newton=self._battery.current_per_newton,
            **gains(config, TIME_STEP),
            **({} if hall is None else hall.settings()),
        )
        self.order: IntArray = np.repeat(np.arange(drones)[None], num_envs, axis=0)
        for name, values in self._fields_of(self.team).items():
            self.world.drones[name] = values
        self.world.drones["charge"] = 1.0
        self.state: SwarmState = state_of(self.world.drones)
        self._everywhere: BoolArray = np.ones(num_envs, dtype=np.bool_)
        self._functions = [
            (model, field)
            for model, field in (
                (self.interactions, "force"),
                (self.feedforward, "feedforward_force"),
            )
            if model.function is not None
        ]
        if interaction_torque and self.interactions.function is not None:
            raise ValueError(
                f"interaction_torque is True, but {self.interactions.name} is a function, whose "
                "force is not known at the rotors; leave it out"
            )
        self._make_memory(threads)
        self._set_state(hover_state(self.team, self._default_positions()), self._everywhere)
        self._ready = False  # until the first reset or step, which loads a kernel

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            self.settings[name] = value

    def _make_memory(self, threads: int) -> None:
        """Create the arguments of `fly`, once."""
        drones = len(self.team)
        work = new_work(drones)
        largest = max(1, PART // drones)
        self.workers = Workers(self.num_envs, threads, len(work.members), largest)
        self._open_circuit = self._battery.open_circuit
        flight = Flight(
            drones=self.world.drones,
            columns=self._columns,
            environments=self.world.environments,
            settings=self.settings,
        )
        size, hall = len(work.members), None if self.hall is None else True
        varied = self._is_varied()

        def forces(model: InteractionModel) -> Forces:
            order = order_for(size, drones) if varied else None
            return Forces(model.packed, order, scratch_for(model.packed, size, drones))

        def variations() -> Variations:
            memory = self.obstacles, self._open_circuit, self.order
            return Variations(*memory, forces(self.feedforward))

        self._given = [
            (
                flight,
                variations() if varied else None,
                hall,
                forces(self.interactions),
                new_work(drones),
            )
            for _ in range(self.workers.threads)
        ]
        self._begun = (self.world.drones, self._columns, self.settings, self._open_circuit)

    def _is_varied(self) -> bool:
        """Return True if `fly` needs `Variations`."""
        names = "drains", "gusty", "bounces", "compensates", "adaptation", "twists"
        options = any(bool(self.settings[name][0]) for name in names)
        large = len(self.team) > FEW
        return options or large or self.hall is not None or len(self.obstacles) > 0

    def compile(self) -> None:
        """Compile `fly`, which otherwise happens at the first step."""
        _ = self._compiled

    @cached_property
    def _begin(self) -> Callable[..., None]:
        """The entry point of `begin_flight`."""
        return entry_point(begin_flight, np.zeros(1, np.int64), True, *self._begun)

    @cached_property
    def _compiled(self) -> Callable[..., None]:
        """The entry point of `fly`."""
        return entry_point(fly, 0, 0, 0, 0, self._everywhere, *self._given[0])

    def _fields_of(self, team: Team) -> dict[str, npt.ArrayLike]:
        """Return the fields of the drones' table for a team: (N, ...) by name."""
        nominal = parameters(team)
        tokens = list(VEHICLES)
        areas = np.array([math.pi * vehicle.rotor_radius**2 for vehicle in team])
        code = [[float(vehicle.token == token) for token in tokens] for vehicle in team]
        bound = [self._bounds_g.get(vehicle.token, np.inf) * GRAM_FORCE for vehicle in team]
        return {
            **nominal._asdict(),
            **{f"nominal_{name}": getattr(nominal, name) for name in _NOMINAL},
            "nominal_motor_decay": np.exp(-nominal.motor_rate * self.settings["step"][0]),
            **self._battery.of_team(team),
            "type": self.interactions.type_indices(team),
            "feedforward_type": self.feedforward.type_indices(team),
            "energy_scale": [
                TIME_STEP / math.sqrt(2.0 * AIR_DENSITY * area) for area in areas.tolist()
            ],
            "force_bound": bound,
            "thrust_gain": [1.0] * len(team),
            "hover_thrust": [vehicle.hover_rotor_thrust for vehicle in team],
            "type_code": code,
        }

    @property
    def parameters(self) -> Parameters:
        """The parameters of the drones, as views (E, N, ...)."""
        return Parameters(*(self.world.drones[name] for name in Parameters._fields))

    @property
    def force(self) -> FloatArray:
        """The interaction force (E, N, 3), as last evaluated, N, world frame."""
        return self.world.drones["force"]

    @property
    def contacts(self) -> Contacts:
        """The contacts of the last step or decision."""
        return contacts_of(self.world.drones)

    @property
    def contact(self) -> BoolArray:
        """True (E, N) for drones with any contact in the last step or decision."""
        return self.contacts.any()

    def set_team(self, e: int, team: str | Sequence[Vehicle]) -> None:
        """Set the vehicles of environment `e`, as many as before, for its next reset.

        Raises:
            ValueError: their number is another, or a force model lacks their type. Nothing was
                changed.
        """
        vehicles = parse_team(team)
        if len(vehicles) != len(self.team):
            raise ValueError(
                f"the team has {len(vehicles)} vehicles, but must have {len(self.team)} as before"
            )
        for name, values in self._fields_of(vehicles).items():
            self.world.drones[name][e] = values
        self.teams[e] = vehicles

    def reset(self, state: SwarmState | None = None, mask: BoolArray | None = None) -> SwarmState:
        """Set the state of every environment, or of those in the mask.

        Args:
            state: the new state; None to hover in a row at 1 m height, 1 m apart.
            mask: (E,) environments to set; None for all.

        Returns:
            A read-only view of the state, valid until the next step.

        Raises:
            ValueError: the state has a wrong shape or an invalid value. Nothing was changed.
        """
        new = state
        if new is None:
            new = hover_state(self.team, self._default_positions())
            new.rotor_thrust[:] = self.world.drones["hover_thrust"][..., None]
        check_state(new, self.state)
        where = self._everywhere if mask is None else self._everywhere & mask
        self._set_state(new, where)
        self.begin(np.flatnonzero(where), at_rest=False)
        return self.state

    def _set_state(self, state: SwarmState, where: BoolArray) -> None:
        for name, array in zip(state._fields, state, strict=True):
            self.world.drones[name][where] = array[where]

    def begin(self, where: IntArray, at_rest: bool = True) -> None:
        """Restart environments (M,): at rest at their starts, or in the state that was set."""
        self._ready = True
        self._begin(where, at_rest, *self._begun)
        clear_environments(self.world.environments, where)
        self.place_bodies(where)

    def fly(self, steps: int, flown: BoolArray, then: Call = lambda *_: None) -> None:
        """Simulate the physics steps of a decision.

        Args:
            steps: number of steps of 1/240 s.
            flown: (E,) environments to simulate.
            then: a function that is called for every part of the batch after its simulation, on the
                same thread, with the first environment, one past the last, and the thread's number.
        """
        if not self._functions:
            self._fly(DECISION, steps, flown, then)
            return
        phases = DECISION
        while steps:  # in parts, between which functions return the forces
            part = min(steps, self._call_functions(flown))
            steps -= part
            self._fly(phases, part, flown, *([] if steps else [then]))
            phases = DECISION & ~BEGIN

    def _call_functions(self, flown: BoolArray) -> int:
        """Write the forces of functions in environments in which they are due.

        Args:
            flown: (E,) environments that are simulated.

        Returns:
            The number of steps until a force is due in any of them.
        """
        environments, hold = self.world.environments, int(self.settings["hold"][0])
        since = environments["age"] % hold
        due = np.flatnonzero(flown & (since == 0))
        if len(due):
            drones = self.world.drones[due]
            position = without_ended(drones["position"], drones["active"])
            types = np.array([interaction_types(self.teams[e]) for e in due.tolist()])
            for model, field in self._functions:
                force = model.call(position.copy(), drones["velocity"].copy(), types.copy())
                if field == "force":
                    force = force * environments["force_scale"][due, None, None]
                self.world.drones[field][due] = force
        return int(hold - since[flown].max(initial=0))

    def control(self) -> None:
        """Make one step of the tracking controller in all environments, at the present state."""
        self._fly(CONTROL, 1, self._everywhere)

    def _fly(self, phases: int, steps: int, flown: BoolArray, then: Call = lambda *_: None) -> None:
        kernel, given = self._compiled, self._given
        mask: BoolArray = np.ascontiguousarray(flown)  # views of records are not contiguous

        def work(first: int, last: int, thread: int) -> None:
            kernel(first, last, phases, steps, mask, *given[thread])
            then(first, last, thread)

        self.workers.share(work)

    def step(
        self, commands: npt.ArrayLike, external_force: npt.ArrayLike | None = None
    ) -> SwarmState:
        """Advance every environment by 1/240 s.

        Args:
            commands: (E, N, 4) commanded thrust of each rotor, N, clipped to [0, rotor_limit].
            external_force: (E, N, 3) external force on each drone, N, world frame.

        Returns:
            A read-only view of the state, valid until the next step.

        Raises:
            ValueError: a shape is wrong or an entry is not finite. Nothing was changed.
        """
        drones = self.world.drones
        u = check_array("commands", commands, (*drones.shape, 4), "(E, N, 4), newton per rotor")
        if external_force is not None:
            shape = (*drones.shape, 3)
            external_force = check_array(
                "external_force", external_force, shape, "(E, N, 3), newton"
            )
        if not self._ready:
            self.reset()
        drones["commands"] = u
        if external_force is not None:
            drones["external"] = external_force
        self._advance()
        if external_force is not None or self.hall is not None:
            drones["external"] = 0.0  # it acts only in this step
        return self.state

    def _advance(self) -> None:
        if self._functions:
            self._call_functions(self._everywhere)
        self._fly(BEGIN | FORCES | INTEGRATE | CONTACTS, 1, self._everywhere)

    def __reduce__(self) -> str:
        """Raise TypeError: a copy's state would not be views of its memory."""
        raise TypeError(
            f"{type(self).__name__} cannot be copied or pickled; make another and "
            "reset(state=physics.state.copy())"
        )

    def close(self) -> None:
        """Release threads, and clients of Bullet. May be called more than once."""
        self.workers.close()

    def place_bodies(self, where: IntArray) -> None:
        """Update the bodies of an engine with its own bodies in environments (M,)."""

    def _default_positions(self) -> FloatArray:
        row = np.zeros((self.num_envs, len(self.team), 3))
        row[..., 0] = np.arange(len(self.team)) - (len(self.team) - 1) / 2
        row[..., 2] = 1.0
        return row


class BatchPhysics(Physics):
    """The compiled engine, for any number of environments, without Bullet.

    It agrees with `BulletPhysics` to 1e-9 until the first contact. Unless drones bounce, contacts
    have no effect on the motion: bodies pass through each other and through walls.
    """

    name = "batch"


def without_ended(position: FloatArray, active: FloatArray) -> FloatArray:
    """Return positions (E, N, 3), m, with drones whose episode has ended far from all others.

    `active` (E, N) is 0 for these drones. They thereby exert no forces, as in `fly`.
    """
    away = FAR * np.arange(1.0, active.size + 1.0).reshape(*active.shape, 1)
    return np.where(active[..., None] > 0.0, position, away)


_NOMINAL = ("mass", "inertia", "motor_rate", "max_rotor_thrust")
"""Parameters of which the controller uses nominal values."""


def check_state(state: SwarmState, like: SwarmState) -> None:
    """Raise ValueError for a state of wrong shapes or with invalid values."""
    for name, array, model in zip(state._fields, state, like, strict=True):
        check_array(f"state.{name}", array, model.shape)
    norm = np.linalg.norm(state.quaternion, axis=-1)
    if (abs(norm - 1.0) > 1e-6).any():
        raise ValueError(
            f"state.quaternion has length {norm[abs(norm - 1.0) > 1e-6][0]}, but must be a unit "
            "quaternion (x, y, z, w); normalize it"
        )
    if (state.rotor_thrust < 0.0).any():
        raise ValueError(
            f"state.rotor_thrust has {state.rotor_thrust.min()} N, but must not be negative"
        )
    if len(wrong := state.battery[(state.battery < 0.0) | (state.battery > 1.0)]):
        raise ValueError(
            f"state.battery has {wrong[0]}, but must lie between 0 (empty) and 1 (full)"
        )
