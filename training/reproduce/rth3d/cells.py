"""A run: an instance drawn, planned by one method, validated and timed."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping, Sequence

from swarm_envs.baselines.rth3d import GridPlan, PlanNotFound, make_instance, plan
from swarm_envs.training.reproduce.rth3d.experiments import Figure, Setting
from swarm_envs.training.reproduce.runs import Cell

_SMALL = (
    Setting("uniform", (12, 6, 3)),
    Setting("quasi-random", (3, 6, 12)),
    Setting("buildings", (12, 6, 3)),
    Setting("rings", (12, 12, 6)),
    Setting("uniform", (24, 12, 6), 40),
)
"""Instances whose plans need every kernel, also those for where PIBT has stalled."""


def runs_at(setting: Setting, most: int, budget: int) -> int:
    """How many runs: all of them where the grid is small, fewer where it is large, at least one.

    Rings are one instance, whatever the seed, and are run once.

    Args:
        setting: what is run.
        most: runs at small sizes.
        budget: vertices of all runs together, from which on there are fewer.
    """
    if setting.family == "rings":
        return 1
    return max(1, min(most, budget // setting.vertices))


def run_name(setting: Setting, method: str, seed: int) -> str:
    """By which a run is kept."""
    return f"{setting.name}, {method}, seed {seed}"


def jobs(
    figure: Figure, methods: Sequence[str], seeds: Callable[[Setting], Sequence[int]]
) -> Mapping[str, Callable[[], Cell]]:
    """What computes each run of a figure, by its name, small settings first.

    Args:
        figure: what is remade.
        methods: of `plan`.
        seeds: of a setting's runs.
    """
    settings = sorted(
        {setting for curve in figure.series.values() for setting in curve},
        key=lambda setting: (setting.vertices, setting.name),
    )
    return {
        run_name(setting, method, seed): functools.partial(measure, setting, method, seed)
        for setting in settings
        for seed in seeds(setting)
        for method in methods
    }


@functools.cache
def warm_up() -> None:
    """Compile, or load, every kernel, so that no run is timed with that."""
    for setting in _SMALL:
        for method in ("rth3d", "rth3d-lba", "pibt", "auto"):
            _plan(setting, method, 0)


def _plan(setting: Setting, method: str, seed: int) -> tuple[GridPlan | None, float]:
    """The plan, None if there is none, and the CPU time that it took, s."""
    instance = make_instance(setting.family, setting.shape, setting.robots, seed)
    begin = time.process_time()
    try:
        found = plan(
            instance.starts,
            instance.goals,
            instance.shape,
            instance.obstacles,
            method=method,
            seed=seed,
        )
    except PlanNotFound:
        return None, time.process_time() - begin
    return found, time.process_time() - begin


def measure(setting: Setting, method: str, seed: int) -> Cell:
    """Run once, and return the numbers.

    Args:
        setting: from which the instance is drawn.
        method: of `plan`, whose plans are validated before it returns them.
        seed: of the instance and of PIBT.
    """
    warm_up()
    found, seconds = _plan(setting, method, seed)
    numbers: Cell = {"cpu_s": seconds, "solved": found is not None}
    if found is None:
        return numbers
    balancing = [phase.makespan for phase in found.phases if phase.name.startswith("balance ")]
    return numbers | {
        "robots": len(found.starts),
        "lower_bound": found.lower_bound,
        "makespan": found.makespan,
        "before_compaction": found.before_compaction,
        "bound": found.bound,
        "balancing_steps": sum(balancing),
        "winner": found.winner,
        "valid": found.valid,
    }
