"""Runs of the planners on growing grids: sample instances, plan, measure times and summarize."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import linregress
from tqdm import tqdm

from swarm_envs.baselines.rth3d import PlanNotFound, make_instance, plan

Method = Literal["rth3d", "rth3d-lba", "rth3d-lba-paper", "auto", "pibt"]
PUBLISHED = ("rth3d", "rth3d-lba-paper")
"""Methods with the matchings of the paper."""
GUARANTEED = (*PUBLISHED, "rth3d-lba")
"""Methods that always succeed, and whose plans are compacted."""
FIT_FROM = 5000
"""Vertices from which on a grid counts in a fit of run times: below, calls cost more than work."""

Points = list[dict[str, Any]]
"""One row for each series, grid and method, as in the CSV file of a figure."""


class Setting(NamedTuple):
    """Instances of one family on one grid: a point of a curve."""

    family: str  # name of a family of `make_instance`
    shape: tuple[int, int, int]  # number of vertices by axis
    robots: int | None = None
    """Number of robots; None for a third of the vertices, or 2/9 of them between buildings."""

    @property
    def vertices(self) -> int:
        """Number of vertices of the grid."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def grid(self) -> str:
        """Shape of the grid as text, such as `12x6x3`."""
        return "x".join(map(str, self.shape))


