"""The flight tests of Sec. VII-E, without and with compensation for the same seeds.

Fig. 8: stacked swaps. Its text has the notation (`SL2S`: small and large above small), the number
of swaps (6), and one median; `S*` is a small drone with stronger motors, used where the downwash
was too strong for a plain one: here wherever the lowest drone is a small one.

Fig. 9 and 1: rings of 5 and 16, sizes and speeds of 16 as the authors flew them (`CLOSE_SIXTEEN`),
those of 5 alike. Gains are `STIFF`, the nearest to theirs: in height they have 10, 5 and 10 for
position, velocity and integral (`crazyflieTypes.yaml` in their repository), `STIFF` 11, 6 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import wilcoxon

from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    Flights,
    FlightTest,
    quartiles,
    run_flights,
    swap_test,
)
from swarm_envs.control.config import MID, STIFF, ControllerConfig, PositionGains
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import TrackingSuccess
from swarm_envs.tasks.ring import CLOSE_FIVE, CLOSE_SIXTEEN, RingTask, ring_team
from swarm_envs.vehicles import GRAM_FORCE

PLAIN_SWAPS = ("S2S", "L2S", "S2L", "L2L", "SS2S", "SL2S", "LL2S", "SS2L", "SL2L", "LL2L")
"""Teams of Fig. 8, the lowest drone last."""
STRONG_SWAPS = ("S2S*", "L2S*", "SS2S*", "SL2S*", "LL2S*")
"""Teams with stronger motors for a small drone at the bottom."""
SWAPS = (*PLAIN_SWAPS, *STRONG_SWAPS)
RINGS = {9: (5, CLOSE_FIVE), 1: (16, CLOSE_SIXTEEN)}  # drones and sizes by number of the figure
SIDES = ("without", "compensated")  # the two controllers, in the order of arrays
SIGNIFICANT = 0.05  # differences with a smaller p are called significant

PairedFlights = dict[str, FloatArray]
"""E flights of a case, of N drones, by both controllers; sides are in the order of `SIDES`.

- `worst_cm` (2, E, N): worst height error of each drone since errors count.
- `crashed` (2, E): the flight ended in a collision or a tumble: errors are not the worst there.
- `separation_m` (2, E): smallest distance of two drones.
- `force_rms_g` (N,): of the true vertical force on the compensated drones since errors count;
  `error_rms_g` (N,): of the predicted force less that; `explained` (): share of that force's
  variance, over all drones, which was predicted.
- `shown` (): index of the flight that pictures show, the middle one without compensation. Of it, T
  samples: `time` (T,) s; `height_error_cm` (2, T, N) over the reference; `force_g` (2, T, N), the
  true vertical force; `predicted_g` (T, N), the compensated side's prediction.
"""


class Conditions(NamedTuple):
    """The true force and the world in which a case is flown."""

    truth: str  # name of the force model, or a path of weights
    world: str  # `ideal` or `hall`; see `swarm_envs.hall`

    @property
    def name(self) -> str:
        """Such as `learned`, or `learned, hall`."""
        return self.truth if self.world == "ideal" else f"{self.truth}, {self.world}"


@dataclass(frozen=True)
class FlightCase:
    """One team on one motion."""

    name: str  # such as `L2S`, or `ring of 5`
    test: FlightTest
    drone: int | None  # the drone whose error counts; None for the worst one of each flight
    paper_cm: tuple[float, float] | None = None
    """The paper's error without and with compensation, if it gives one."""
    gains: PositionGains = MID

    def errors(self, flown: PairedFlights) -> FloatArray:
        """Return the errors (2, E) that count, cm."""
        worst = flown["worst_cm"]
        return np.asarray(worst.max(axis=-1)) if self.drone is None else worst[..., self.drone]


def swap_case(name: str, conditions: Conditions, engine: str) -> FlightCase:
    """Return a case of Fig. 8, in which the error of the lowest drone counts."""
    paper = (17.0, 7.0) if name == "L2S" else None  # medians of six swaps
    test = swap_test(name, PAPER_SWAP, load(conditions.truth), engine)
    return FlightCase(name, replace(test, world=conditions.world), -1, paper)


