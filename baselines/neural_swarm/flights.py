"""Flight tests: references, a controller and a force that it may not know; statistics of flights.

`run_flights` flies one case for many seeds: the compiled engine all of them at once, Bullet one
after another with the same result. A `FlightTest` has the team, its references and the forces,
its `ControllerConfig` which force is compensated, with which gains and filters.

Both sides of a comparison take the same seeds: episode `e` then has the same starts and references.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.baselines.neural_swarm.agent import TrackingAgent
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.randomization import Randomization
from swarm_envs.hall import Hall
from swarm_envs.interactions import InteractionModel
from swarm_envs.physics import bullet_available
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.motion import reference_of
from swarm_envs.tasks.swap import StackedLayout, SwapTask
from swarm_envs.vehicles import Team, parse_team
from swarm_envs.viewing.record import FlightRecord

__all__ = [
    "PAPER_SWAP",
    "FlightTest",
    "Flights",
    "default_engine",
    "describe_model",
    "describe_spread",
    "format_columns",
    "quartiles",
    "run_flights",
    "swap_test",
    "versions",
]

PAPER_SWAP = StackedLayout(radius_m=(0.5, 0.5), duration_s=(4.0, 4.0))
"""The swap of Neural-Swarm2, Fig. 8: 0.5 m in 4 s. Plane distance and direction are drawn."""

RECOVERY_S = 2.0  # A swap is flown for so much longer than it takes, to see the drones recover

AT_ONCE = 32
"""Flights in the air at the same time: more need more memory and are no faster."""


@dataclass(frozen=True)
class FlightTest:
    """What is flown, and under which forces; the controller is what a test compares."""

    task: Task
    """Team and references, such as `SwapTask(parse_team("L2S"), "stacked", layout)`."""
    truth: str | Path | InteractionModel = "learned"
    """The force model of the environment. No controller reads it."""
    engine: str = "batch"
    """`bullet` or `batch`; see `default_engine`."""
    horizon_s: float | None = None
    """Length of a flight, s; None for the task's own."""
    randomization: Randomization | None = None
    """What else differs from episode to episode; None for nothing."""
    world: str | Hall = "ideal"
    """Whether it is flown in the ideal world, or in the hall; see `EnvConfig`."""
    decision_rate: int = 48
    """Set-points a second, and samples of what is recorded."""

    @property
    def seconds(self) -> float:
        """Length of a flight, s."""
        return self.task.episode_s if self.horizon_s is None else self.horizon_s

    @property
    def decisions(self) -> int:
        """Set-points of a flight that is flown to its end."""
        return round(self.seconds * self.decision_rate)

    def core(self, num_envs: int, **loop: Any) -> SwarmCore:
        """The environments of as many flights; `loop` says what flies them, as `EnvConfig` does."""
        config = EnvConfig(
            physics=self.engine,
            interactions=self.truth,
            horizon_s=self.horizon_s,
            randomization=self.randomization,
            world=self.world,
            end_on_success=False,
            **loop,
        )
        return SwarmCore(self.task, config, num_envs)


@dataclass(frozen=True)
class Flights:
    """E flights of a test by one controller, T samples each. World frame, SI."""

    team: Team
    """The N vehicles."""
    seeds: tuple[int, ...]
    """(E,) of the episodes."""
    time: FloatArray
    """(T,) s since the start."""
    samples: IntArray
    """(E,) samples until the flight ended; later ones repeat its last state."""
    position: FloatArray
    """(E, T, N, 3) m."""
    velocity: FloatArray
    """(E, T, N, 3) m/s."""
    quaternion: FloatArray
    """(E, T, N, 4) attitude, (x, y, z, w), body to world."""
    reference: FloatArray
    """(E, T, N, 3) where the drones should have been, m."""
    force: FloatArray
    """(E, T, N, 3) the force of the environment, N."""
    believed: FloatArray
    """(E, T, N, 3) what the controller compensated in the same step, N; zeros if nothing."""
    worst_height_error: FloatArray
    """(E, N) largest vertical distance to the reference since errors count, m."""
    worst_error: FloatArray
    """(E, N) the same of the whole distance, m."""
    crashed: BoolArray
    """(E,) ended by a collision or a tumble: its errors are not its worst."""
    metrics: tuple[dict[str, Any], ...]
    """(E,) see `swarm_envs.envs.evaluation.metrics`."""

    def record(self, e: int) -> FlightRecord:
        """Flight `e` as plots and films take it."""
        shown = slice(0, int(self.samples[e]))
        return FlightRecord(
            team=self.team,
            time=self.time[shown],
            position=self.position[e, shown],
            quaternion=self.quaternion[e, shown],
            reference=self.reference[e, shown],
            force=self.force[e, shown],
        )


def swap_test(
    team: str | Team,
    layout: StackedLayout = PAPER_SWAP,
    truth: str | Path | InteractionModel = "learned",
    engine: str = "batch",
) -> FlightTest:
    """Stacked swaps of a team, the uppermost drone first."""
    task = SwapTask(parse_team(team), "stacked", layout)
    return FlightTest(task, truth, engine, horizon_s=layout.duration_s[1] + RECOVERY_S)


def default_engine() -> str:
    """Bullet where it can be imported, else its compiled engine."""
    return "bullet" if bullet_available() else "batch"


