"""The experiments of Sec. 5, each a cell whose numbers are kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, circle_swap, formation
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.training.reproduce.dmpc_swarm.flights import CRASH_M, Flight, Setting, fly
from swarm_envs.training.reproduce.runs import Cell

DRONES = 16
"""As in the paper."""
SEQUENCE_LIMIT_S = 120.0
"""Time after which the sequence of formations is given up, s."""
CIRCLE_LIMIT_S = 60.0
"""Time after which the circle is given up, s."""
JAM_S = 2.0
"""For so long compute units hear nothing in Fig. 4."""
RADIUS_M, HEIGHT_M = 1.5, 1.0
"""Radius of the circle, and its height, m."""
LOSSES = (0.0, 1e-4, 0.01, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Shares of messages lost in the sweep."""
MODES: Mapping[str, Any] = {"ours": True, "paper's": "paper", "none": False}
"""How loss is met."""

THEIRS: Mapping[str, float | None] = {
    "1 CU": 69.8,
    "2 CUs": 44.4,
    "3 CUs": 38.4,
    "RR": 55.4,
    "DT": 34.2,
    "HT": 38.4,
    "jam, ours": None,
    "jam, paper's": 31.2,
    "jam, none": None,
}
"""Time to the last arrival of the authors' public simulation, s, on shapes of its own; the paper
prints no numbers. In the jam it took 29.6 to 32.8 s, and without recovery it failed."""


def sequence_cells(figure: str, seeds: Sequence[int]) -> dict[str, tuple[Setting, ...]]:
    """Settings of Fig. 3b, by the number of compute units, or 3c, by the trigger."""
    if figure == "3b":
        return {
            f"{m} CU{'s' * (m > 1)}": tuple(Setting(compute_units=m, seed=s) for s in seeds)
            for m in (1, 2, 3)
        }
    return {t: tuple(Setting(trigger=t, seed=s) for s in seeds) for t in ("RR", "DT", "HT")}


def jam_cells(seeds: Sequence[int]) -> dict[str, tuple[Setting, ...]]:
    """Settings of Fig. 4: compute units send but do not hear for two seconds."""
    rounds = round(JAM_S / MlrDmpcConfig().round_s)
    jam = LossModel(jams=(Jam(first_round=0, last_round=rounds - 1, receivers="units"),))
    return {
        f"jam, {name}": tuple(Setting(loss=jam, recovery=mode, seed=s) for s in seeds)
        for name, mode in MODES.items()
    }


def loss_cells(seeds: Sequence[int]) -> dict[str, tuple[Setting, ...]]:
    """Settings of the sweep: each loss, met in each way."""
    return {
        f"{100 * loss:g} %, {name}": tuple(Setting(loss=loss, recovery=mode, seed=s) for s in seeds)
        for name, mode in MODES.items()
        for loss in LOSSES
    }


def fly_sequence(setting: Setting) -> Flight:
    """Plane, pyramid, cube, sphere and plane (Fig. 3a) by 16 drones."""
    config = MlrDmpcConfig()
    places = [formation(name, DRONES) for name in SEQUENCE]
    return fly(places[0], places[1:], setting, SEQUENCE_LIMIT_S, config)


def fly_circle(setting: Setting) -> Flight:
    """Each of 16 drones to the opposite side of a circle."""
    starts, targets = circle_swap(DRONES, RADIUS_M, HEIGHT_M)
    return fly(starts, [targets], setting, CIRCLE_LIMIT_S, MlrDmpcConfig())


def computed(
    fly_one: Callable[[Setting], Flight],
    settings: Sequence[Setting],
    keep: Callable[[Flight], None] = lambda flight: None,
) -> Cell:
    """What one cell's flights, of as many seeds, measured; the first flight is kept."""
    flights = [fly_one(setting) for setting in settings]
    keep(flights[0])
    totals = [flight.total_s for flight in flights]
    least = [float(flight.scaled_distance.min()) for flight in flights]
    return {
        "seeds": [setting.seed for setting in settings],
        "total_s": totals,
        "legs_s": [flight.legs_s for flight in flights],
        "arrived": sum(total is not None for total in totals),
        "least_scaled_distance_m": least,
        "crashes": sum(distance < CRASH_M for distance in least),
    }


def median_total(cell: Cell) -> float | None:
    """Median of the times to the last arrival, s, if at least half arrived."""
    totals = sorted(float("inf") if t is None else float(t) for t in cell["total_s"])
    middle = totals[(len(totals) - 1) // 2]
    return None if middle == float("inf") else middle