def ring_case(figure: int, conditions: Conditions, engine: str) -> FlightCase:
    """Return the rings of Fig. 9 or Fig. 1, where the error of the worst drone counts."""
    drones, layout = RINGS[figure]
    task = RingTask(ring_team(drones), rings=layout)
    paper = {9: (10.0, 5.0), 1: (15.0, 10.0)}[figure]  # of one drone on an upright ring
    test = FlightTest(task, load(conditions.truth), engine, world=conditions.world)
    return FlightCase(f"ring of {drones}", test, None, paper, STIFF)


def fly_case(case: FlightCase, belief: InteractionModel, seeds: Sequence[int]) -> PairedFlights:
    """Fly a case without and with a force model fed forward: same seeds, gains and references."""
    plain = ControllerConfig(gains=case.gains)
    without = run_flights(case.test, plain, seeds)
    compensated = run_flights(case.test, replace(plain, feedforward=belief), seeds)
    sides = (without, compensated)
    separation = [[m["minimum_separation_m"] for m in side.metrics] for side in sides]
    flown: PairedFlights = {
        "worst_cm": 100.0 * np.stack([side.worst_height_error for side in sides]),
        "crashed": np.stack([side.crashed for side in sides]),
        "separation_m": np.array(separation, dtype=np.float64),
        **_prediction(case, compensated),
    }
    error = case.errors(flown)[0]
    shown = int(np.argsort(error, kind="stable")[(len(error) - 1) // 2])
    heights = [(side.position - side.reference)[shown, ..., 2] for side in sides]
    return flown | {
        "shown": np.array(shown),
        "time": without.time,
        "height_error_cm": 100.0 * np.stack(heights),
        "force_g": np.stack([side.force[shown, ..., 2] / GRAM_FORCE for side in sides]),
        "predicted_g": compensated.feedforward_force[shown, ..., 2] / GRAM_FORCE,
    }


def _prediction(case: FlightCase, flights: Flights) -> dict[str, FloatArray]:
    """Return how well the prediction of compensated flights follows the force."""
    success = case.test.task.success
    begins = success.settle_s if isinstance(success, TrackingSuccess) else 0.0
    flying = np.arange(len(flights.time)) < flights.samples[:, None]
    flying &= (flights.time > 0.0) & (flights.time >= begins)
    force = flights.force[flying][..., 2] / GRAM_FORCE
    error = flights.feedforward_force[flying][..., 2] / GRAM_FORCE - force
    variance = float(force.var())
    return {
        "force_rms_g": np.sqrt(np.mean(force**2, axis=0)),
        "error_rms_g": np.sqrt(np.mean(error**2, axis=0)),
        "explained": np.array(1.0 - np.mean(error**2) / variance if variance else 0.0),
    }


def compare_paired(without: FloatArray, compensated: FloatArray) -> dict[str, Any]:
    """Compare errors (E,) of the same E flights, without and with compensation.

    Returns:
        Ready for JSON: `without` and `compensated`, median and quartiles; `ratio` of the medians,
        compensated over uncompensated; `made_worse`, flights in which compensation made the error
        larger; `p_value` of `signed_rank_p`, and whether it is `significant`.
    """
    before, after = quartiles(without), quartiles(compensated)
    p_value = signed_rank_p(compensated - without)
    return {
        "without": before,
        "compensated": after,
        "ratio": after["median"] / before["median"],
        "made_worse": int((compensated > without).sum()),
        "p_value": p_value,
        "significant": p_value < SIGNIFICANT,
    }


def signed_rank_p(differences: FloatArray) -> float:
    """Return p of Wilcoxon's signed-rank test, two-sided, of paired differences (E,).

    The hypothesis is that differences are symmetric about 0. Pairs are compared because flights
    differ more among each other than controllers do, ranks because errors are not normal. Exact for
    up to 50 pairs without ties or zeros, so that n pairs give no smaller p than 2^(1 - n); zeros
    are dropped, and nothing but zeros gives 1.
    """
    if not np.any(differences):
        return 1.0
    return float(wilcoxon(differences).pvalue)