def progress_bar(title: str, decisions: int, shown: bool = True) -> tqdm[NoReturn]:
    """A bar that `run_flights` ticks, in seconds of flight at the usual decision rate."""
    return tqdm(
        total=decisions,
        desc=title,
        unit=" s flown",
        unit_scale=1.0 / FlightTest.decision_rate,
        mininterval=0.5,
        disable=not shown,
        bar_format="{l_bar}{bar}| {n:.0f}/{total:.0f}{unit} [{elapsed}<{remaining}{postfix}]",
    )


def run_flights(
    test: FlightTest,
    controller: ControllerConfig,
    seeds: Sequence[int],
    tick: Callable[[int], object] = lambda decisions: None,
) -> Flights:
    """Fly one episode for each seed. The same seeds give the same flights.

    Args:
        test: what is flown, and under which forces.
        controller: of every drone.
        seeds: at least one.
        tick: called along the way with the decisions that were flown since the last call, of all
            flights together; see `decisions`.

    Raises:
        ValueError: no seed is given, or the test cannot be flown.
        ImportError: Bullet is asked for, and not there.
    """
    if not seeds:
        raise ValueError("no seed was given; give one for each flight")
    parts: list[dict[str, Any]] = []
    metrics: list[dict[str, Any]] = []
    for first in range(0, len(seeds), AT_ONCE):
        together = list(seeds[first : first + AT_ONCE])
        core = test.core(len(together), **TrackingAgent(controller, test.decision_rate).requires)
        try:
            core.reset(together)
            parts.append(_follow_references(core, 1 + test.decisions, tick))
            metrics += core.metrics_of(range(core.num_envs))
        finally:
            core.close()
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Flights(
        team=test.task.team,
        seeds=tuple(seeds),
        time=np.arange(1 + test.decisions) / test.decision_rate,
        metrics=tuple(metrics),
        **arrays,
    )


def _follow_references(
    core: SwarmCore, length: int, tick: Callable[[int], object]
) -> dict[str, Any]:
    """Fly as `TrackingAgent` does, to the end; fields of `Flights`, with room for T samples."""
    arrays: dict[str, Any] = {
        name: np.zeros((core.num_envs, length, *value.shape[1:]))
        for name, value in _sample(core).items()
    }
    samples = np.zeros(core.num_envs, dtype=np.int64)
    yaw = np.zeros((core.num_envs, core.num_drones, 2))
    running, k = np.ones(core.num_envs, dtype=np.bool_), 0
    while running.any():
        for name, value in _sample(core).items():  # a flight that ends keeps its last state
            arrays[name][running, k:] = value[running, None]
        k += 1
        samples[running] = k
        running = core.running.copy()
        if running.any():
            core.step(np.concatenate([*reference_of(core.world.drones), yaw], axis=-1))
            tick(int(running.sum()))
    drones = core.world.drones
    return arrays | {
        "samples": samples,
        "worst_height_error": drones["worst_height_error"].copy(),
        "worst_error": drones["worst_error"].copy(),
        "crashed": (drones["crashed"] > 0.0).any(axis=1),
    }


def _sample(core: SwarmCore) -> dict[str, FloatArray]:
    """(E, N, width) what is sampled."""
    state, drones = core.physics.state, core.world.drones
    return {
        "position": state.position,
        "velocity": state.velocity,
        "quaternion": state.quaternion,
        "reference": drones["reference_position"],
        "force": core.physics.force,
        "believed": drones["feedforward_force"],
    }


# ---- What reports of flights share: statistics, whose weights flew, which versions

_PACKAGES = ("numpy", "numba", "pybullet", "gymnasium", "pettingzoo")


def quartiles(values: npt.ArrayLike) -> dict[str, float]:
    """Median and quartiles of numbers, by linear interpolation."""
    low, median, high = np.quantile(np.asarray(values), [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "lower_quartile": low, "upper_quartile": high}


def describe_spread(statistics: dict[str, float]) -> str:
    """Write what `quartiles` gave as `median (lower - upper)`."""
    median, low, high = (statistics[k] for k in ("median", "lower_quartile", "upper_quartile"))
    return f"{median:.1f} ({low:.1f} - {high:.1f})"


def describe_model(model: InteractionModel) -> dict[str, str]:
    """Name of a model and the hash of its weights file, without the place of that file."""
    file = Path(model.name)
    if file.is_file():
        return {"name": file.name, "sha256": _sha256(file)}
    shipped = resources.files("swarm_envs.interactions").joinpath("weights")
    for name in (f"{model.name}.safetensors", f"{model.name}.json"):
        with resources.as_file(shipped.joinpath(name)) as path:
            if path.is_file():
                return {"name": model.name, "sha256": _sha256(path)}
    return {"name": model.name, "sha256": ""}


def versions() -> dict[str, str]:
    """Versions of what computes a flight, by package."""
    found = {"swarm_envs": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def format_columns(rows: Sequence[tuple[str, ...]], rule: bool = True) -> list[str]:
    """Lines of a table: the first column to the left, others right.

    Args:
        rows: the head first.
        rule: draw a line of hyphens below the head.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    ]
    return [*lines[:1], *["  ".join("-" * width for width in widths)] * rule, *lines[1:]]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
