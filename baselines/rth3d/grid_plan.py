"""Grid plans: paths, the phases of planning, files, and plots."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance
from swarm_envs.baselines.rth3d.grid_validation import (
    MOVES,
    ValidationReport,
    as_vertices,
    check_paths,
    validate,
)
from swarm_envs.errors import unknown_name
from swarm_envs.files import read_npz, written_whole

__all__ = ["plot_grid_plan"]

VERSION = 1  # The version of the file format
_KEPT = ("method", "winner", "seed", "bound", "before_compaction")
_MOMENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
_MOST_DOTS = 6000


@dataclass(frozen=True)
class PhaseRecord:
    """A phase of planning."""

    name: str
    makespan: int
    """The steps of its part of the plan before compaction; for "compaction" and "pibt", those of
    the whole plan afterwards."""
    seconds: float  # Wall time of the phase


class PlanTimeout(TimeoutError):
    """The time limit ended before there was any valid plan."""


@dataclass
class PlanningClock:
    """The record of the phases of planning, and its limits."""

    deadline: float = float("inf")  # By `time.monotonic`
    watch: Callable[[str], None] | None = None  # Called with the name of each phase when it begins
    configurations: int | None = None
    """The most configurations of the complete search; None for its default."""
    phases: list[PhaseRecord] = field(default_factory=list)  # The phases so far

    @contextmanager
    def phase(self, name: str) -> Iterator[Callable[[int], None]]:
        """Time a phase of planning; the yielded function records the phase's makespan.

        Raises:
            PlanTimeout: The time limit ended before the phase began.
        """
        self.check(name)
        with self.last_phase(name) as record:
            yield record

    @contextmanager
    def last_phase(self, name: str) -> Iterator[Callable[[int], None]]:
        """Time a phase that runs even after the time limit, as there is already a plan."""
        if self.watch is not None:
            self.watch(name)
        makespan = 0

        def record(steps: int) -> None:
            nonlocal makespan
            makespan = steps

        begin = time.perf_counter()
        yield record
        self.phases.append(PhaseRecord(name, makespan, time.perf_counter() - begin))

    @property
    def limited(self) -> bool:
        """True if the caller has limited the time or the configurations."""
        return self.configurations is not None or self.deadline < float("inf")

    def halved(self) -> PlanningClock:
        """Return a clock for a part of planning that may take half of the remaining time."""
        now = time.monotonic()
        return dataclasses.replace(self, deadline=(now + max(self.deadline, now)) / 2)

    @property
    def remaining(self) -> float:
        """The remaining time, s."""
        return self.deadline - time.monotonic()

    def check(self, what: str) -> None:
        """Raise PlanTimeout if the time limit has ended."""
        if self.remaining <= 0:
            raise PlanTimeout(
                f"the time limit ended at {what!r}, and there is no valid plan yet; allow more "
                "time, or use method='pibt', which is faster but has no guarantee"
            )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GridPlan(GridInstance):
    """The paths of all robots, and the record of their planning."""

    def __repr__(self) -> str:
        sides = " x ".join(map(str, self.shape))
        found = f"makespan {self.makespan}, lower bound {self.lower_bound}, by {self.winner}"
        return f"GridPlan({len(self.starts)} robots on {sides}, {found})"

    moves: npt.NDArray[np.int8]
    """The move (T, n) of each robot in each step: 0 and 1 down and up x, 2 and 3 y, 4 and 5 z, 6 a
    wait; T is the makespan."""
    method: str
    """The name of the requested method."""
    winner: str
    """The name of the method that found the paths: with `auto`, "pibt", "rth3d-lba", "lacam", "pibt
    halfway" or "negotiation"."""
    seed: int
    """The seed of the planner."""
    bound: int | None
    """The guaranteed bound of the makespan, given the steps of balancing; None for PIBT and LaCAM*,
    which have none."""
    before_compaction: int | None
    """The makespan of RTH3D's phases one after another; None if other methods contributed."""
    phases: tuple[PhaseRecord, ...]
    """The phases of planning."""
    valid: bool
    """True if `validate` has found the paths feasible; `plan` returns no others."""

    @cached_property
    def paths(self) -> npt.NDArray[np.int16]:
        """The vertices (T + 1, n, 3): `paths[t, i]` is the vertex of robot i after t steps.

        They use six times the memory of `moves`.
        """
        found = np.empty((len(self.moves) + 1, *self.starts.shape), dtype=np.int16)
        found[0] = self.starts
        for t, move in enumerate(self.moves):
            np.add(found[t], MOVES[move], out=found[t + 1])
        return found

    @property
    def makespan(self) -> int:
        """The number of steps until the last robot is at its goal."""
        return len(self.moves)

    @property
    def ratio(self) -> float:
        """The makespan over the lower bound, at least 1; 1 if no robot has to move.

        A plan of ratio 1 has the shortest makespan. Other plans may have it, too.
        """
        return self.makespan / self.lower_bound if self.lower_bound else 1.0

    @property
    def seconds(self) -> float:
        """The wall time of all phases, s."""
        return sum(phase.seconds for phase in self.phases)

    def check(self) -> ValidationReport:
        """Validate the paths again, and return the report."""
        return validate(self.paths, **self.fields())

    def save(self, path: str | Path) -> None:
        """Write the plan to an .npz file, atomically.

        Raises:
            ValueError: The suffix is another.
            OSError: The file cannot be written.
        """
        about: dict[str, Any] = {name: getattr(self, name) for name in _KEPT}
        about["phases"] = [dataclasses.asdict(phase) for phase in self.phases]
        about |= {"version": VERSION, "shape": list(self.shape)}
        with written_whole(_checked_path(path)) as partial:
            np.savez_compressed(
                partial,
                steps=MOVES[self.moves],
                starts=self.starts,
                goals=self.goals,
                obstacles=self.obstacles,
                about=np.array(json.dumps(about)),
            )

    @classmethod
    def load(cls, path: str | Path) -> GridPlan:
        """Return the plan of a file; its paths are validated again.

        Raises:
            ValueError: The file is no plan, is damaged, or its paths are not feasible.
            OSError: The file cannot be read.
        """
        path = _checked_path(path)
        try:
            arrays = read_npz(path)
            return _from_arrays(json.loads(str(arrays.pop("about"))), arrays)
        except (ValueError, TypeError, KeyError) as error:
            what = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
            raise ValueError(f"{str(path)!r} is no plan, or damaged: {what}") from error


