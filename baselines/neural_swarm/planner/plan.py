"""The plan of a team: its motions, the record of its planning, its check, and its files."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.problem import Plane, PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.scp import StepRecord
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.baselines.neural_swarm.planner.verify import PlanCheck
from swarm_envs.errors import check_array, check_name, check_number, unknown_name
from swarm_envs.files import read_npz, written_whole
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team, Vehicle

__all__ = ["SwarmPlan"]

STATUSES = ("converged", "time limit", "iteration limit", "not feasible")
"""The outcomes of planning; only with the first does the plan meet all requirements."""


@dataclass(frozen=True, eq=False)
class SwarmPlan:
    """The motions of N robots over T steps, and the record of their planning.

    World frame, SI units. Get a plan from `plan_swarm`, or from a file with `SwarmPlan.load`.
    """

    team: Team
    """The N vehicles."""
    starts: FloatArray
    """The start positions (N, 3), m."""
    goals: FloatArray
    """The goal positions (N, 3), m."""
    trajectories: Trajectories
    """The motions: states, controls and predicted forces."""
    initial: Trajectories
    """The initial motions of stage 2: those of stage 1, or the given guess."""
    bounds: PlanningBounds
    """The bounds of the plan."""
    plane: Plane
    """The plane or space in which robots move."""
    model_name: str
    """The name of the planner's force model; `none` if it assumed no forces."""
    model_fingerprint: str
    """The SHA-256 of that model's numbers."""
    seed: int
    """The random seed."""
    status: str
    """The outcome, one of `STATUSES`."""
    reason: str
    """The reason for the outcome."""
    check: PlanCheck
    """The result of simulating the controls with the nonlinear model."""
    search: Mapping[str, Any]
    """The statistics of stage 1; without a search, the attempt alone."""
    history: tuple[StepRecord, ...]
    """Every program of stage 2, in order."""
    seconds: Mapping[str, float]
    """The duration of each stage, s."""

    @property
    def converged(self) -> bool:
        """True if stage 2 has converged and the plan reaches its goals within bounds."""
        return self.status == STATUSES[0]

    @property
    def costs(self) -> dict[str, float]:
        """The cost of each stage's motions, (6), the integral of ||u|| over all robots, m/s."""
        return {"stage 1": self.initial.cost, "stage 2": self.trajectories.cost}

    def reference(self, time: float) -> Reference:
        """Return the reference of all robots at a time, s; at rest before and after the plan.

        Between knots, a polynomial of fifth order has the position, the velocity and the mean of
        the two accelerations at both ends, so that the acceleration is continuous.
        """
        duration = self.trajectories.duration
        at = min(max(time, 0.0), duration)
        moving = float(0.0 <= time < duration)
        position, *slopes = (curve(at) for curve in self._curves)
        return Reference(np.asarray(position), *(np.asarray(moving * slope) for slope in slopes))

    @cached_property
    def _curves(self) -> tuple[Any, ...]:
        from scipy.interpolate import BPoly

        states = self.trajectories.states.copy()
        states[[0, -1], :, 3:] = 0.0  # The solver leaves velocities below its tolerance
        held = np.diff(states[..., 3:], axis=0) / self.trajectories.dt
        acceleration = np.zeros_like(states[..., 3:])
        acceleration[1:-1] = 0.5 * (held[1:] + held[:-1])
        rows = np.stack([states[..., :3], states[..., 3:], acceleration], axis=1)
        curve = BPoly.from_derivatives(self.trajectories.times, rows)
        return curve, *(curve.derivative(order) for order in (1, 2, 3))

    def save(self, path: str | Path) -> None:
        """Write the plan to an `.npz` file, atomically.

        Raises:
            ValueError: The suffix is another.
            OSError: The file cannot be written.
        """
        file = _checked(path)
        arrays, about = {"starts": self.starts, "goals": self.goals}, _about(self)
        for owner, part in itertools.product(_MOTIONS, _PARTS):
            arrays[f"{owner}_{part}"] = getattr(getattr(self, owner), part)
        written: dict[str, Any] = {**arrays, "about": np.array(json.dumps(about, allow_nan=False))}
        with written_whole(file) as partial:
            np.savez_compressed(partial, **written)

    @classmethod
    def load(cls, path: str | Path) -> SwarmPlan:
        """Return the plan of a file written by `save`.

        Raises:
            ValueError: The suffix is another, or the file is damaged.
            OSError: The file cannot be read.
        """
        file = _checked(path)
        try:
            raw: dict[str, Any] = read_npz(file)
            return _assemble(json.loads(str(raw.pop("about"))), raw)
        except _DAMAGE as error:
            what = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
            raise ValueError(f"{str(file)!r} is no plan, or damaged: {what}") from error


