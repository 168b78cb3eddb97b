"""The effect of each part of the hall on tracking errors, for two motions of the paper.

A small drone passes below a large one (L2S, Sec. VII-E), and five drones fly the rings of Fig. 9,
without and with a fitted force model, and with adaptive control (docs/adaptation.md): in the ideal
world, with each part of `swarm_envs.hall.Hall` alone, in the whole hall, and in one with a thrust
error of 5 %. The rings are simulated without any force between drones as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from examples.papers.common import markdown, write_json
from examples.papers.neural_swarm2.bars import draw_bars
from swarm_envs.agents.evaluation import bootstrap_interval, frozen_seeds
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    FlightTest,
    default_engine,
    run_flights,
    swap_test,
)
from swarm_envs.control.config import ControllerConfig, Indi
from swarm_envs.hall import Hall
from swarm_envs.interactions import load
from swarm_envs.tasks.ring import RingTask, ring_team
from swarm_envs.viewing.style import picture

TEAM, RING = "L2S", "ring of 5"
"""The two motions; the error is that of the small drone, and of the worst of each flight."""
WHOLE = Hall()
PARTS = {
    "random force": ("residual_quiet", "residual_wake", "residual_alone"),
    "offset of the force": ("offset",),
    "thrust curve": ("thrust_error",),
    "state estimate": (
        *("frame_delay_s", "frame_loss", "position_noise_m", "attitude_noise_rad"),
        *("accelerometer_noise", "gyro_noise"),
    ),
}
"""Parameters of each part of the hall; where all are zero, it is the ideal world."""
COLORS = ("#D55E00", "#0072B2", "#E69F00", "#56B4E9")


class Controller(NamedTuple):
    """The parts of a controller besides the tracking law."""

    believes: bool  # the force model that ships for the environment's forces
    adapts: bool  # incremental nonlinear dynamic inversion (INDI)
    exact: bool = False  # the environment's own force model

    @property
    def name(self) -> str:
        """Such as `belief + INDI`, or `neither`."""
        has = {"belief": self.believes, "INDI": self.adapts, "exact force": self.exact}
        return " + ".join(word for word, there in has.items() if there) or "neither"

    def config(self, truth: str) -> ControllerConfig:
        """Return the configuration of the tracking loop in an environment with these forces."""
        belief = load_belief(truth) if self.believes else load(truth) if self.exact else None
        return ControllerConfig(feedforward=belief, adaptation=Indi() if self.adapts else None)


SWAP_CONTROLLERS = tuple(
    Controller(believes, adapts) for adapts in (False, True) for believes in (False, True)
)
RING_CONTROLLERS = (*SWAP_CONTROLLERS, Controller(False, False, exact=True))


class HallCase(NamedTuple):
    """One cell of the tables."""

    motion: str  # `TEAM` or `RING`
    truth: str  # force model of the environment
    world: str  # key of `hall_worlds`
    controller: Controller


def hall(
    out: Path = Path("neural_swarm2"),
    truth: str | None = None,
    episodes: int = 40,
    engine: str = default_engine(),
    seed: int = 0,
) -> None:
    """Fly a swap and the rings of 5 in each part of the hall (docs/hall.md).

    Writes `hall.json` (`rows`: median error with its 95 % interval by motion, force, world and
    controller) and `hall.png`.

    Args:
        out: folder, made if missing.
        truth: force model of the environment, `learned` or `wake`; both if not given.
        episodes: flights of each case.
        engine: of the flights, `bullet` or `batch`.
        seed: seeds of the flights are drawn from it.
    """
    seeds = frozen_seeds(seed, episodes)
    truths = ("learned", "wake") if truth is None else (truth,)
    rows = [measure(case, seeds, engine) for case in tqdm(list(all_cases(truths)), "hall")]
    summary = {
        "motions": [TEAM, RING],
        "seed": seed,
        "episodes": episodes,
        "engine": engine,
        "hall": repr(WHOLE),
        "rows": rows,
    }
    write_json(out / "hall.json", summary)
    plot_hall(out / "hall.png", rows)
    print(f"Worst height error, median of {episodes} flights and its 95 % interval")
    print(markdown(rows, list(rows[0])))


def hall_worlds() -> dict[str, str | Hall]:
    """Return the worlds by name."""
    alone = {part: _without(*(other for other in PARTS if other != part)) for part in PARTS}
    wrong = replace(WHOLE, thrust_error=0.05)
    return {"ideal": "ideal", **alone, "hall": "hall", "hall, thrust wrong by 5 %": wrong}


def _without(*parts: str) -> Hall:
    names = [name for part in parts for name in PARTS[part]]
    zero: Any = {
        name: 0.0 if isinstance(getattr(WHOLE, name), float) else (0.0, 0.0) for name in names
    }
    return replace(WHOLE, **zero)


def all_cases(truths: Sequence[str]) -> Iterator[HallCase]:
    """Yield every case; without forces no controller predicts any."""
    rings = (*truths, "none")
    for motion, truth in [*((TEAM, t) for t in truths), *((RING, t) for t in rings)]:
        for world in hall_worlds():
            for controller in SWAP_CONTROLLERS if motion == TEAM else RING_CONTROLLERS:
                if truth != "none" or not (controller.believes or controller.exact):
                    yield HallCase(motion, truth, world, controller)


def measure(case: HallCase, seeds: Sequence[int], engine: str) -> dict[str, Any]:
    """Fly a case; return the median of the worst height errors with its interval, cm."""
    test = swap_test(TEAM, truth=case.truth, engine=engine)
    if case.motion == RING:
        test = FlightTest(RingTask(ring_team(5)), case.truth, engine)
    world = hall_worlds()[case.world]
    flights = run_flights(replace(test, world=world), case.controller.config(case.truth), seeds)
    each = flights.worst_height_error
    worst = np.round(100.0 * (each.max(axis=1) if case.motion == RING else each[:, -1]), 4)
    low, high = bootstrap_interval(worst, np.median)
    return {
        "motion": case.motion,
        "truth": case.truth,
        "world": case.world,
        "controller": case.controller.name,
        "median_cm": round(float(np.median(worst)), 3),
        "low_cm": round(low, 3),
        "high_cm": round(high, 3),
        "crashed": int(flights.crashed.sum()),
    }


def plot_hall(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw medians of the swap by world, a panel for each force model."""
    rows = [row for row in rows if row["motion"] == TEAM]
    truths = list(dict.fromkeys(row["truth"] for row in rows))
    headline = "A small drone passes under a large one: what each part of the hall costs"
    with picture(path, 11.0, 4.4 * len(truths), headline) as figure:
        panels = figure.subplots(len(truths), 1, squeeze=False)[:, 0]
        for axis, truth in zip(panels, truths, strict=True):
            own = [row for row in rows if row["truth"] == truth]
            series = {
                c.name: (color, [r["median_cm"] for r in own if r["controller"] == c.name])
                for c, color in zip(SWAP_CONTROLLERS, COLORS, strict=True)
            }
            worlds = [w.replace(", ", ",\n") for w in dict.fromkeys(row["world"] for row in own)]
            draw_bars(axis, worlds, series)
            axis.set(title=f"Forces: {truth}", ylim=(0.1, 100.0))
            axis.set_ylabel("Worst height error, median (cm)")
            axis.legend(fontsize=9, ncols=len(series), loc="upper center")