Series = Mapping[str, Sequence[Setting]]
"""Curves by name, each from its smallest to its largest grid."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of Figs. 5 to 9. The largest grids take minutes; `--largest` leaves them out."""

    out: Path = Path("runs/rth3d")
    """folder for numbers and pictures"""
    methods: tuple[Method, ...] = ("rth3d", "rth3d-lba", "rth3d-lba-paper", "auto")
    """methods of `swarm_envs.baselines.rth3d.plan`, each once"""
    runs: int = 20
    """runs of each method on each grid where grids are small"""
    budget: int = 250_000
    """vertices of all runs of a method on a grid together: on larger grids there are fewer runs"""
    largest: int = 500_000
    """vertices of the largest grid"""
    seed: int = 0
    """first of the seeds of the instances"""

    def __post_init__(self) -> None:
        """Refuse methods that are named twice."""
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise ValueError(f"--methods is {' '.join(self.methods)!r}; name each method once")

    def seeds(self, setting: Setting) -> range:
        """Return the seeds of a setting; rings are one instance, whatever the seed."""
        fewer = max(1, min(self.runs, self.budget // setting.vertices))
        return range(self.seed, self.seed + (1 if setting.family == "rings" else fewer))


def measure(options: Options, series: Series) -> tuple[list[dict[str, Any]], Points]:
    """Run every method on every grid, small grids first.

    Returns:
        All runs with their numbers, and a row for each point of the curves.

    Raises:
        ValueError: every grid is larger than `options.largest`.
    """
    wanted = [
        (name, setting, method, seed)
        for name, setting in _settings(options, series)
        for seed in options.seeds(setting)
        for method in options.methods
    ]
    runs: dict[tuple[str, Setting, str], list[dict[str, Any]]] = {}
    for name, setting, method, seed in tqdm(wanted, unit="run"):
        run = measure_run(setting, method, seed)
        runs.setdefault((name, setting, method), []).append(run)
    points = [
        gather_point(*key, runs[key])
        for key in (
            (n, s, m) for n, curve in series.items() for m in options.methods for s in curve
        )
        if key in runs
    ]
    listed = [
        {"series": name, "grid": setting.grid, "method": method, **run}
        for (name, setting, method), own in runs.items()
        for run in own
    ]
    return listed, points


def _settings(options: Options, series: Series) -> list[tuple[str, Setting]]:
    """Names of series with their settings, without grids larger than wanted, small ones first."""
    settings = [(name, setting) for name, curve in series.items() for setting in curve]
    settings.sort(key=lambda entry: entry[1].vertices)
    kept = [entry for entry in settings if entry[1].vertices <= options.largest]
    if not kept:
        raise ValueError(
            f"--largest is {options.largest} vertices, below every grid of the figure; the "
            f"smallest has {settings[0][1].vertices}"
        )
    return kept


@functools.cache
def compile_kernels() -> None:
    """Compile every kernel, so that no run is timed with that."""
    small = make_instance("uniform", (6, 6, 3), 12)
    for method in (*GUARANTEED, "auto"):
        plan(small.starts, small.goals, small.shape, method=method, time_limit=60.0)


def measure_run(setting: Setting, method: str, seed: int) -> dict[str, Any]:
    """Plan an instance once.

    Args:
        setting: from which the instance is drawn.
        method: of `plan`, which validates a plan before it returns it.
        seed: of the instance and of PIBT.

    Returns:
        CPU time in seconds, planning and validation, and the numbers of the plan if one was found.
    """
    compile_kernels()
    case = make_instance(setting.family, setting.shape, setting.robots, seed)
    run = {"seed": seed, "robots": len(case.starts)}
    begin = time.process_time()
    try:
        found = plan(case.starts, case.goals, case.shape, case.obstacles, method=method, seed=seed)
    except PlanNotFound:
        return {**run, "cpu_s": time.process_time() - begin, "solved": False}
    cpu_s = time.process_time() - begin
    balancing = [phase.makespan for phase in found.phases if phase.name.startswith("balance ")]
    return {
        **run,
        "cpu_s": cpu_s,
        "solved": True,
        "lower_bound": found.lower_bound,
        "makespan": found.makespan,
        "before_compaction": found.before_compaction,
        "bound": found.bound,
        "balancing_steps": sum(balancing),
        "winner": found.winner,
        "valid": found.valid,
    }


def gather_point(
    name: str, setting: Setting, method: str, runs: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Put the runs of a method on a setting together.

    Ratios are makespan over lower bound, of solved runs; times are of all runs. Only guaranteed
    methods have a ratio before compaction. `most_over_m1_2m2_2m3` is the largest excess of the
    makespan before compaction over m1 + 2 m2 + 2 m3, m1 the longest side (Sec. IV).
    """
    solved = [run for run in runs if run["solved"]]
    before = [run for run in solved if method in GUARANTEED]
    length = 2 * sum(setting.shape) - max(setting.shape)
    winners = [str(run["winner"]) for run in solved]
    return {
        "series": name,
        "grid": setting.grid,
        "vertices": setting.vertices,
        "robots": runs[0]["robots"],
        "method": method,
        "runs": len(runs),
        "solved": len(solved),
        **_spread("cpu_s", [run["cpu_s"] for run in runs]),
        **_spread("ratio", [run["makespan"] / run["lower_bound"] for run in solved]),
        **_spread(
            "ratio_before_compaction",
            [run["before_compaction"] / run["lower_bound"] for run in before],
        ),
        "most_over_m1_2m2_2m3": max(
            (run["before_compaction"] - length for run in before), default=None
        ),
        "plans_by": "; ".join(f"{who} {winners.count(who)}" for who in sorted(set(winners))),
    }


def _spread(name: str, values: Sequence[float]) -> dict[str, float | None]:
    """Mean, least and largest with four significant digits; None where there is no value."""
    names = (name, f"{name}_least", f"{name}_most")
    if not values:
        return dict.fromkeys(names)
    spread = (float(np.mean(values)), min(values), max(values))
    return dict(zip(names, (float(f"{value:.4g}") for value in spread), strict=True))


def curve(points: Points, series: str, method: str) -> Points:
    """Return the points of one curve, from the smallest to the largest grid."""
    return [p for p in points if (p["series"], p["method"]) == (series, method)]


def growth(points: Points) -> dict[str, float] | None:
    """Fit the exponent with which the mean time grows with the vertices.

    A straight line is fitted to logarithms. Between settings of one density robots grow as
    vertices do: the exponent is that of robots too. None if fewer than three grids are large
    enough (`FIT_FROM`).
    """
    large = [point for point in points if point["vertices"] >= FIT_FROM]
    sizes = [point["vertices"] for point in large]
    if len(set(sizes)) < 3:
        return None
    line = linregress(np.log(sizes), np.log([point["cpu_s"] for point in large]))
    return {"exponent": float(line.slope), "error": float(line.stderr), "settings": len(sizes)}