# ---- Files of plans

_VERSION = 1  # The version of the format
_PARTS = ("states", "controls", "forces")
_MOTIONS = ("trajectories", "initial")
_DAMAGE = (ValueError, TypeError, KeyError, AttributeError)


def _checked(path: str | Path) -> Path:
    file = Path(path)
    if file.suffix.lower() != ".npz":
        raise ValueError(unknown_name("suffix", file.suffix, (".npz",), f"of {str(file)!r}"))
    return file


def _about(plan: SwarmPlan) -> dict[str, Any]:
    """Return all but the arrays for JSON; infinite numbers, of teams of one, become null."""
    bounds = dataclasses.asdict(dataclasses.replace(plan.bounds, force_g={}))
    about = {
        "version": _VERSION,
        "team": [dataclasses.asdict(vehicle) for vehicle in plan.team],
        "bounds": bounds | {"force_g": dict(plan.bounds.force_g)},
        "dt": plan.trajectories.dt,
        "plane": plan.plane,
        "model_name": plan.model_name,
        "model_fingerprint": plan.model_fingerprint,
        "seed": plan.seed,
        "status": plan.status,
        "reason": plan.reason,
        "check": dataclasses.asdict(plan.check),
        "search": dict(plan.search),
        "history": [dataclasses.asdict(record) for record in plan.history],
        "seconds": dict(plan.seconds),
    }
    ready: dict[str, Any] = json.loads(json.dumps(_finite(about)))
    return ready


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _assemble(about: dict[str, Any], raw: dict[str, Any]) -> SwarmPlan:
    if about["version"] != _VERSION:
        raise ValueError(f"it is of version {about['version']!r}, but must be of {_VERSION}")
    team = tuple(Vehicle(**_with_tuples(entry)) for entry in about["team"])
    count = len(team)
    shapes: dict[str, tuple[int, ...]] = {"starts": (count, 3), "goals": (count, 3)}
    for owner in _MOTIONS:
        steps = len(raw[f"{owner}_controls"])
        widths = ((steps + 1, count, 6), (steps, count, 3), (steps + 1, count, 3))
        shapes |= {f"{owner}_{part}": shape for part, shape in zip(_PARTS, widths)}
    arrays = {name: check_array(name, raw[name], shape) for name, shape in shapes.items()}
    check_number("dt", about["dt"], above=0.0, unit="s")
    motions: dict[str, Any] = {
        owner: Trajectories(**{p: arrays[f"{owner}_{p}"] for p in _PARTS}, dt=float(about["dt"]))
        for owner in _MOTIONS
    }
    kept = ("plane", "model_name", "model_fingerprint", "seed", "reason", "search", "seconds")
    check: dict[str, Any] = {k: math.inf if v is None else v for k, v in about["check"].items()}
    return SwarmPlan(
        team=team,
        starts=arrays["starts"],
        goals=arrays["goals"],
        bounds=PlanningBounds(**_with_tuples(about["bounds"])),
        status=check_name("status", about["status"], STATUSES),
        check=PlanCheck(**check),
        history=tuple(StepRecord(**record) for record in about["history"]),
        **motions,
        **{name: about[name] for name in kept},
    )


def _with_tuples(entry: dict[str, Any]) -> dict[str, Any]:
    """Return the entry with lists, which JSON has made of tuples, as tuples."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
