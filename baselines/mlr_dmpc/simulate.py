"""A simulation of MLR-DMPC without an environment, in which references are followed perfectly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.baselines.mlr_dmpc.input_checks import checked_points
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import RoundLog
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound, Unreachable
from swarm_envs.baselines.mlr_dmpc.trajectory import closest_distances, end_position
from swarm_envs.errors import check_number
from swarm_envs.state import FloatArray


class Violation(NamedTuple):
    """Two references that came too close at a collision sample."""

    time_s: float
    first: int  # The lower index of the two drones
    second: int
    distance_m: float  # Their scaled distance


@dataclass(frozen=True, eq=False)
class MlrDmpcResult:
    """A simulated flight of a swarm under MLR-DMPC."""

    reference_times: FloatArray
    """The times (time,) of the references at 100 Hz, s."""
    reference_positions: FloatArray
    """The positions (time, N, 3) of the references, m; NaN for drones that are not airborne."""
    targets: FloatArray
    """The targets (N, 3) at the end, m."""
    arrival_time_s: float | None
    """The time from which all drones stayed near their targets, s; None if there is none."""
    arrival_times_s: FloatArray
    """The time (N,) from which each drone stayed near its target, s; NaN if there is none."""
    solve_ms: FloatArray
    """The time (plans,) in the solver for each plan, ms."""
    solver_failures: int
    """The number of plans that failed although the present trajectory was feasible."""
    least_shifted_slack_m: float
    """The least slack of any row at the present trajectory, m; by Theorem T1 not negative."""
    violations: tuple[Violation, ...]
    """References too close at collision samples, by more than 1e-6 m."""
    least_distance_m: float
    """The exact minimum of the scaled distance of any pair, also between samples, m."""
    least_sampled_distance_m: float
    """The least scaled distance at the collision samples, m."""
    unreachable: tuple[Unreachable, ...]
    """Targets on which other drones rest."""
    deaf: tuple[int, ...]
    """Drones that accepted none of at least the last 20 plans for them. A flight ends when all
    drones have arrived except these and those of `unreachable`."""
    reports: tuple[SwarmRound, ...]
    """The report of each round."""
    log: tuple[RoundLog[Any], ...]
    """All messages of each round and their receivers."""


Targets = FloatArray | Callable[[float], FloatArray]  # (N, 3), m, or a function of time, s

REFERENCE_RATE = 100.0  # Samples of the reference positions per second
_DAY_S = 86_400
_TOLERANCE = 1e-6


def simulate(
    starts: FloatArray,
    targets: Targets,
    compute_units: int = 3,
    *,
    duration_s: float = 60.0,
    config: MlrDmpcConfig | None = None,
    stop_on_arrival: bool = True,
    progress: bool = False,
    **options: Any,
) -> MlrDmpcResult:
    """Simulate a swarm from starts to targets.

    Args:
        starts: The positions (N, 3) at which the drones hover at first, m.
        targets: The targets (N, 3), m, or a function of time, s, that returns them.
        compute_units: The number M of compute units, at most N.
        duration_s: The longest duration of the flight, s.
        config: The parameters, or None for the defaults.
        stop_on_arrival: True to end when all have arrived; ignored with moving targets.
        progress: True to show a progress bar.
        options: Further options of `MlrDmpcSwarm`, such as `loss`, `recovery` or `seed`.

    Returns:
        References, statistics and all messages.

    Raises:
        ValueError: See `MlrDmpcSwarm`; also for a duration that is not positive or longer than a
            day, and for moving targets that are ever outside the box or too close to each other.
    """
    check_number("duration_s", duration_s, above=0.0, at_most=_DAY_S, unit="s")
    config = config or MlrDmpcConfig()
    rounds = max(round(duration_s / config.round_s), 1)
    count = len(checked_points("starts", starts, config))
    if callable(targets):
        times = [k * config.round_s for k in range(rounds)]
        points = {t: np.asarray(targets(t), dtype=np.float64) for t in times}
        course = [checked_points(f"targets at {t:.1f} s", points[t], config, count) for t in times]
    else:
        course = [checked_points("targets", targets, config, count)]
    swarm = MlrDmpcSwarm(starts, course[0], config=config, compute_units=compute_units, **options)
    flight = _FlightRecorder(swarm)
    ends = stop_on_arrival and not callable(targets)
    for k in tqdm(range(rounds), desc="rounds", unit="round", disable=not progress):
        flight.record_round()
        if ends and flight.over():
            break
        flight.reports.append(swarm.run_round(course[k] if callable(targets) else None))
    return flight.result()


class _FlightRecorder:
    """Records a flight round by round."""

    def __init__(self, swarm: MlrDmpcSwarm) -> None:
        self.swarm, self.reports = swarm, list[SwarmRound]()
        config = swarm.config
        pieces = round(config.round_s / config.input_sampling_s)
        per_round = round(config.round_s * REFERENCE_RATE)
        self._fine = np.arange(per_round) / REFERENCE_RATE
        self._coarse = np.arange(config.samples_per_round) * config.collision_sampling_s
        self._knots = np.arange(pieces) * config.input_sampling_s
        self._references: list[FloatArray] = []
        self._starts: list[FloatArray] = []
        self._errors: list[FloatArray] = []
        self._violations: list[Violation] = []
        self._least = np.inf

    def record_round(self) -> None:
        """Record the references of the round that begins."""
        swarm = self.swarm
        times = np.concatenate([self._fine, self._coarse, self._knots])
        states = swarm.reference(times)
        states[~np.array(swarm.airborne)] = np.nan
        fine, coarse = len(self._fine), len(self._fine) + len(self._coarse)
        self._references.append(states[:, :fine, 0])
        self._starts.append(states[:, coarse:])
        away = states[:, :fine, 0] - swarm.targets[:, None]
        self._errors.append(np.linalg.norm(away, axis=-1))
        self._check(states[:, fine:coarse, 0])

    def _check(self, positions: FloatArray) -> None:
        config = self.swarm.config
        apart = (positions[:, None] - positions) * config.inverse_scaling
        gap = np.sqrt((apart * apart).sum(axis=-1))
        gap = np.where(np.isnan(gap), np.inf, gap)
        gap[np.arange(len(gap)), np.arange(len(gap))] = np.inf
        self._least = min(self._least, float(gap.min()))
        for i, j, s in np.argwhere(gap < config.sampled_distance_m - _TOLERANCE):
            if i < j:
                time = self.swarm.round * config.round_s + float(self._coarse[s])
                self._violations.append(Violation(time, int(i), int(j), float(gap[i, j, s])))

    def over(self) -> bool:
        """Return True if all drones that can arrive have arrived."""
        swarm = self.swarm
        flying = [drone for drone in swarm.nodes.drones if drone.airborne]
        waiting = any(not d.airborne and not d.gone for d in swarm.nodes.drones)
        ends = [end_position(drone.flying, swarm.config) for drone in flying]
        near = [
            np.linalg.norm(end - swarm.targets[drone.index]) <= swarm.config.arrival_m
            for drone, end in zip(flying, ends, strict=True)
        ]
        here = [(self._errors[-1][d.index] <= swarm.config.arrival_m).all() for d in flying]
        if all(near) and all(here) and not waiting:
            return True
        stuck = {i for one in swarm.unreachable for i in one}
        stuck |= {one.drone for one in swarm.deaf}
        return bool(stuck) and all(
            one or drone.index in stuck for drone, one in zip(flying, near, strict=True)
        )

    def result(self) -> MlrDmpcResult:
        """Return the result of the whole flight."""
        swarm, config = self.swarm, self.swarm.config
        references = np.concatenate(self._references, axis=1).swapaxes(0, 1)
        away = ~(np.concatenate(self._errors, axis=1) <= config.arrival_m)
        last = np.where(away.any(axis=1), away.shape[1] - np.argmax(away[:, ::-1], axis=1), 0)
        arrivals = np.where(last < away.shape[1], last / REFERENCE_RATE, np.nan)
        there = arrivals[~np.isnan(references[-1, :, 0])]
        knots = np.concatenate(self._starts, axis=1).swapaxes(0, 1)
        pairs = closest_distances(
            knots[:, :, :3], knots[:, :, 3], config.input_sampling_s, config.inverse_scaling
        )
        plans = [unit.planned for report in self.reports for unit in report.units if unit.planned]
        given_up = [unit for report in self.reports for unit in report.units if unit.given_up]
        failed = [p for p in plans if not p.accepted and p.shifted_slack >= -_TOLERANCE]
        return MlrDmpcResult(
            np.arange(len(references)) / REFERENCE_RATE,
            references,
            swarm.targets,
            float(there.max()) if len(there) and not np.isnan(there).any() else None,
            arrivals,
            np.array([plan.solve_ms for plan in plans]),
            len(failed),
            min((p.shifted_slack for p in plans), default=np.inf) if not given_up else np.nan,
            tuple(self._violations),
            float(pairs.min()),
            self._least,
            swarm.unreachable,
            tuple(one.drone for one in swarm.deaf),
            tuple(self.reports),
            tuple(swarm.log),
        )
