"""Flights whose every number is frozen: what they give is hashed and compared with a file.

    python -m tests.helpers.frozen                      compare with the file, and say what differs
    python -m tests.helpers.frozen --write              freeze what they give now

A rewrite that promises the same flights shows it here. The bytes are promised for one machine: the
file also holds a fingerprint of the arithmetic that froze it, and where that differs, some plain
numbers are compared instead. Nothing here looks inside the engine.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import math
import platform
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from safetensors.numpy import save_file
from tqdm import tqdm

import swarm_envs
from swarm_envs.control.config import ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.motors import BatteryModel
from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.state import Setpoint
from swarm_envs.tasks.obstacles import Box, Column
from swarm_envs.vehicles import parse_team

FILE = Path(__file__).parent.parent / "envs" / "frozen.json"
"""The results of the flights when they were frozen."""

Array = npt.NDArray[np.float64]


class Flown(NamedTuple):
    """The results of a flight."""

    arrays: dict[str, Array]  # by part, with one row per decision
    metrics: list[str]
    """Metrics of the episodes in the order in which they ended, then of those that go on; JSON."""
    numbers: list[float]  # where the first environment's drones ended, and the sum of its rewards
    touched: bool  # whether a drone touched anything: from there on rounding errors grow fast


class Log:
    """Return the results of a flight, row by row, as float64, which keeps integers and flags."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Array]] = {}
        self._metrics: list[str] = []
        self.touched = False

    def add(self, part: str, *arrays: npt.ArrayLike, lead: int = 2) -> None:
        """Add a row: arrays that share their first `lead` axes, one behind the other."""
        flat = [np.asarray(a, dtype=np.float64) for a in arrays]
        rows = [a.reshape(*a.shape[:lead], -1) for a in flat]
        self._rows.setdefault(part, []).append(np.concatenate(rows, axis=-1) + 0.0)

    def add_physics(self, physics: Any) -> None:
        """Add what an engine shows of itself: state, interaction force, contacts."""
        contacts = physics.contacts
        self.add("states", *physics.state)
        self.add("contacts", physics.force, *contacts)
        flags = contacts.floor, contacts.wall, contacts.tumbling
        bodies = (contacts.drone >= 0) | (contacts.obstacle >= 0)
        self.touched |= bool(bodies.any() or np.any(flags))

    def add_metrics(self, metrics: Mapping[str, Any]) -> None:
        """Add the metrics of one episode."""
        self._metrics.append(json.dumps(metrics, sort_keys=True, default=float))

    def flown(self) -> Flown:
        """Everything, put together."""
        arrays = {part: np.stack(rows) for part, rows in self._rows.items()}
        numbers = []
        if "states" in arrays:
            numbers += arrays["states"][-1, 0, :, :3].ravel().tolist()
        if "rewards" in arrays:
            numbers.append(float(arrays["rewards"][:, 0, :, 0].sum()))
        if not numbers:
            numbers = [float(a.ravel()[k]) for a in arrays.values() for k in (0, a.size // 2, -1)]
        return Flown(arrays, self._metrics, numbers, self.touched)


# What drones are told, by the name of a pilot. Each draws from the flight's own generator.

Draw = Callable[[np.random.Generator, Any, tuple[int, int, int]], Array]


def _uniform(scale: float, offset: float = 0.0, limit: float = math.inf) -> Draw:
    def draw(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
        return np.clip(offset + scale * rng.uniform(-1.0, 1.0, shape), -limit, limit)

    return draw


def _gentle(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
    return rng.uniform(-0.4, 0.4, shape)


def _tumbling(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
    return np.array([0.9, 0.9, -0.9, -0.9]) * rng.uniform(0.5, 1.0, (*shape[:2], 1))


def _to_a_wall(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
    return np.array([0.9, 0.0, 0.1]) + 0.1 * rng.uniform(-1.0, 1.0, shape)


def _near(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
    actions = 0.05 * rng.standard_normal(shape)
    actions[..., :3] += core.physics.state.position
    return actions


def _to(place: Sequence[float] | Array, spread: float = 0.005) -> Draw:
    def draw(rng: np.random.Generator, core: Any, shape: tuple[int, int, int]) -> Array:
        actions = np.zeros(shape)
        actions[..., :3] = np.asarray(place) + spread * rng.standard_normal((*shape[:2], 3))
        return actions

    return draw


EVERYTHING = Randomization(
    mass=(0.9, 1.1),
    inertia=(0.8, 1.2),
    motor_rate=(0.8, 1.2),
    thrust=(0.95, 1.05),
    force_scale=(0.5, 1.5),
    battery=(0.5, 1.0),
    gust_acceleration=1.0,
    gust_time_s=0.5,
    position_noise_m=0.01,
    velocity_noise=0.05,
    attitude_noise_rad=0.02,
    body_rate_noise=0.1,
)
"""All that can be randomised."""


@dataclass(frozen=True)
class Flight:
    """A flight of environments: what flies, what it is told, and which seeds it is flown with."""

    task: str = "swap_v1"  # which task
    engine: str = "batch"  # `batch` or `bullet`
    options: Mapping[str, Any] = field(default_factory=dict)  # options of the task's `parallel_env`
    draw: Draw = _gentle  # what draws the actions
    envs: int | None = None  # environments of a batch; None for one behind PettingZoo's interface
    seeds: tuple[int, ...] = (1, 2)  # each is a flight of its own
    decisions: int = 30  # how many are flown
    placed: tuple[Mapping[str, Any], ...] = ({},)  # options of the resets, in turn
    resets_every: int = 1
    """Environments whose episode has ended begin another after every so many decisions."""
    returns_at: int | None = None
    """At this decision a snapshot is taken, something else flown, and the snapshot gone back to."""

    def fly(self, seed: int) -> Flown:
        """Fly it."""
        return self._fly_batch(seed) if self.envs else self._fly_single(seed)

    def _fly_batch(self, seed: int) -> Flown:
        module = importlib.import_module(f"swarm_envs.{self.task}")
        task, config, _ = module.blueprint(physics=self.engine, **self.options)
        core = SwarmCore(task, config, self.envs or 1)
        log, rng, turn = Log(), np.random.default_rng(1000 + seed), 0
        seeds = [100 * seed + e for e in range(core.num_envs)]
        log.add("observations", core.reset(seeds, options=self.placed[0]))
        log.add_physics(core.physics)
        shape = (core.num_envs, core.num_drones, core.mode.width)
        for k in range(1, self.decisions + 1):
            result = core.step(self.draw(rng, core, shape))
            terms = np.moveaxis(result.reward_terms, 0, -1)
            log.add("observations", result.observations)
            log.add("rewards", result.rewards, terms, *_by_drone(core, result))
            log.add_physics(core.physics)
            if k % self.resets_every or core.running.all():
                continue
            turn, mask = turn + 1, ~core.running
            for e in np.flatnonzero(mask).tolist():
                log.add_metrics(core.metrics(e))
            told = self.placed[turn % len(self.placed)]
            log.add("observations", core.reset(mask=mask, options=told))
        for e in range(core.num_envs):
            log.add_metrics(core.metrics(e))
        core.close()
        return log.flown()

    def _fly_single(self, seed: int) -> Flown:
        env = swarm_envs.make(self.task, physics=self.engine, **self.options)
        core = env.core
        log, rng, turn = Log(), np.random.default_rng(1000 + seed), 0
        observations, _ = env.reset(seed=seed, options=self.placed[0])
        log.add("observations", np.array([*observations.values()])[None])
        shape = (1, core.num_drones, core.mode.width)
        for k in range(1, self.decisions + 1):
            if k == self.returns_at:
                self._stray(env, np.random.default_rng(7), shape)
            if not env.agents:
                turn += 1
                log.add_metrics(core.metrics(0))
                observations, _ = env.reset(options=self.placed[turn % len(self.placed)])
                log.add("observations", np.array([*observations.values()])[None])
            actions = self.draw(rng, core, shape)[0].astype(np.float32)
            told = dict(zip(env.agents, actions, strict=True))
            observations, rewards, ended, cut, infos = env.step(told)
            terms = [[*info["reward_terms"].values()] for info in infos.values()]
            ends = [[*ended.values()]], [[*cut.values()]]
            log.add("observations", np.array([*observations.values()])[None])
            log.add("rewards", [[*rewards.values()]], [terms], *ends)
            log.add("team", env.state(), lead=0)
            log.add_physics(core.physics)
        log.add_metrics(core.metrics(0))
        env.close()
        return log.flown()

    def _stray(self, env: Any, rng: np.random.Generator, shape: tuple[int, int, int]) -> None:
        """Take a snapshot, fly elsewhere and into another episode, and go back to it."""
        snapshot = env.get_state()
        for _ in range(5):
            if env.agents:
                actions = self.draw(rng, env.core, shape)[0].astype(np.float32)
                env.step(dict(zip(env.agents, actions, strict=True)))
        env.reset(seed=99)
        env.set_state(snapshot)


def _by_drone(core: Any, result: Any) -> list[Array]:
    """Flags of environments (E,), as columns of their drones."""
    flags = (result.terminated, result.truncated, core.running)
    return [np.repeat(np.asarray(f, np.float64)[:, None], core.num_drones, axis=1) for f in flags]


@cache
def pairwise_model() -> InteractionModel:
    """A pairwise sum of networks with weights drawn once; none ships."""
    types, rng = ("S", "L"), np.random.default_rng(3)
    networks = {f"pair.{other}.{own}": (6, 16, 16, 1) for other in types for own in types}
    networks |= {f"environment.{name}": (4, 16, 16, 1) for name in types}
    tensors = {f"drag.{name}": np.full(3, 0.02) for name in types}
    for name, widths in networks.items():
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            scale = 1.0 / math.sqrt(inputs)
            tensors[f"{name}.{k}.weight"] = scale * rng.normal(size=(outputs, inputs))
            tensors[f"{name}.{k}.bias"] = 0.1 * rng.normal(size=outputs)
    window = {"lateral_m": [0.25, 0.35], "vertical_m": [0.8, 1.1]}
    note = {"format": "pairwise-1", "types": types, "anchor_height_m": 0.6, "window": window}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pairwise.safetensors"
        save_file(tensors, path, metadata={"swarm_envs": json.dumps(note)})
        return load(path)


@dataclass(frozen=True)
class PhysicsAlone:
    """An engine without environments, pushed by an external force as well."""

    engine: str
    team: str
    envs: int
    seeds: tuple[int, ...] = (1, 2)
    steps: int = 120

    def fly(self, seed: int) -> Flown:
        """Fly it; half way some environments are set to another state."""
        engine = {"batch": BatchPhysics, "bullet": BulletPhysics}[self.engine]
        physics = engine(self.team, num_envs=self.envs, interactions="learned")
        rng, log = np.random.default_rng(seed), Log()
        shape = (self.envs, len(physics.team))
        hover = physics.state.rotor_thrust.copy()
        for k in range(self.steps):
            if k % (self.steps // 2) == 0:
                row = 0.3 * np.arange(shape[1])[:, None] * [0.8, 0.1, 0.0] + [0.0, 0.0, 1.0]
                position = row + 0.05 * rng.standard_normal((*shape, 3))
                velocity = 0.2 * rng.standard_normal((*shape, 3))
                start = physics.state._replace(position=position, velocity=velocity)
                mask = None if k == 0 else np.arange(self.envs) % 2 == 0
                physics.reset(start, mask=mask)
                log.add_physics(physics)
            commands = hover * (1.0 + 0.1 * rng.standard_normal((*shape, 4)))
            external = None if k % 3 == 0 else 0.01 * rng.standard_normal((*shape, 3))
            physics.step(commands, external)
            log.add_physics(physics)
        physics.close()
        return log.flown()


@dataclass(frozen=True)
class TrackingAlone:
    """The tracking controller, shown states that nothing has flown."""

    config: ControllerConfig
    seeds: tuple[int, ...] = (1, 2)
    engine: str = "batch"
    steps: int = 60

    def fly(self, seed: int) -> Flown:
        """Ask for its commands; its memory is cleared in some environments half way."""
        rng, log, team = np.random.default_rng(seed), Log(), parse_team("LSS*")
        controller = TrackingController(team, 3, self.config)
        like = BatchPhysics(team, num_envs=3, interactions="none").state
        for k in range(self.steps):
            if k == self.steps // 2:
                controller.reset(np.array([False, True, False]))
            turn = np.array([0.0, 0.0, 0.0, 1.0]) + 0.2 * rng.standard_normal((3, 3, 4))
            state = like._replace(
                position=like.position + 0.1 * rng.standard_normal((3, 3, 3)),
                velocity=0.5 * rng.standard_normal((3, 3, 3)),
                quaternion=turn / np.sqrt((turn * turn).sum(axis=-1, keepdims=True)),
                angular_velocity=rng.standard_normal((3, 3, 3)),
            )
            vectors = [0.2 * rng.standard_normal((3, 3, 3)) for _ in range(4)]
            vectors[0] += like.position
            setpoint = Setpoint(*vectors, *rng.standard_normal((2, 3, 3)))
            believed = None if k % 2 else 0.01 * rng.standard_normal((3, 3, 3))
            log.add("states", controller.commands(state, setpoint, believed))
        return log.flown()


@dataclass(frozen=True)
class ForcesAlone:
    """The forces of a model on crowds at random."""

    model: Callable[[], InteractionModel]
    seeds: tuple[int, ...] = (1,)
    engine: str = "batch"

    def fly(self, seed: int) -> Flown:
        """Ask for the forces of crowds of several sizes, in one environment and in several."""
        rng, log, model = np.random.default_rng(seed), Log(), self.model()
        for envs, team in ((1, "S"), (1, "LS"), (3, "LSS*S"), (2, "SL" * 13), (1, "SLS" * 10)):
            shape = (envs, len(parse_team(team)), 3)
            position = rng.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.8], shape)
            velocity = rng.normal(0.0, 0.4, shape)
            log.add(f"{envs} x {team}", model.forces(position, velocity, team))
        return log.flown()


_LEVELS: dict[str, Draw] = {
    "acceleration": _to_a_wall,
    "velocity": _uniform(1.0),
    "ctbr": _uniform(0.1, 0.05),
    "rotors": _tumbling,
    "setpoint": _to([0.0, 0.0, 1.0], 0.02),
}
"""Every action level, with actions that soon lead to a contact."""
_WORLDS = ("ideal", "hall")
_CONTACTS = ("end_team", "end_pair", "bounce")
_LAYOUTS: dict[str, tuple[dict[str, Any], ...]] = {
    "columns_v0": ({"layout": "stack"}, {"layout": "sprint"}),
    "gates_v0": ({"team": "LSS"},),
    "delivery_v0": ({"num_drones": 5},),
    "pursuit_v0": tuple({"layout": name} for name in ("moving", "swap-goals", "chase")),
    "crowd_v0": tuple({"layout": n, "num_drones": 8} for n in ("open", "forest", "buildings")),
    "swap_v1": ({"team": "LSS*S"},),
}


def _worlds_and_contacts() -> dict[str, Any]:
    """Return flights of each task with each layout, action level, world and `on_contact`.

    Each value of these occurs with each task, but not each combination of them.
    """
    flights: dict[str, Any] = {}
    for number, (task, layouts) in enumerate(_LAYOUTS.items()):
        for level, (action, draw) in enumerate(_LEVELS.items()):
            layout = layouts[level % len(layouts)]
            world = _WORLDS[(level + number) % 2]
            contact = _CONTACTS[(level + number) % 3]
            options = {**layout, "action": action, "world": world, "on_contact": contact}
            flight = Flight(task, options=options, draw=draw, envs=3, decisions=60, resets_every=4)
            flights[f"{task} by {action}, {world}, {contact}"] = flight
        options = {**layouts[-1], "world": "hall"}
        flights[f"Bullet, {task}"] = Flight(
            task, "bullet", options, envs=2, seeds=(1,), decisions=20
        )
    return flights


def _flights() -> dict[str, Any]:
    """Every flight by its name: batches, single environments, Bullet, then parts alone."""
    start = np.array([[-0.5, 0.0, 1.0], [0.5, 0.1, 1.1], [0.0, 0.6, 0.9]])
    near = start + np.array([0.12, 0.0, 0.05])
    wake = ControllerConfig(feedforward=load("wake"), velocity_integral_limit=0.05)
    everything = {"randomization": EVERYTHING, "battery": BatteryModel(), "controller": wake}
    everything |= {"team": "LSS*", "force_rate": 80, "horizon_s": 0.5}
    box, column = Box((-0.2, -0.2, 0.0), (0.2, 0.2, 0.6)), Column((0.6, 0.6), 0.1, 2.0)
    standing = {"obstacles": (box, column)}
    four = {"team": "SSSS"}
    mixed = {"team": "LSS*"}
    short = {"force_rate": 48, "horizon_s": 0.3}
    calm = {"interactions": "none"}
    rotors = {"action": "rotors"}
    setpoint = {"action": "setpoint"}
    mission = {"num_drones": 4, "shapes": ("plane", "sphere", "plane"), "shape_s": 0.4}
    mission |= {"travel_s": 0.2, **setpoint}
    stack = {"team": "L2S", "layout": "stacked"}
    pairs = {"interactions": pairwise_model()}
    meeting = mixed | setpoint | {"decision_rate": 24}
    walls = four | {"decision_rate": 24}
    many = {"num_drones": 26, "force_rate": 48}
    rates, falling = _uniform(0.05), _uniform(0.5, -0.3, limit=1.0)
    two = {"threads": 2}

    def batch(options: dict[str, Any], draw: Draw = _gentle, **given: Any) -> Flight:
        return Flight(**{"envs": 5, "options": options, "draw": draw, **given})

    def bullet(options: dict[str, Any], draw: Draw = _gentle, **given: Any) -> Flight:
        return Flight(engine="bullet", options=options, draw=draw, **given)

    three: dict[str, Any] = {"seeds": (1, 2, 3), "decisions": 40}
    reached: dict[str, Any] = {
        "draw": _to(near),
        "placed": ({"start": start, "goal": near},),
        "decisions": 50,
    }
    met: dict[str, Any] = {"draw": _to([0.0, 0.0, 1.0], 0.02), "decisions": 60, "resets_every": 2}
    teams: tuple[dict[str, Any], ...] = (
        {"team": "SSL", "start": start},
        {"start": start, "goal": near},
        {},
    )
    circle = mixed | {"layout": "circle", "action": "velocity", "interactions": "wake"}
    single = load("learned").with_precision("float32")
    ctbr = four | calm | {"action": "ctbr", "decision_rate": 240}
    return {
        "swaps by acceleration": batch(four | {"threads": 1}, **three),
        "swaps by acceleration, two threads": batch(four | two, **three),
        "33 swaps": batch(short | {"threads": 1}, envs=33),
        "33 swaps, two threads": batch(short | two, envs=33),
        "circles by velocity": batch(circle | {"force_rate": 48}, _uniform(1.0)),
        "stacks by acceleration": batch(stack, decisions=40),
        "stacks, float32, forces 48 a second": batch(
            stack | {"interactions": single, "force_rate": 48}
        ),
        "rings by body rates": batch(ctbr, rates, task="ring_v1", decisions=60),
        "rings by rotors, into the floor": batch(
            four | calm | rotors, falling, task="ring_v1", decisions=60, resets_every=3
        ),
        "formations by set-points": batch(mission, _near, task="formation_v1", decisions=50),
        "26 drones": batch(many, envs=1, decisions=20),
        "26 drones each, two threads": batch(many | two | {"interactions": "wake"}, decisions=20),
        "pairwise forces": batch(stack | pairs | {"team": "LSS*S"}),
        "everything drawn": batch(everything, **three),
        "everything drawn, two threads": batch(everything | two, **three),
        "obstacles in the way": batch(meeting | standing, _to([0.0, 0.0, 0.5]), decisions=50),
        "teams, starts and goals of a reset": batch(
            mixed | {"horizon_s": 0.25, "force_rate": 240}, placed=teams, decisions=50
        ),
        "successes": batch(meeting, **reached, resets_every=2),
        "collisions": batch(meeting | {"controller": wake}, **met, placed=({"start": start}, {})),
        "into the walls": batch(walls, _to_a_wall, decisions=50),
        "tumbling": batch(
            mixed | rotors | {"num_neighbors": 1}, _tumbling, decisions=60, resets_every=5
        ),
        "a swap goes on": Flight(options=everything, decisions=60),
        "a swap goes on from a snapshot": Flight(options=everything, decisions=60, returns_at=20),
        **_worlds_and_contacts(),
        "Bullet by acceleration": bullet(four),
        "Bullet by velocity": bullet(
            four | {"action": "velocity", "force_rate": 48}, task="ring_v1"
        ),
        "Bullet by body rates": bullet(stack | {"action": "ctbr"}, rates),
        "Bullet by rotors": bullet(mixed | rotors | {"interactions": "wake"}, _uniform(0.02, 0.05)),
        "Bullet by set-points": bullet(mission | {"horizon_s": 0.4}, _near, task="formation_v1"),
        "Bullet, pairwise forces": bullet(stack | pairs, seeds=(1,)),
        "Bullet, 26 drones": bullet(many, seeds=(1,), decisions=20),
        "Bullet, successes": bullet(meeting, **reached),
        "Bullet, collisions": bullet(
            meeting, **met, envs=3, placed=({"start": start}, {}, {"team": "SSL"})
        ),
        "Bullet, into the walls": bullet(walls, _to_a_wall, decisions=50),
        "Bullet, tumbling": bullet(mixed | rotors, _tumbling, decisions=40),
        "Bullet, everything drawn": bullet(everything | standing, envs=3, decisions=40),
        "Bullet goes on": bullet(everything, decisions=40),
        "Bullet goes on from a snapshot": bullet(everything, decisions=40, returns_at=15),
        "BatchPhysics, 1 x 2": PhysicsAlone("batch", "LS", 1),
        "BatchPhysics, 7 x 5": PhysicsAlone("batch", "LSS*SL", 7),
        "BulletPhysics, 1 x 2": PhysicsAlone("bullet", "LS", 1),
        "BulletPhysics, 2 x 5": PhysicsAlone("bullet", "LSS*SL", 2, seeds=(1,)),
        "tracking": TrackingAlone(ControllerConfig(velocity_integral_limit=0.05)),
        "tracking with compensation": TrackingAlone(wake, seeds=(1,)),
        "forces, learned": ForcesAlone(lambda: load("learned")),
        "forces, learned, float32": ForcesAlone(lambda: load("learned").with_precision("float32")),
        "forces, wake": ForcesAlone(lambda: load("wake")),
        "forces, pairwise": ForcesAlone(pairwise_model),
    }


FLIGHTS: dict[str, Any] = _flights()  # every flight by its name
JOBS = [(name, seed) for name, flight in FLIGHTS.items() for seed in flight.seeds]
"""Every flight with each of its seeds."""
TWINS = {
    "swaps by acceleration, two threads": "swaps by acceleration",
    "33 swaps, two threads": "33 swaps",
    "everything drawn, two threads": "everything drawn",
    "a swap goes on from a snapshot": "a swap goes on",
    "Bullet goes on from a snapshot": "Bullet goes on",
}
"""Flights that must be another to the last bit."""


def can_fly(name: str) -> bool:
    """Return True if the flight's engine is installed."""
    return FLIGHTS[name].engine != "bullet" or bullet_available()


def frozen(flown: Flown) -> dict[str, Any]:
    """Return a flight's entry in the file: a hash of each part, and numbers unless it touched."""
    hashes = {}
    for part, array in flown.arrays.items():
        clean = np.where(np.isnan(array), np.nan, array).astype("<f8")  # any NaN is the same
        hashes[part] = hashlib.sha256(repr(clean.shape).encode() + clean.tobytes()).hexdigest()
    if flown.metrics:
        text = "\n".join(flown.metrics).replace("-0.0,", "0.0,")
        hashes["metrics"] = hashlib.sha256(text.encode()).hexdigest()
    return {"hashes": hashes, "numbers": None if flown.touched else flown.numbers}


def fingerprint() -> dict[str, str]:
    """Return all that the last bit of a flight depends on beside our sources.

    Results of the mathematical functions that kernels and numpy call here, whether compiled code
    fuses a product with a sum, and the versions whose random numbers and compiler were used.
    """
    rng = np.random.default_rng(0)
    a, b, c = rng.uniform(0.1, 3.0, (3, 512))
    compiled = numba.njit(error_model="numpy")(_arithmetic)(a, b, c)
    vectors = [np.sin(a), np.cos(a), np.exp(a), np.log(a), np.sqrt(a), np.arctan2(a, b), a * b + c]
    square = a.reshape(16, 32)
    products = [square @ square.T, np.einsum("ij,kj->ik", square, square), a.sum(keepdims=True)]
    return {
        "machine": platform.machine(),
        "numba": ".".join(numba.__version__.split(".")[:2]),
        "numpy": ".".join(np.__version__.split(".")[:2]),
        "kernels": "interpreted" if numba.config.DISABLE_JIT else "compiled",
        "compiled arithmetic": hashlib.sha256(compiled.tobytes()).hexdigest()[:16],
        "vector arithmetic": _digest(vectors),
        "products": _digest(products),
    }


def _digest(arrays: Sequence[Array]) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()[:16]


def _arithmetic(a: Array, b: Array, c: Array) -> Array:
    out = np.empty((9, a.shape[0]))
    for k in range(a.shape[0]):
        out[0, k], out[1, k], out[2, k] = math.sin(a[k]), math.cos(a[k]), math.tan(a[k])
        out[3, k], out[4, k] = math.exp(a[k]), math.log(a[k])
        out[5, k], out[6, k] = math.atan2(a[k], b[k]), math.sqrt(a[k])
        out[7, k], out[8, k] = a[k] * b[k] + c[k], a[k] ** b[k]
    return out


def differences(now: Mapping[str, Any], then: Mapping[str, Any], same_machine: bool) -> list[str]:
    """Return the differences between a flight and its frozen entry, in words, or nothing.

    Args:
        now: as `frozen` gives it.
        then: what the file says.
        same_machine: whether the arithmetic is that of the file, so that bytes can be compared.
    """
    if same_machine:
        names = {*now["hashes"], *then["hashes"]}
        return sorted(n for n in names if now["hashes"].get(n) != then["hashes"].get(n))
    if now["numbers"] is None or then["numbers"] is None:
        return []
    found, expected = np.array(now["numbers"]), np.array(then["numbers"])
    if found.shape != expected.shape:
        return ["how many numbers there are"]
    apart = np.abs(found - expected) > 1e-9 * np.maximum(np.abs(expected), 1e-3)
    return [f"number {k}: {found[k]!r}, not {expected[k]!r}" for k in np.flatnonzero(apart)]


def read() -> dict[str, Any]:
    """The file."""
    kept: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return kept


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly everything, then write the file or compare with it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="freeze what the flights give now")
    parser.add_argument("--only", help="fly only what has this in its name")
    options = parser.parse_args(arguments)
    jobs = [job for job in JOBS if can_fly(job[0]) and (options.only or "") in job[0]]
    found: dict[str, Any] = {}
    for name, seed in tqdm(jobs, unit="flight"):
        found[f"{name}, seed {seed}"] = frozen(FLIGHTS[name].fly(seed))
    if options.write:
        kept = {"fingerprint": fingerprint(), "flights": found}
        FILE.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        print(f"froze {len(found)} flights in {FILE}")
        return 0
    kept = read()
    same = fingerprint() == kept["fingerprint"]
    wrong = {name: differences(now, kept["flights"][name], same) for name, now in found.items()}
    for name, parts in wrong.items():
        if parts:
            print(f"{name}: {', '.join(parts)}")
    what = "bytes" if same else "numbers, since this machine computes otherwise,"
    print(f"{sum(not parts for parts in wrong.values())} of {len(wrong)} flights: same {what}")
    return int(any(wrong.values()))


if __name__ == "__main__":
    sys.exit(main())
