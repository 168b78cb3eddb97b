"""Options of the environments of every task."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.envs.observation import FORMS
from swarm_envs.envs.randomization import SAME, Randomization
from swarm_envs.errors import (
    check_array,
    check_bool,
    check_divisor,
    check_integer,
    check_name,
    check_number,
    check_type,
)
from swarm_envs.hall import Hall
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.base import PRECISIONS, ForceFunction
from swarm_envs.motors import BatteryModel
from swarm_envs.physics import bullet_available
from swarm_envs.physics.base import FORCE_BOUNDS_G, MOST_ENVIRONMENTS
from swarm_envs.physics.contact import ON_CONTACT
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.physics.step import SETPOINTS
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.vehicles import Team, parse_team

__all__ = ["MOST_DRONES", "MOST_OBSERVED", "RESET_OPTIONS", "WORLDS", "EnvConfig", "check_num_envs"]

ENGINES = ("bullet", "batch")  # Names of the physics engines
WORLDS = ("ideal", "hall")
"""Names of the worlds."""
MOST_DRONES = 100_000
"""Largest number of drones of an environment."""
MOST_OBSERVED = 10_000
"""Largest K or M, the numbers of observed neighbors and obstacles."""
MANY_DRONES = 1024  # Number of drones in all environments together from which threads pay
MOST_THREADS = 1024  # Upper bound of `threads`: each is a thread of the operating system


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Options of the environments of every task. Raises ValueError for invalid values.

    Each task adds options of its own.
    """

    physics: str | None = None
    """`bullet`, `batch` (the compiled engine), or None: Bullet if it is installed and
    `deterministic` is False, else the compiled engine."""
    interactions: str | Path | InteractionModel | ForceFunction = "learned"
    """The model of the aerodynamic forces, between drones and from the ground: `none`, `wake`,
    `learned`, `deep-set`, the path of a safetensors file, a model, or a function of positions,
    velocities and types that returns forces (see `swarm_envs.interactions.load`)."""
    action: str = "acceleration"
    """The action mode: `acceleration`, `velocity`, `ctbr`, `rotors` or `setpoint`."""
    clip_actions: bool = False
    """True to clip actions to [-1, 1], as Gaussian policies need; by default actions outside raise
    ValueError. Actions that are not finite always do."""
    decision_rate: int = 48
    """Actions per second: 240 over an integer."""
    force_rate: int = 240
    """Evaluations of the interaction force per second: 240 over an integer."""
    precision: str = "float64"
    """Precision of the force model's networks: `float64`, or `float32` for training (the error is
    about 1e-4 g). Everything else is float64."""
    interaction_torque: bool = False
    """True to let the interaction force also exert a torque: each rotor receives a quarter of the
    vertical force at its position (docs/forces.md)."""
    controller: ControllerConfig | None = None
    """The tracking controller between actions and rotors; None for the default."""
    num_neighbors: int = 3
    """K, the number of observed neighbors."""
    threads: int | None = None
    """Threads of the compiled engine, which do not change the result; None for one, or for all
    cores from 1,024 drones on."""
    observation: str = "flat"
    """Form of observations: `flat` rows, or a `dict` of `self`, `neighbors`, `mask`, `task`."""
    num_obstacles: int | None = None
    """M, the number of observed obstacles, nearest first; None: 3 if the task has obstacles, else
    0."""
    observe_load: bool = False
    """True to include the thrust margin, mass and charge of the drone and of its neighbors in
    observations."""
    observe_force: str | Path | InteractionModel | None = None
    """A force model whose prediction of the force on itself each drone observes, such as
    `swarm_envs.baselines.neural_swarm.load_belief()`; None for none."""
    observe_setpoint: bool = False
    """True to include the velocity and acceleration of the controller's set-point in observations:
    they are exact where the drone's own velocity is noisy."""
    observe_range_m: float | None = None
    """Communication range: a drone observes the neighbors within this distance, m; None: any."""
    observe_delay_s: float = 0.0
    """Communication delay: neighbors are observed as they were this long ago, s, rounded up to
    whole decisions; before the first messages arrive, none is observed."""
    observe_loss: float = 0.0
    """Packet loss: the probability that a neighbor is not observed in a decision, drawn for each
    pair by the environment's generator."""
    horizon_s: float | None = None
    """Time limit: an episode is truncated after this many seconds; None for the task's own."""
    end_on_success: bool = True
    """True to end the episode on success."""
    on_contact: str = "end_team"
    """Effect of a contact with a drone, the floor, a wall or an obstacle. `end_team`: ends the
    episode of the whole team. `end_pair`: ends the episodes of the drones in contact; the others
    continue. `bounce`: drones bounce off and continue; only tumbling ends a drone's episode."""
    world: str | Hall = "ideal"
    """`ideal`: controllers receive the true state, and forces and rotors follow their models.
    `hall`: a motion-capture hall with random forces and a state estimate. A
    `swarm_envs.hall.Hall` sets the parameters of the hall."""
    battery: BatteryModel | None = None
    """Model of batteries that discharge and weaken the rotors; None for ideal batteries."""
    randomization: Randomization | str | None = None
    """Domain randomization, sampled at every reset, also as a string such as
    `mass=0.9:1.1,thrust=0.95:1.05`; None for none."""
    deterministic: bool = False
    """True to get bitwise identical flights from every interface: the compiled engine is the
    default everywhere. By default, Bullet simulates single environments if it is installed, and
    the compiled engine batches. Flights on one engine are identical for any number of
    environments and threads."""
    force_bounds_g: Mapping[str, float] = field(default_factory=lambda: FORCE_BOUNDS_G)
    """Bounds on the vertical interaction force by vehicle token, gram-force: metrics count
    violations. Other types have no bound."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values and contradicting options."""
        if self.physics is not None:
            check_name("physics", self.physics, ENGINES)
        check_type("interactions", self.interactions, str | Path | InteractionModel | Callable)
        check_name("action", self.action, ACTIONS)
        for name in (
            "clip_actions",
            "interaction_torque",
            "observe_load",
            "observe_setpoint",
            "end_on_success",
            "deterministic",
        ):
            check_bool(name, getattr(self, name))
        for name in ("decision_rate", "force_rate"):
            check_divisor(name, getattr(self, name), PHYSICS_RATE)
        check_name("precision", self.precision, PRECISIONS)
        # str: the name of an agent in TaskOptions
        check_type("controller", self.controller, ControllerConfig | str | None)
        check_integer("num_neighbors", self.num_neighbors, at_least=0, at_most=MOST_OBSERVED)
        if self.threads is not None:
            check_integer("threads", self.threads, at_least=1, at_most=MOST_THREADS)
        check_name("observation", self.observation, FORMS)
        if self.num_obstacles is not None:
            check_integer("num_obstacles", self.num_obstacles, at_least=0, at_most=MOST_OBSERVED)
        check_type("observe_force", self.observe_force, str | Path | InteractionModel | None)
        if isinstance(self.observe_force, InteractionModel) and self.observe_force.function:
            raise ValueError(
                f"observe_force is the function {self.observe_force.name}, but must be a compiled "
                "model, such as load('learned')"
            )
        self._check_communication()
        if self.horizon_s is not None:
            check_number("horizon_s", self.horizon_s, above=0.0, unit="s")
        check_name("on_contact", self.on_contact, ON_CONTACT)
        check_type("battery", self.battery, BatteryModel | None)
        check_type("randomization", self.randomization, Randomization | str | None)
        check_type("world", self.world, Hall | str)
        if isinstance(self.world, str):
            check_name("world", self.world, WORLDS)
        check_type("force_bounds_g", self.force_bounds_g, Mapping)
        for token, bound in self.force_bounds_g.items():
            check_number(f"force_bounds_g[{token!r}]", bound, above=0.0, unit="gram-force")
        if self.observe_setpoint and ACTIONS[self.action].level != SETPOINTS:
            raise ValueError(
                f"observe_setpoint is True, but with action={self.action!r} there is no set-point "
                "to observe; leave it out, or choose another action"
            )
        ranges = self.ranges
        if ranges is not None and ranges.battery != SAME and self.battery is None:
            raise ValueError(
                f"Randomization.battery is {ranges.battery}, but ideal batteries never "
                "empty; give battery=BatteryModel() too, in Python"
            )
        if ranges is not None and ranges.hall != SAME and self.hall is None:
            raise ValueError(
                f"Randomization.hall is {ranges.hall}, but the world is ideal; give "
                'world="hall" (--world hall) or a Hall too'
            )
        if ranges is not None and ranges.noisy and self.hall is not None:
            raise ValueError(
                f"Randomization.noise is {ranges.noise}, but the hall has its own noise; leave it "
                "0, or give world=Hall(position_noise_m=...) of swarm_envs.hall"
            )

    def _check_communication(self) -> None:
        """Raise ValueError for invalid ranges, delays and losses."""
        if self.observe_range_m is not None:
            check_number("observe_range_m", self.observe_range_m, above=0.0, unit="m")
        check_number("observe_loss", self.observe_loss, at_least=0.0, at_most=1.0)
        check_number("observe_delay_s", self.observe_delay_s, at_least=0.0, at_most=60.0, unit="s")

    @property
    def communicates(self) -> bool:
        """True if the observation of neighbors is limited by range, delay or loss."""
        limited = self.observe_range_m is not None
        return limited or self.observe_delay_s > 0.0 or self.observe_loss > 0.0

    @property
    def ranges(self) -> Randomization | None:
        """The domain randomization; None for none."""
        return Randomization.of(self.randomization)

    @property
    def hall(self) -> Hall | None:
        """The parameters of the hall; None in the ideal world."""
        return Hall.of(self.world)

    @property
    def engine(self) -> str:
        """The name of the engine that is used: `bullet` or `batch`."""
        if self.physics is not None:
            return self.physics
        return "bullet" if bullet_available() and not self.deterministic else "batch"

    def threads_for(self, drones: int) -> int:
        """Return the number of threads for a number of drones in all environments together."""
        if self.threads is not None:
            return self.threads
        if drones < MANY_DRONES:
            return 1
        if hasattr(os, "sched_getaffinity"):  # the cores that this process may use; only on Linux
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1

    def obstacles_observed(self, present: int) -> int:
        """Return M, the number of observed obstacles, for a task with `present` obstacles."""
        if self.num_obstacles is None:
            return 3 if present else 0
        return self.num_obstacles

    @property
    def decision_s(self) -> float:
        """Time between actions, s."""
        return 1.0 / self.decision_rate


