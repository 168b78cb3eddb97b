"""Swaps and rings with the sizes, speeds and gains of the authors' repository.

`three_rings16_pps`, `validation_swap.py` and `crazyflieTypes.yaml` of aerorobotics/neural-swarm
(commit 48b1851): rings as `CLOSE_SIXTEEN`; swaps of 0.5 m in 4 s, a large drone 0.5 m above a small
one, a small one 0.2 m above a large one, else 0.3 m; gains in height 10, 5 and 10, to which the
preset `stiff` is nearest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from examples.papers.common import Row, markdown, within, write_compared
from examples.papers.neural_swarm2.paired_flights import RINGS, FlightCase, fly_case
from swarm_envs.agents.evaluation import bootstrap_interval, frozen_seeds
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.flights import FlightTest, swap_test
from swarm_envs.control.config import GAINS
from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.tasks.ring import RingTask, ring_team
from swarm_envs.tasks.swap import StackedLayout

RADII_M = (0.26, 0.28, 0.3, 0.32, 0.35)  # of the upright circles: a vertical distance on them
GAPS_M = {"S2S": 0.3, "L2S": 0.5, "S2L": 0.2, "L2L": 0.3}  # distance of the planes of a swap
WHY = {
    "ring of 16": "the worst of sixteen drones; the paper shows one of the ten on upright rings",
    "L2S": "every true force is a model's, which the fed-forward model knows better than the "
    "authors' knew the aerodynamics: its residual is the hall's",
}
COLUMNS = ("case", "gains", "gap_m", "without_cm", "with_cm", "ratio", "contacts", "least_m")


def as_flown(out: Path = Path("neural_swarm2"), episodes: int = 20, seed: int = 0) -> None:
    """Fly rings by vertical distance, and swaps, in the hall, as the authors' scripts do.

    Writes `as_flown.json` (`rows`: worst height errors without and with compensation, their ratio
    with a 95 % interval over flights, flights with a contact of `episodes` each way, and the least
    distance of two drones).

    Args:
        out: folder, made if missing.
        episodes: flights of each case by each controller.
        seed: seeds of the flights are drawn from it.
    """
    seeds = frozen_seeds(seed, episodes)
    cases = [ring(figure, radius, gains) for gains in ("stiff", "mid") for figure in RINGS
             for radius in RADII_M]  # fmt: skip
    cases += [swap(team, gap) for team, gap in GAPS_M.items()]
    bar = tqdm(cases, "as flown", unit="case")
    rows = [fly_row(case, gap, gains, seeds) for case, gap, gains in bar]
    numbers = {"episodes": episodes, "rows": rows}
    print(markdown(rows, COLUMNS))
    write_compared(out / "as_flown.json", numbers, compare(rows))


def ring(figure: int, radius_m: float, gains: str) -> tuple[FlightCase, float, str]:
    """Return the rings of a figure with another radius of the upright circles."""
    drones, layout = RINGS[figure]
    task = RingTask(ring_team(drones), rings=replace(layout, vertical_m=radius_m))
    test = FlightTest(task, "learned", world="hall")
    return FlightCase(f"ring of {drones}", test, None, gains=GAINS[gains]), radius_m, gains


def swap(team: str, gap_m: float) -> tuple[FlightCase, float, str]:
    """Return a swap as in `validation_swap.py`, in which the lowest drone's error counts."""
    layout = StackedLayout((0.25, 0.25), (gap_m, gap_m), duration_s=(4.0, 4.0))
    test = replace(swap_test(team, layout, load("learned")), world="hall")
    return FlightCase(team, test, -1, gains=GAINS["stiff"]), gap_m, "stiff"


def fly_row(case: FlightCase, gap_m: float, gains: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Fly a case both ways, and return its numbers."""
    flown = fly_case(case, load_belief("learned"), seeds)
    before, after = case.errors(flown)

    def ratio(flights: FloatArray, axis: int) -> FloatArray:
        drawn = flights.astype(np.int64)
        return np.asarray(np.median(after[drawn], axis) / np.median(before[drawn], axis))

    ratios = bootstrap_interval(np.arange(len(before), dtype=np.float64), ratio)
    return {
        "case": case.name,
        "gains": gains,
        "gap_m": gap_m,
        "without_cm": round(float(np.median(before)), 2),
        "with_cm": round(float(np.median(after)), 2),
        "ratio": round(float(np.median(after) / np.median(before)), 3),
        "ratio_95": [round(end, 4) for end in ratios],
        "better": int((after < before).sum()),
        "contacts": [int(each) for each in flown["crashed"].sum(axis=1)],
        "least_m": round(float(flown["separation_m"].min()), 3),
    }


def compare(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Compare rings and the swap L2S, as the authors set them, with Figs. 9, 1 and 8."""
    own = {(row["case"], row["gap_m"]): row for row in rows if row["gains"] == "stiff"}
    found = []
    for case, gap, before, after in (
        ("ring of 5", 0.3, 10.0, 5.0),
        ("ring of 16", 0.3, 15.0, 10.0),
        ("L2S", 0.5, 17.0, 7.0),
    ):
        row = own[case, gap]
        for side, paper in (("without", before), ("with", after)):
            found.append(Row(f"{case}: error {side}, cm", f"{paper:g}", row[f"{side}_cm"],
                             within(paper, 1.0 / 3.0), WHY.get(case, "")))  # fmt: skip
        ratio = after / before
        found.append(Row(f"{case}: error with over error without", f"{ratio:.2f}", row["ratio"],
                         within(ratio, 1.0 / 3.0), WHY.get(case, ""), spread=tuple(row["ratio_95"]),
                         spread_is="95 %"))  # fmt: skip
    free = [r for r in RADII_M if not any(sum(own[f"ring of {n}", r]["contacts"]) for n in (5, 16))]
    found.append(Row("least vertical distance at which both rings fly without a contact, m", "0.24",
                     min(free, default=np.nan), (0.24, 0.32)))  # fmt: skip
    return found
