"""Figures 8, 9 and 1 as a whole: fly what is not yet flown, compare, draw, write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    default_engine,
    describe_model,
    progress_bar,
    versions,
)
from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import write_json
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.reproduce.flight_cases import SWAPS, Case, ring_case, swap_case
from swarm_envs.training.reproduce.flight_claims import ring_claims, swap_claims
from swarm_envs.training.reproduce.flight_report import case_row, write_csv
from swarm_envs.training.reproduce.flown import SIDES, Flown, fly_or_read
from swarm_envs.training.reproduce.ring_plot import plot_rings
from swarm_envs.training.reproduce.swap_plot import plot_swaps

TRUTHS = ("learned", "wake")
"""The forces that are flown in if none is named: those for which a belief ships."""
MOST_EPISODES = 1000
"""More episodes than this are refused."""


@dataclass(frozen=True, kw_only=True)
class FlightPlan:
    """What is flown for a figure. Raises ValueError for what cannot be."""

    figure: Literal[8, 9, 1]
    """The paper's figure that is flown."""
    truths: tuple[str, ...] = TRUTHS
    """Forces that blow, each with flights of its own: names or paths of weights."""
    belief: Path | None = None
    """What the compensating controller believes; None for what ships for each truth."""
    episodes: int = 20
    """Flights of each case by each controller."""
    seed: int = 0
    """Seeds of the flights are drawn from it; fewer flights are the first of more."""
    engine: str | None = None
    """`bullet`, `batch`, or None for Bullet where it can be imported."""
    cases: tuple[str, ...] = SWAPS
    """Teams of Fig. 8."""
    layout: StackedLayout = PAPER_SWAP
    """Swaps of Fig. 8."""

    def __post_init__(self) -> None:
        """Check every number."""
        check_integer("seed", self.seed, 0)
        check_integer("episodes", self.episodes, 1)
        if self.episodes > MOST_EPISODES:
            raise ValueError(f"episodes is {self.episodes}, but must be at most {MOST_EPISODES}")
        for case in self.cases:
            check_name("case", case, SWAPS)
        if not self.cases or len(set(self.cases)) < len(self.cases):
            raise ValueError(f"cases are {self.cases}, but must be at least one, each named once")
        if self.belief is not None and len(self.truths) > 1:
            raise ValueError(
                "a belief is learned in one environment: name its force model by --truth too"
            )

    def all_cases(self, truth: InteractionModel, engine: str) -> list[Case]:
        """The cases of the figure in one air."""
        if self.figure != 8:
            return [ring_case(self.figure, truth, engine)]
        return [swap_case(name, self.layout, truth, engine) for name in self.cases]


def reproduce_flights(out: Path, plan: FlightPlan, progress: bool = True) -> dict[str, Any]:
    """Fly a figure, and write `figure_N.json`, `figure_N.csv` and `figure_N.png` into a folder.

    Every finished case is a file below `figure_N`; killed and called again, the command goes on
    with the first that is not there.

    Args:
        out: the folder, made if missing.
        plan: what is flown.
        progress: show a progress bar.

    Returns:
        What the JSON file holds.

    Raises:
        FileNotFoundError: there is no such weights file.
        ValueError: no belief ships for a truth and none is given, or a file is of other settings.
    """
    engine, name = plan.engine or default_engine(), f"figure_{plan.figure}"
    seeds = [int(s) for s in np.random.SeedSequence(plan.seed).generate_state(plan.episodes)]
    airs = [(load(truth), _belief(plan, truth)) for truth in plan.truths]
    cases = [plan.all_cases(truth, engine) for truth, _ in airs]
    decisions = sum(case.test.decisions for own in cases for case in own)
    flown: list[list[Flown]] = []
    total = decisions * len(SIDES) * plan.episodes
    with progress_bar(f"Fig. {plan.figure}", total, progress) as bar:
        for (truth, belief), own in zip(airs, cases, strict=True):
            flown.append([])
            for case in own:
                bar.set_postfix_str(f"{case.name}, {Path(truth.name).stem}")
                file = f"{case.name.replace('*', 'x').replace(' ', '_')}.npz"
                path = out / name / Path(truth.name).stem / file
                flown[-1].append(fly_or_read(path, case, belief, seeds, bar.update))
    report = _report(plan, engine, seeds, airs, cases, flown)
    draw = plot_swaps if plan.figure == 8 else plot_rings
    draw(out / f"{name}.png", report, cases, flown)
    write_csv(out / f"{name}.csv", report)
    write_json(out / f"{name}.json", report)
    return report


def _belief(plan: FlightPlan, truth: str) -> InteractionModel:
    return load_belief(truth) if plan.belief is None else load(plan.belief)


def _report(
    plan: FlightPlan,
    engine: str,
    seeds: list[int],
    airs: list[tuple[InteractionModel, InteractionModel]],
    cases: list[list[Case]],
    flown: list[list[Flown]],
) -> dict[str, Any]:
    truths = []
    for (truth, belief), own, found in zip(airs, cases, flown, strict=True):
        rows = [case_row(case, one) for case, one in zip(own, found, strict=True)]
        claims = swap_claims(rows) if plan.figure == 8 else ring_claims(rows)
        truths.append(
            {
                "truth": describe_model(truth),
                "belief": describe_model(belief),
                "claims": [claim._asdict() for claim in claims],
                "cases": rows,
            }
        )
    return {
        "figure": plan.figure,
        "what": "worst height error against the reference, cm; p of Wilcoxon's signed-rank test, "
        "two-sided, pairs of flights with the same seed",
        "engine": engine,
        "seed": plan.seed,
        "episodes": plan.episodes,
        "seeds": seeds,
        "layout": repr(plan.layout if plan.figure == 8 else cases[0][0].test.task.layout),  # type: ignore[attr-defined]
        "versions": versions(),
        "truths": truths,
        "notes": _notes(plan, engine, airs, flown),
    }


def _notes(
    plan: FlightPlan,
    engine: str,
    airs: list[tuple[InteractionModel, InteractionModel]],
    flown: list[list[Flown]],
) -> list[str]:
    """What is otherwise than one would think."""
    notes = []
    if engine == "batch" and plan.engine is None:
        notes.append("pybullet cannot be imported here, so the compiled twin of Bullet flew")
    for truth, belief in airs:
        if truth.fingerprint == belief.fingerprint:
            notes.append(f"the controller believes the very force that blows, {truth.name!r}")
    crashed = sum(int(one.crashed.sum()) for own in flown for one in own)
    if crashed:
        notes.append(f"{crashed} flights ended before the clock: their error is not their worst")
    return notes