RESET_OPTIONS = ("start", "goal", "team")
"""Names that `reset(options=...)` accepts in every interface."""
_API_TEST_OPTION = "options"  # PettingZoo's parallel_api_test passes it to every environment


def check_num_envs(num_envs: object) -> int:
    """Return the number of environments of a batch.

    Raises:
        ValueError: it is no integer of at least 1, or larger than any memory could hold.
    """
    return check_integer("num_envs", num_envs, 1, MOST_ENVIRONMENTS)


def check_mask(mask: npt.ArrayLike, num_envs: int) -> BoolArray:
    """Return the mask (E,) of environments.

    Raises:
        ValueError: it is not (E,) booleans.
    """
    array = np.array(mask)
    if array.dtype != np.bool_ or array.shape != (num_envs,):
        raise ValueError(
            f"mask has type {array.dtype} and shape {array.shape}, but must be {num_envs} "
            "booleans, one for each environment"
        )
    return array


def check_seeds(seeds: Sequence[int | None] | None, num_envs: int) -> None:
    """Raise ValueError unless there is one seed for each environment."""
    if seeds is not None and len(seeds) != num_envs:
        raise ValueError(
            f"seeds has {len(seeds)} entries, but must have {num_envs}, one for each environment"
        )


def check_reset_options(
    options: Mapping[str, Any] | None, num_drones: int
) -> tuple[Team | None, dict[str, FloatArray]]:
    """Return the team of the episode, None for the constructor's, and the given `start` and `goal`.

    Raises:
        ValueError: the options are no mapping, an option is unknown, an array has a wrong shape or
            is not finite, or a team is unknown.
    """
    if options is None:
        return None, {}
    check_type("options", options, Mapping)
    given = {name: value for name, value in options.items() if name != _API_TEST_OPTION}
    for name in given:
        check_name("reset option", name, RESET_OPTIONS)
    team = given.pop("team", None)
    placement = {name: check_array(name, value, (num_drones, 3)) for name, value in given.items()}
    return None if team is None else parse_team(team), placement
