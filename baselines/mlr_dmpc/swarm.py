"""The whole swarm, stepped by rounds: drones, compute units and the radio between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.baselines.mlr_dmpc.checks import (
    checked_indices,
    checked_options,
    checked_points,
)
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.crew import Crew, OurCrew, PaperCrew
from swarm_envs.baselines.mlr_dmpc.loss import LossModel
from swarm_envs.baselines.mlr_dmpc.network import Network, RoundLog
from swarm_envs.baselines.mlr_dmpc.planning import Obstacles, PlanningOptions
from swarm_envs.baselines.mlr_dmpc.reach import out_of_reach
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, hover
from swarm_envs.baselines.mlr_dmpc.unit import UnitRound
from swarm_envs.compiled import announce_compilation
from swarm_envs.state import FloatArray


@typed
@dataclass(frozen=True, kw_only=True)
class UnitOutage:
    """Rounds in which a compute unit is dead. It comes back knowing nothing."""

    unit: int
    """Which."""
    first_round: int
    """First round without it."""
    last_round: int | None = None
    """Last round without it; None: it stays dead."""

    def covers(self, round_: int) -> bool:
        """Whether the unit is dead in a round."""
        return self.first_round <= round_ and (self.last_round is None or round_ <= self.last_round)


@dataclass(frozen=True)
class RoundReport:
    """What happened in a round."""

    round: int
    """k."""
    units: tuple[UnitRound, ...]
    """What each living compute unit did."""
    accepted: dict[int, Trajectory]
    """Plans that drones accepted, flown from the next round on."""
    bytes_sent: int
    """In all slots together."""


@typed
class MlrDmpcSwarm:
    """A swarm under MLR-DMPC.

    Args:
        starts: (N, 3) where the drones hover at first, m.
        targets: (N, 3) where they are to go, m.
        config: parameters.
        compute_units: M, at most as many as drones.
        trigger: `HT`, `RR` or `DT` (Appendix A).
        loss: share of messages lost, a preset's name or a model.
        recovery: True: ours; "paper": Algorithms 1 and 2; False: none, drones then collide.
        seed: of losses and detours.
        solver: `daqp`, `quadprog` or `osqp`.
        measure: of priorities, `end` or `next` (A2).
        informed: whether the units know the starts, as in the public simulation.
        outages: of compute units.
        joins: round at which a drone, by index, switches on; the others are there from the start.
        leaves: round in which a drone, by index, leaves the air, clear of the others.
        obstacles: half-spaces for the plans.

    Raises:
        ValueError: starts or targets outside the box or too close to each other, more units than
            drones, or options that are none.
    """

    def __init__(
        self,
        starts: FloatArray,
        targets: FloatArray,
        *,
        config: MlrDmpcConfig | None = None,
        compute_units: int = 3,
        trigger: str = "HT",
        loss: float | str | LossModel = 0.0,
        recovery: bool | str = True,
        seed: int = 0,
        solver: str = "daqp",
        measure: str = "end",
        informed: bool = True,
        outages: Sequence[UnitOutage] = (),
        joins: Mapping[int, int] | None = None,
        leaves: Mapping[int, int] | None = None,
        obstacles: Obstacles | None = None,
    ) -> None:
        given = config or MlrDmpcConfig()
        starts = checked_points("starts", starts, given)
        self.config = given.for_swarm(len(starts))
        self._targets = checked_points("targets", targets, self.config, len(starts))
        checked_options(compute_units, len(starts), trigger, recovery, measure, seed)
        self.round = 0
        """The round that comes next."""
        announce_compilation(out_of_reach)
        self._joins = checked_indices("joins", joins or {}, len(starts))
        self._leaves = checked_indices("leaves", leaves or {}, len(starts))
        self._outages = tuple(outages)
        failing = {outage.unit: outage.first_round for outage in self._outages}
        checked_indices("outages", failing, compute_units, "unit")
        self._network: Network[Any] = Network(len(starts), compute_units, LossModel.of(loss), seed)
        options = PlanningOptions(
            config=self.config,
            num_drones=len(starts),
            num_units=compute_units,
            trigger=trigger,
            measure=measure,
            solver=solver,
            seed=seed,
            obstacles=obstacles,
        )
        steps, sampling = self.config.num_inputs, self.config.input_sampling_s
        hovers = [hover(start, steps, sampling) for start in starts]
        kind = OurCrew if recovery is True else PaperCrew
        self.crew: Crew = kind(hovers, self._targets, options, informed, self._joins, recovery)
        """Drones and compute units."""
        self.log: list[RoundLog[Any]] = []
        """All messages."""
        self.may_fly: list[list[Trajectory]] = [[one] for one in hovers]
        """By drone, what it may be flying from the next round on, as far as the last round's
        messages are lost or not; empty where it is not in the air."""

    @property
    def num_drones(self) -> int:
        """N."""
        return len(self.crew.drones)

    @property
    def targets(self) -> FloatArray:
        """(N, 3) where the drones are to go, m."""
        return self._targets

    @property
    def flying(self) -> list[Trajectory]:
        """What each drone flies in the round that comes next."""
        return [drone.flying for drone in self.crew.drones]

    @property
    def airborne(self) -> list[bool]:
        """Which drones are in the air."""
        return [drone.airborne for drone in self.crew.drones]

    def run_round(
        self, targets: FloatArray | None = None, measured: FloatArray | None = None
    ) -> RoundReport:
        """Plan, send and receive: one round.

        Args:
            targets: (N, 3) from now on, m.
            measured: (N, 2, 3) positions and velocities at the start of the round; a drone that is
                far off its reference gives it up. None: all are on their references.

        Raises:
            ValueError: targets outside the box or too close to each other.
        """
        k, crew = self.round, self.crew
        if targets is not None:
            self._targets = checked_points("targets", targets, self.config, self.num_drones)
        if measured is not None:
            for drone, seen in zip(crew.drones, measured, strict=True):
                drone.give_up(seen, k)
        for index, since in self._leaves.items():
            if k >= since:
                crew.drones[index].leave()
        alive = {
            unit
            for unit in range(crew.num_units)
            if not any(o.unit == unit and o.covers(k) for o in self._outages)
        }
        present = {i for i in range(self.num_drones) if k >= self._joins.get(i, 0)}
        states, slots, senders = crew.speak(k, self._targets, alive, present)
        log = self._network.carry(k, states, slots, senders)
        self.log.append(log)
        self.may_fly = crew.may_fly(log)
        accepted = crew.listen(log, self._network, alive, present)
        self.round = k + 1
        reports = tuple(crew.reports[unit] for unit in sorted(alive))
        return RoundReport(k, reports, accepted, crew.bytes_sent(log))

    def reference(self, times: FloatArray) -> FloatArray:
        """What the drones follow (N, T, 4, 3): position, velocity, acceleration and jerk.

        Args:
            times: (T,) since the start of the round that comes next, s, within it.
        """
        out = np.empty((self.num_drones, len(times), 4, 3))
        for i, one in enumerate(self.flying):
            since = times + self.config.round_s * (self.round - one.identity.start_round)
            out[i, :, :3] = one.states(since)
            interval = (since / one.input_sampling_s + 1e-9).astype(int)
            past = interval >= len(one.jerk)
            out[i, :, 3] = one.jerk[np.minimum(interval, len(one.jerk) - 1)]
            out[i, past, 3] = 0.0
        return out