def _checked_path(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise ValueError(unknown_name("suffix", path.suffix, (".npz",), f"of {str(path)!r}"))
    return path


def _from_arrays(about: dict[str, Any], arrays: dict[str, Any]) -> GridPlan:
    if about["version"] != VERSION:
        raise ValueError(f"it is of version {about['version']!r}, but must be of {VERSION}")
    given = (arrays["starts"], arrays["goals"], about["shape"], arrays["obstacles"])
    instance = check_instance(*given)
    steps = arrays["steps"]
    if steps.dtype != np.int8 or steps.shape[1:] != instance.starts.shape:
        raise ValueError(f"its steps are {steps.dtype} of shape {steps.shape}")
    paths = np.empty((len(steps) + 1, *instance.starts.shape), dtype=np.int16)
    paths[0] = instance.starts
    for t, step in enumerate(steps):
        np.add(paths[t], step, out=paths[t + 1])
    report, moves = check_paths(as_vertices(paths, instance.shape), instance)
    if not report:
        raise ValueError(f"its paths are not feasible: {report.reason}")
    for name in ("bound", "before_compaction"):
        _check_steps(name, about[name], report.makespan)
    return GridPlan(
        moves=moves,
        phases=tuple(PhaseRecord(**phase) for phase in about["phases"]),
        valid=bool(report),
        **instance.fields(),
        **{name: about[name] for name in _KEPT},
    )


def _check_steps(name: str, steps: Any, makespan: int) -> None:
    """Raise ValueError if steps are neither None nor an integer of at least the makespan."""
    if steps is not None and not (isinstance(steps, int) and makespan <= steps):
        raise ValueError(f"its {name} is {steps!r}, but must be None or at least {makespan}")


def plot_grid_plan(path: Path, plan: GridPlan) -> None:
    """Plot a plan to a .png file: five top views in time, and the distances to the goals.

    A robot's color is the x coordinate of its goal: at the end the colors are sorted.

    Raises:
        OSError: The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(_MOMENTS), height_ratios=(1, 1.3))
    shown = np.linspace(0, len(plan.starts) - 1, min(_MOST_DOTS, len(plan.starts))).astype(int)
    for column, moment in enumerate(_MOMENTS):
        t = round(moment * plan.makespan)
        axes = figure.add_subplot(grid[0, column])
        x, y, _ = plan.paths[t, shown].T
        axes.scatter(x, y, c=plan.goals[shown, 0], s=2, cmap="viridis", linewidths=0)
        axes.set(title=f"step {t}", aspect="equal", xticks=[], yticks=[])
    _draw_distances(figure.add_subplot(grid[1, :]), plan)
    sides = " x ".join(map(str, plan.shape))
    figure.suptitle(
        f"{len(plan.starts):,} robots on {sides}, {plan.winner}: makespan {plan.makespan}, "
        f"lower bound {plan.lower_bound}, ratio {plan.ratio:.3f}"
    )
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=110)


def _draw_distances(axes: Any, plan: GridPlan) -> None:
    left = np.array([np.abs(now - plan.goals).sum(axis=1) for now in plan.paths])
    steps = np.arange(len(left))
    ideal = np.maximum(plan.lower_bound - steps, 0)
    axes.plot(steps, left.max(axis=1), color="tab:red", label="farthest robot")
    axes.plot(steps, left.mean(axis=1), color="tab:blue", label="mean")
    axes.plot(steps, ideal, color="0.6", linestyle=":", label="lower bound")
    axes.set(
        xlabel="step", ylabel="Manhattan distance to the goal", xlim=(0, max(len(left) - 1, 1))
    )
    axes.legend(frameon=False)
