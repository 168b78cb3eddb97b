"""The metrics of episodes, in names and plain numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.borrowed import lend
from swarm_envs.compiled import borrowing_kernel, entry_point
from swarm_envs.envs.tally import Tally
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE, Contacts
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.base import Success
from swarm_envs.tasks.metrics import NEAR_MISS, Record
from swarm_envs.tasks.motion import REST
from swarm_envs.vehicles import GRAM_FORCE

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


class Reporter:
    """Tells how episodes of a core went."""

    def __init__(self, core: SwarmCore) -> None:
        self._core = core
        physics = core.physics
        records = (lend(physics.contacts), lend(core.record), lend(core.flight.tally))
        self._added: tuple[Any, ...] = (*records, physics.parameters.radius)
        self._add_up: Callable[..., None] | None = None

    def metrics(self, environments: Sequence[int]) -> list[dict[str, Any]]:
        """What the episodes of these environments are judged by, so far, in their order.

        - `success`: whether the team did its task; `stages_reached` of `stages`: sets of goals at
          which all have stood; `length_s`: time flown.
        - `collided_drones`, `collided_floor`, `collided_wall`, `collided_obstacle`, `tumbled`:
          number of drones that ended so; `near_misses`: drones that came within 1.5 times the sum
          of radii without touching.
        - `minimum_separation_m`: smallest distance between two drones (None if alone);
          `minimum_obstacle_distance_m`: from a drone's centre to an obstacle (None without one).
        - `worst_tracking_error_m`, `rms_tracking_error_m`, `worst_height_error_m`: against the
          reference, over all drones; the lists `..._by_drone_m` say which. None without a
          reference, or before errors count: in `ring` after the start-up. Errors are taken at
          decisions, so compare them at one decision rate.
        - `worst_force_g`: largest force of the air on a drone, its drag included; `energy_j`: ideal
          induced energy of all rotors; `force_bound_violations`: drone-steps of 1/240 s with a
          vertical force above the drone's bound, and `fraction_over_force_bound`: their share of
          all; `fraction_outside_measured_range`: of drone-steps whose force was extrapolated.
        - `time_to_goal_s`: when the last drone came to stay at its goal, in the present stage (None
          if one did not, or where goals move).
        """
        core, where = self._core, np.array(environments, dtype=np.int64)
        sums = self._sums(where)
        ends = {
            "success": core.verdict.succeeded[where].tolist(),
            "stages": [int(core.mission.goals.shape[1])] * len(where),
            "stages_reached": core.mission.reached[where].tolist(),
            "length_s": core.time[where].tolist(),
            **{name: sums[name] for name in _ENDS},
        }
        sums["energy_j"] = core.flight.tally.energy[where].sum(axis=1).tolist()
        if not isinstance(core.task.success, Success):
            sums["time_to_goal_s"] = [None] * len(where)
        flown = {name: sums[name] for name in _FLOWN}
        return [
            {**ended, **_tracking(core, e), **added}
            for e, ended, added in zip(
                environments, _by_episode(ends), _by_episode(flown), strict=True
            )
        ]

    def _sums(self, where: IntArray) -> _Columns:
        """What `add_up` finds of these environments (M,); None for what is not finite."""
        counts: IntArray = np.zeros((len(where), len(_COUNTS)), dtype=np.int64)
        measures: FloatArray = np.empty((len(where), len(_MEASURES)))
        if self._add_up is None:
            self._add_up = entry_point(add_up, where, counts, measures, *self._added)
        self._add_up(where, counts, measures, *self._added)
        sums: _Columns = dict(zip(_COUNTS, counts.T.tolist(), strict=True))
        for name, column in zip(_MEASURES, measures.T.tolist(), strict=True):
            sums[name] = [value if math.isfinite(value) else None for value in column]
        return sums


_COUNTS = (
    "collided_drones",
    "collided_floor",
    "collided_wall",
    "collided_obstacle",
    "tumbled",
    "near_misses",
    "force_bound_violations",
)
"""Sums over drones, in the order of `add_up`."""
_MEASURES = (
    "minimum_separation_m",
    "minimum_obstacle_distance_m",
    "worst_force_g",
    "fraction_over_force_bound",
    "fraction_outside_measured_range",
    "time_to_goal_s",
)
"""What is measured of a whole team, in the order of `add_up`; infinite where it has no value."""


_ENDS = (*_COUNTS[:6], *_MEASURES[:2])
_FLOWN = ("worst_force_g", "energy_j", _COUNTS[6], *_MEASURES[3:])
_Columns = dict[str, list[Any]]
"""Metrics by name, each of every episode."""


def _by_episode(columns: _Columns) -> Iterator[dict[str, Any]]:
    return (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))


@borrowing_kernel
def add_up(
    where: IntArray,
    counts: IntArray,
    measures: FloatArray,
    contacts: Contacts,
    record: Record,
    tally: Tally,
    radius: FloatArray,
) -> None:
    """Add up what the drones of each of these environments have done, so far.

    Args:
        where: (M,) environments.
        counts: (M, 7) the `_COUNTS`, zeros at first; written.
        measures: (M, 6) the `_MEASURES`, written.
        contacts: of the last decision.
        record: of the episodes.
        tally: of the episodes.
        radius: (E, N) of the collision spheres, m.
    """
    for m in range(len(where)):
        e, drones, found = where[m], radius.shape[1], counts[m]
        separation = to_obstacle = np.inf
        force = arrival = 0.0
        steps = outside = 0
        for i in range(drones):
            found[0] += contacts.drone[e, i] != NO_DRONE
            found[1] += contacts.floor[e, i]
            found[2] += contacts.wall[e, i]
            found[3] += contacts.obstacle[e, i] != NO_OBSTACLE
            found[4] += contacts.tumbling[e, i]
            found[5] += 1.0 <= record.clearance[e, i] < NEAR_MISS
            found[6] += tally.over_bound[e, i]
            separation = min(separation, record.separation[e, i])
            to_obstacle = min(to_obstacle, record.obstacle_clearance[e, i] * radius[e, i])
            force = max(force, tally.worst_force[e, i])
            arrival = max(arrival, record.arrival[e, i])
            steps += tally.steps[e, i]
            outside += tally.outside[e, i]
        measures[m, 0], measures[m, 1], measures[m, 2] = separation, to_obstacle, force / GRAM_FORCE
        measures[m, 3], measures[m, 4] = found[6] / max(steps, 1), outside / max(steps, 1)
        measures[m, 5] = arrival


def _tracking(core: SwarmCore, e: int) -> dict[str, Any]:
    record = core.record
    if core.motion.kind == REST or not record.scored[e]:
        names = ("worst_tracking_error_m", "rms_tracking_error_m", "worst_height_error_m")
        return dict.fromkeys(names)
    mean_square = record.squared_error[e].mean() / int(record.scored[e])
    return {
        "worst_tracking_error_m": float(record.worst_error[e].max()),
        "rms_tracking_error_m": float(np.sqrt(mean_square)),
        "worst_height_error_m": float(record.worst_height_error[e].max()),
        "worst_tracking_error_by_drone_m": record.worst_error[e].tolist(),
        "worst_height_error_by_drone_m": record.worst_height_error[e].tolist(),
    }
