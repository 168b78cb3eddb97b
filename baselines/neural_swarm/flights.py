"""Flight tests of controllers under interaction forces, and statistics of flights.

`run_flights` simulates one test for many seeds, with the compiled engine all at once, with Bullet
one after another. A `FlightTest` has the team, its references and the true forces; the
`ControllerConfig` has the compensated force, the gains and the filters.

To compare controllers, use the same seeds: episode `e` then has the same starts and references.
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

RECOVERY_S = 2.0  # The time that is simulated after a swap, to show the drones recover

AT_ONCE = 32
"""The number of flights simulated at once; more need more memory and are no faster."""


@dataclass(frozen=True)
class FlightTest:
    """A flight test: task, force model and simulation, for which controllers are compared."""

    task: Task
    """The task, with team and references: `SwapTask(parse_team("L2S"), "stacked", layout)`."""
    truth: str | Path | InteractionModel = "learned"
    """The force model of the environment. No controller reads it."""
    engine: str = "batch"
    """The physics engine, `bullet` or `batch`; see `default_engine`."""
    horizon_s: float | None = None
    """The duration of a flight, s; None for the task's own."""
    randomization: Randomization | None = None
    """Further randomization of episodes; None for none."""
    world: str | Hall = "ideal"
    """The ideal world or the hall; see `EnvConfig`."""
    decision_rate: int = 48
    """The number of setpoints, and of recorded samples, per second."""

    @property
    def seconds(self) -> float:
        """The duration of a flight, s."""
        return self.task.episode_s if self.horizon_s is None else self.horizon_s

    @property
    def decisions(self) -> int:
        """The number of setpoints of a whole flight."""
        return round(self.seconds * self.decision_rate)

    def core(self, num_envs: int, **loop: Any) -> SwarmCore:
        """Return environments for `num_envs` flights; `loop` are further fields of `EnvConfig`."""
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
    """E flights of a test with one controller, T samples each. World frame, SI."""

    team: Team
    """The N vehicles."""
    seeds: tuple[int, ...]
    """The seeds (E,) of the episodes."""
    time: FloatArray
    """The time (T,) since the start, s."""
    samples: IntArray
    """The number (E,) of samples until the flight ended; later ones repeat its last state."""
    position: FloatArray
    """The positions (E, T, N, 3), m."""
    velocity: FloatArray
    """The velocities (E, T, N, 3), m/s."""
    quaternion: FloatArray
    """The attitudes (E, T, N, 4), (x, y, z, w), body to world."""
    reference: FloatArray
    """The reference positions (E, T, N, 3), m."""
    force: FloatArray
    """The true forces (E, T, N, 3), N."""
    feedforward_force: FloatArray
    """The forces (E, T, N, 3) that the controller compensated in the same step, N."""
    worst_height_error: FloatArray
    """The largest vertical distance (E, N) to the reference since errors count, m."""
    worst_error: FloatArray
    """The largest distance (E, N) to the reference since errors count, m."""
    crashed: BoolArray
    """(E,) True if a collision or a tumble ended the flight, so that errors may be too small."""
    metrics: tuple[dict[str, Any], ...]
    """The metrics (E,) of `swarm_envs.envs.evaluation.metrics`."""

    def record(self, e: int) -> FlightRecord:
        """Return flight `e` for plots and videos."""
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
    """Return a test of stacked swaps of a team, the uppermost drone first."""
    task = SwapTask(parse_team(team), "stacked", layout)
    return FlightTest(task, truth, engine, horizon_s=layout.duration_s[1] + RECOVERY_S)


def default_engine() -> str:
    """Return `bullet` if pybullet can be imported, else `batch`, the compiled engine."""
    return "bullet" if bullet_available() else "batch"


def progress_bar(title: str, decisions: int, shown: bool = True) -> tqdm[NoReturn]:
    """Return a progress bar for `run_flights`, in seconds of flight at the default rate."""
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
    """Simulate one episode per seed. The same seeds give the same flights.

    Args:
        test: The flight test.
        controller: The controller of every drone.
        seeds: The seeds, at least one.
        tick: A function called with the number of decisions since the last call, summed over all
            flights.

    Raises:
        ValueError: No seed is given, or the test is invalid.
        ImportError: Bullet is required, but not installed.
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
    """Simulate `TrackingAgent` to the end; return fields of `Flights` with T samples."""
    arrays: dict[str, Any] = {
        name: np.zeros((core.num_envs, length, *value.shape[1:]))
        for name, value in _sample(core).items()
    }
    samples = np.zeros(core.num_envs, dtype=np.int64)
    yaw = np.zeros((core.num_envs, core.num_drones, 2))
    running, k = np.ones(core.num_envs, dtype=np.bool_), 0
    while running.any():
        for name, value in _sample(core).items():  # A flight that ends keeps its last state
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
    """Return the recorded quantities (E, N, width)."""
    state, drones = core.physics.state, core.world.drones
    return {
        "position": state.position,
        "velocity": state.velocity,
        "quaternion": state.quaternion,
        "reference": drones["reference_position"],
        "force": core.physics.force,
        "feedforward_force": drones["feedforward_force"],
    }


# ---- Functions of reports: statistics, models, versions, tables

_PACKAGES = ("numpy", "numba", "pybullet", "gymnasium", "pettingzoo")


def quartiles(values: npt.ArrayLike) -> dict[str, float]:
    """Return median and quartiles of numbers, by linear interpolation."""
    low, median, high = np.quantile(np.asarray(values), [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "lower_quartile": low, "upper_quartile": high}


def describe_spread(statistics: dict[str, float]) -> str:
    """Return the result of `quartiles` as `median (lower - upper)`."""
    median, low, high = (statistics[k] for k in ("median", "lower_quartile", "upper_quartile"))
    return f"{median:.1f} ({low:.1f} - {high:.1f})"


def describe_model(model: InteractionModel) -> dict[str, str]:
    """Return the name of a model and the hash of its weights file, without the file's folder."""
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
    """Return the versions of the packages that affect a flight."""
    found = {"swarm_envs": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def format_columns(rows: Sequence[tuple[str, ...]], rule: bool = True) -> list[str]:
    """Return the lines of a table, the first column aligned to the left, others to the right.

    Args:
        rows: The rows, the head first.
        rule: True to draw a line of hyphens below the head.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    ]
    return [*lines[:1], *["  ".join("-" * width for width in widths)] * rule, *lines[1:]]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
