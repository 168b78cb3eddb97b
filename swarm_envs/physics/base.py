"""What both engines share: the arrays, the checks at the door, the reset.

A physics object holds E environments of N drones: of one team, unless `set_team` was told
otherwise. `step` takes rotor commands and advances
everything by 1/240 s; the interaction force is part of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.compiled import announce_compilation
from swarm_envs.errors import check_array, check_integer
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.motors import BATTERY_ROWS, BatteryModel
from swarm_envs.physics.contact import NO_WALLS, Contacts, no_contacts
from swarm_envs.physics.gusts import new_gusts
from swarm_envs.physics.obstacles import ROW, no_obstacles
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.physics.step import World, refresh_all
from swarm_envs.state import (
    BoolArray,
    FloatArray,
    Parameters,
    SwarmState,
    hover_state,
    parameters,
    replace_rows,
)
from swarm_envs.vehicles import Vehicle, parse_team

MOST_ENVIRONMENTS = 1_000_000
"""Of `num_envs`: memory ends before."""


class Physics(ABC):
    """Rigid bodies, rotors and the air between them, for E environments of one team.

    Args:
        team: the N vehicles of every environment, or a string such as `"SSL"`.
        num_envs: E.
        interactions: the force model that blows: a name, a path or a model.
        arena: (2, 3) corners of the walls for the collision test, m; None for no walls.
        battery: how thrust falls as batteries empty; None for batteries that never do.
        force_rate: how often a second the interaction force is evaluated; between, it is held.
            240 or a divisor.
        gusts: standard deviation (m/s^2) and correlation time (s) of the acceleration that gusts
            give in environments; None for still air. `step` leaves them out.
        obstacles: (M, 7) rows of `swarm_envs.physics.obstacles`; None for none.

    Raises:
        ValueError: an argument names nothing valid.
    """

    name: str
    """The engine's name, as environments report it."""

    @typed
    def __init__(
        self,
        team: str | Sequence[Vehicle],
        num_envs: int = 1,
        interactions: str | Path | InteractionModel = "learned",
        *,
        arena: npt.ArrayLike | None = None,
        battery: BatteryModel | None = None,
        force_rate: int = PHYSICS_RATE,
        gusts: tuple[float, float] | None = None,
        obstacles: npt.ArrayLike | None = None,
    ) -> None:
        check_integer("num_envs", num_envs, 1, MOST_ENVIRONMENTS)
        self.team = parse_team(team)
        self.teams = [self.team] * num_envs
        if force_rate < 1 or PHYSICS_RATE % force_rate:
            raise ValueError(
                f"force_rate is {force_rate}, but must be {PHYSICS_RATE} or a divisor of it, "
                "such as 120, 48 or 24"
            )
        self.num_envs = num_envs
        self.interactions = load(interactions)
        self.types = np.repeat(self.interactions.type_indices(self.team)[None], num_envs, axis=0)
        self.parameters: Parameters = parameters(self.team, num_envs)
        self.arena = NO_WALLS if arena is None else check_array("arena", arena, (2, 3))
        rows = np.asarray(no_obstacles() if obstacles is None else obstacles)
        self.obstacles = check_array("obstacles", rows, (*rows.shape[:1], ROW), "(M, 7)")
        shape = (num_envs, len(self.team))
        self.contacts: Contacts = no_contacts(*shape)
        self.force: FloatArray = np.zeros((*shape, 3))
        self._total: FloatArray = np.zeros((*shape, 3))
        self._no_force: FloatArray = np.zeros((*shape, 3))
        self._battery = BatteryModel() if battery is None else battery
        self._state = hover_state(self.team, self._default_positions())
        self.state: SwarmState = self._state.read_only()
        self.world = World(
            state=self._state,
            parameters=self.parameters,
            types=self.types,
            field=self.interactions.field,
            force=self.force,
            outside=np.zeros(shape, dtype=np.bool_),
            force_scale=np.ones(num_envs),
            gusts=new_gusts(num_envs, *(gusts or (0.0, 1.0)), TIME_STEP),
            age=np.zeros(num_envs, dtype=np.int64),
            hold=PHYSICS_RATE // force_rate,
            rotor_limit=self.parameters.max_rotor_thrust.copy(),
            drains=battery is not None,
            battery=self._battery.compile(self.team * num_envs),
            contacts=self.contacts,
            arena=self.arena,
            obstacles=self.obstacles,
            order=np.repeat(np.arange(len(self.team))[None], num_envs, axis=0),
        )

    @property
    def contact(self) -> BoolArray:
        """(E, N) whether each drone touched a drone, floor, wall or obstacle in the last step."""
        return self.contacts.any()

    def hover(self, position: FloatArray) -> SwarmState:
        """State at rest at positions (E, N, 3), m: rotors at hover, batteries full."""
        state = hover_state(self.team, position)
        for e, team in enumerate(self.teams):
            if team != self.team:
                state.rotor_thrust[e] = hover_state(team, position[e]).rotor_thrust[0]
        return state

    def set_team(self, e: int, team: str | Sequence[Vehicle]) -> None:
        """Let other vehicles fly in environment `e`, as many as before, from its next reset on.

        Parameters, interaction types, batteries and bodies become theirs.

        Raises:
            ValueError: their number is another, or the force model does not know their type;
                nothing is changed.
        """
        vehicles = parse_team(team)
        if len(vehicles) != len(self.team):
            raise ValueError(
                f"the team has {len(vehicles)} vehicles, but must have {len(self.team)}, as before"
            )
        self.types[e] = self.interactions.type_indices(vehicles)
        replace_rows(self.parameters, e, parameters(vehicles))
        rows, first = self._battery.compile(vehicles), e * len(vehicles)
        for name in BATTERY_ROWS:
            getattr(self.world.battery, name)[first : first + len(vehicles)] = getattr(rows, name)
        self.teams[e] = vehicles

    def reset(self, state: SwarmState | None = None, mask: BoolArray | None = None) -> SwarmState:
        """Set the state of every environment, or of those in the mask.

        Args:
            state: the new state; None hovers at 1 m, the drones 1 m apart in a row.
            mask: (E,) which environments to set; None for all.

        Returns:
            A read-only view of the state, valid until the next step.

        Raises:
            ValueError: the state does not fit, or holds an impossible value; nothing is changed.
        """
        new = self.hover(self._default_positions()) if state is None else state
        check_state(new, self._state)
        where: BoolArray = np.ones(self.num_envs, dtype=np.bool_)
        if mask is not None:
            where &= mask
        self._state.assign(new, where)
        announce_compilation(refresh_all)
        refresh_all(where, self.world)
        self.place_bodies(where)
        return self.state

    def step(
        self, commands: npt.ArrayLike, external_force: npt.ArrayLike | None = None
    ) -> SwarmState:
        """Advance every environment by 1/240 s.

        Args:
            commands: (E, N, 4) commanded thrust of each rotor, N; motors reach at most
                [0, rotor_limit].
            external_force: (E, N, 3) further force on each drone, N, world frame.

        Returns:
            A read-only view of the state, valid until the next step.

        Raises:
            ValueError: a shape does not fit or an entry is not finite; nothing is changed.
        """
        shape = self.force.shape
        u = check_array("commands", commands, (*shape[:2], 4), "(E, N, 4), newton a rotor")
        external = self._no_force
        if external_force is not None:
            external = check_array("external_force", external_force, shape, "(E, N, 3), newton")
        self.contacts.clear()
        self._advance(u, external)
        return self.state

    def __reduce__(self) -> str:
        """Refuse to be copied or pickled: views of the state would come apart from it.

        Raises:
            TypeError: always, saying what to do instead.
        """
        raise TypeError(
            f"{type(self).__name__} cannot be copied or pickled; make another and "
            "reset(state=physics.state.copy())"
        )

    def close(self) -> None:
        """Free what the engine holds. May be called more than once."""

    @abstractmethod
    def _advance(self, commands: FloatArray, external: FloatArray) -> None:
        """One step of checked input, in place."""

    def place_bodies(self, mask: BoolArray) -> None:
        """Tell an engine that keeps bodies of its own that states or parameters were set.

        Args:
            mask: (E,) the environments in which they were.
        """

    def _default_positions(self) -> FloatArray:
        row = np.zeros((self.num_envs, len(self.team), 3))
        row[..., 0] = np.arange(len(self.team)) - (len(self.team) - 1) / 2
        row[..., 2] = 1.0
        return row


def check_state(state: SwarmState, like: SwarmState) -> None:
    """Refuse a state that physics could not start from.

    Args:
        state: what was given.
        like: a state of the right shapes.

    Raises:
        ValueError: naming the field and what is wrong with it.
    """
    for name, array, model in zip(state._fields, state, like, strict=True):
        check_array(f"state.{name}", array, model.shape)
    norm = np.linalg.norm(state.quaternion, axis=-1)
    if (abs(norm - 1.0) > 1e-6).any():
        raise ValueError(
            f"state.quaternion has length {norm[abs(norm - 1.0) > 1e-6][0]}; "
            "attitudes are unit quaternions (x, y, z, w)"
        )
    if (state.rotor_thrust < 0.0).any():
        raise ValueError(f"state.rotor_thrust has {state.rotor_thrust.min()} N; rotors only push")
    if ((state.battery < 0.0) | (state.battery > 1.0)).any():
        raise ValueError("state.battery must lie between 0 (empty) and 1 (full)")
