"""What comes out of a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from swarm_envs.baselines.mlr_dmpc.network import RoundLog
from swarm_envs.baselines.mlr_dmpc.swarm import RoundReport
from swarm_envs.state import FloatArray


class Violation(NamedTuple):
    """Two references that came too close at a collision sample."""

    time_s: float
    """When."""
    first: int
    """A drone."""
    second: int
    """Another."""
    distance_m: float
    """Their scaled distance."""


class Unreachable(NamedTuple):
    """A target that a drone cannot take."""

    drone: int
    """Whose target it is."""
    other: int
    """The drone that rests on it."""

    def __str__(self) -> str:
        """The reason, in words."""
        return (
            f"the target of drone {self.drone} is unreachable because another drone, {self.other}, "
            "rests on it"
        )


@dataclass(frozen=True, eq=False)
class MlrDmpcResult:
    """A simulated flight of a swarm under MLR-DMPC."""

    reference_times: FloatArray
    """(time,) at 100 Hz, s."""
    reference_positions: FloatArray
    """(time, N, 3) of the references, m; NaN for who is not in the air."""
    targets: FloatArray
    """(N, 3) at the end, m."""
    arrival_time_s: float | None
    """When all were near their targets for good, s; None: they never were."""
    arrival_times_s: FloatArray
    """(N,) when each was, s; NaN: it never was."""
    solve_ms: FloatArray
    """(plans,) in the solver for each, ms."""
    plan_ms: FloatArray
    """(plans,) for each, with all that building and checking takes, ms."""
    solver_failures: int
    """Plans for which no trajectory was found or accepted although the flown one was feasible."""
    least_shifted_slack_m: float
    """Least slack of any row at the plan that was flown; by Theorem 1 not negative."""
    violations: tuple[Violation, ...]
    """References too close at collision samples, by more than 1e-6 m."""
    pair_distances_m: FloatArray
    """(N, N) exact minimum of each pair's scaled distance, also between samples, m."""
    least_distance_m: float
    """Least of them, m."""
    least_sampled_distance_m: float
    """Least scaled distance at the collision samples, m."""
    unreachable: tuple[Unreachable, ...]
    """Targets that other drones rest on."""
    reports: tuple[RoundReport, ...]
    """What happened in each round."""
    log: tuple[RoundLog[Any], ...]
    """All messages of each round, and to whom they came."""

    @property
    def rounds(self) -> int:
        """How many rounds were simulated."""
        return len(self.reports)
