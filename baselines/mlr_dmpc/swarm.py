"""The swarm, stepped by rounds: drones, compute units and the radio between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import out_of_reach
from swarm_envs.baselines.mlr_dmpc.compute_unit import UnitRound
from swarm_envs.baselines.mlr_dmpc.input_checks import checked_indices, checked_points
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import RecoveryNodes, SwarmNodes
from swarm_envs.baselines.mlr_dmpc.paper_protocol import PaperNodes, TrustingNodes
from swarm_envs.baselines.mlr_dmpc.radio import LossModel, LossProcess, RoundLog
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, end_position, hover
from swarm_envs.baselines.mlr_dmpc.unit_planner import Obstacles, PlanningOptions
from swarm_envs.compiled import announce_compilation
from swarm_envs.errors import check_integer, check_name
from swarm_envs.state import FloatArray

__all__ = ["MlrDmpcSwarm"]

_MOST_UNITS = 254  # Messages name units in a byte
_DEAF_PLANS = 20
_SETTLED_ROUNDS = 35  # Rounds at rest after which a drone is assumed to stay


@dataclass(frozen=True, kw_only=True)
class UnitOutage:
    """Rounds in which a compute unit is dead. It comes back without any information."""

    unit: int
    """The index of the unit."""
    first_round: int
    """The first round without the unit."""
    last_round: int | None = None
    """The last round without the unit; None if it stays dead."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("unit", "first_round"):
            check_integer(name, getattr(self, name), at_least=0)
        if self.last_round is not None:
            check_integer("last_round", self.last_round, at_least=0)

    def covers(self, round_: int) -> bool:
        """Return True if the unit is dead in a round."""
        return self.first_round <= round_ and (self.last_round is None or round_ <= self.last_round)


@dataclass(frozen=True)
class SwarmRound:
    """The report of a round."""

    round: int  # k
    units: tuple[UnitRound, ...]  # Reports of the living compute units
    accepted: dict[int, Trajectory]  # Plans that drones accepted, flown from the next round on
    bytes_sent: int  # In all slots together


class Deaf(NamedTuple):
    """A drone that seems to receive nothing."""

    drone: int
    plans: int  # The number of plans in a row that it has not accepted

    def __str__(self) -> str:
        return (
            f"drone {self.drone} has accepted none of the last {self.plans} plans for it: it seems "
            "to receive nothing"
        )


class Unreachable(NamedTuple):
    """A target that a drone cannot reach."""

    drone: int  # The drone that has the target
    other: int  # The drone that rests on it

    def __str__(self) -> str:
        return (
            f"the target of drone {self.drone} is unreachable because another drone, {self.other}, "
            "rests on it"
        )


class MlrDmpcSwarm:
    """A swarm under MLR-DMPC.

    Args:
        starts: The positions (N, 3) at which the drones hover at first, m.
        targets: The targets (N, 3), m.
        config: The parameters, or None for the defaults.
        compute_units: The number M of compute units, at most as many as drones.
        loss: The share of messages lost, or a model.
        recovery: The recovery from message loss: True for this package's trackers, "paper" for
            Algorithms 1 and 2 line by line, False to ignore loss, so that drones collide.
        seed: The seed of losses and detours; the same seed gives the same flight.
        informed: True if the units know the starts, as in the public simulation.
        outages: The outages of compute units.
        joins: The round at which a drone, by index, switches on; the others are on from the start.
        leaves: The round in which a drone, by index, lands, clear of the others.
        obstacles: A function that returns half-spaces for the plans, or None.

    Raises:
        ValueError: Starts or targets are outside the box or too close to each other, there are more
            units than drones or than messages can name, or an option is out of range.
    """

    def __init__(
        self,
        starts: FloatArray,
        targets: FloatArray,
        *,
        config: MlrDmpcConfig | None = None,
        compute_units: int = 3,
        loss: float | LossModel = 0.0,
        recovery: bool | Literal["paper"] = True,
        seed: int = 0,
        informed: bool = True,
        outages: Sequence[UnitOutage] = (),
        joins: Mapping[int, int] | None = None,
        leaves: Mapping[int, int] | None = None,
        obstacles: Obstacles | None = None,
    ) -> None:
        check_integer("compute_units", compute_units, at_least=1)
        check_integer("seed", seed, at_least=0)
        check_name("recovery", str(recovery), ("True", "False", "paper"))
        given = config or MlrDmpcConfig()
        starts = checked_points("starts", starts, given)
        self.config = given.for_swarm(len(starts))
        self.targets = checked_points("targets", targets, self.config, len(starts))
        """The targets (N, 3), m."""
        if compute_units > min(len(starts), _MOST_UNITS):
            raise ValueError(
                f"compute_units is {compute_units}, but must be at most "
                f"{min(len(starts), _MOST_UNITS)}: there are {len(starts)} drones, and each unit "
                "plans for another one"
            )
        self.round = 0
        """The next round."""
        announce_compilation(out_of_reach)
        self._joins = checked_indices("joins", joins or {}, len(starts))
        self._leaves = checked_indices("leaves", leaves or {}, len(starts))
        self._outages = tuple(outages)
        failing = {outage.unit: outage.first_round for outage in self._outages}
        checked_indices("outages", failing, compute_units, "unit")
        self._loss = LossProcess(LossModel.of(loss), len(starts), compute_units, seed)
        options = PlanningOptions(
            config=self.config,
            num_drones=len(starts),
            num_units=compute_units,
            seed=seed,
            obstacles=obstacles,
        )
        steps, sampling = self.config.num_inputs, self.config.input_sampling_s
        hovers = [hover(start, steps, sampling) for start in starts]
        nodes = RecoveryNodes if recovery is True else PaperNodes if recovery else TrustingNodes
        self.nodes: SwarmNodes = nodes(hovers, self.targets, options, informed, self._joins)
        """Drones and compute units."""
        self._missed: dict[int, int] = {}  # Plans in a row that a drone has not accepted
        self.log: list[RoundLog[Any]] = []
        """All messages."""
        self.may_fly: list[list[Trajectory]] = [[one] for one in hovers]
        """The trajectories, by drone, that it may fly from the next round on, whichever of the last
        round's messages were lost; empty if it is not airborne."""

    @property
    def flying(self) -> list[Trajectory]:
        """The trajectory of each drone in the next round."""
        return [drone.flying for drone in self.nodes.drones]

    @property
    def airborne(self) -> list[bool]:
        """True for each drone that is airborne."""
        return [drone.airborne for drone in self.nodes.drones]

    @property
    def deaf(self) -> tuple[Deaf, ...]:
        """Drones that accepted none of at least the last 20 plans, by number."""
        found = (Deaf(*one) for one in sorted(self._missed.items()))
        return tuple(one for one in found if one.plans >= _DEAF_PLANS)

    @property
    def unreachable(self) -> tuple[Unreachable, ...]:
        """Targets on which other airborne drones have rested for long."""
        config, targets = self.config, self.targets
        flying = {drone.index: drone.flying for drone in self.nodes.drones if drone.airborne}
        ends = {drone: end_position(one, config) for drone, one in flying.items()}
        settled = self.round - config.horizon_rounds - _SETTLED_ROUNDS
        rest = [drone for drone, one in flying.items() if one.identity.start_round <= settled]
        away = {i: np.linalg.norm(end - targets[i]) > config.arrival_m for i, end in ends.items()}
        return tuple(
            Unreachable(drone, other)
            for drone in ends
            for other in rest
            if away[drone]
            and other != drone
            and np.linalg.norm((ends[other] - targets[drone]) * config.inverse_scaling)
            < config.sampled_distance_m
        )

    def run_round(
        self, targets: FloatArray | None = None, measured: FloatArray | None = None
    ) -> SwarmRound:
        """Run a round, in which units plan, and all nodes send and receive.

        Args:
            targets: The targets (N, 3) from now on, m; None if they stay.
            measured: The positions and velocities (N, 2, 3) at the start of the round; a drone that
                is far off its reference gives it up. None if all are on their references.

        Raises:
            ValueError: Targets are outside the box or too close to each other.
        """
        k, nodes = self.round, self.nodes
        if targets is not None:
            self.targets = checked_points("targets", targets, self.config, len(self.nodes.drones))
        if measured is not None:
            for drone, seen in zip(nodes.drones, measured, strict=True):
                drone.give_up(seen, k)
        for index, since in self._leaves.items():
            if k >= since:
                nodes.drones[index].leave()
        dead = {outage.unit for outage in self._outages if outage.covers(k)}
        alive = set(range(nodes.options.num_units)) - dead
        present = {i for i in range(len(nodes.drones)) if k >= self._joins.get(i, 0)}
        sent = nodes.send(k, self.targets, alive, present)
        log: RoundLog[Any] = RoundLog(k, *sent, self._loss.arrivals(k))
        self.log.append(log)
        self.may_fly = nodes.may_fly(log)
        accepted = nodes.receive(log, alive, present)
        self.round = k + 1
        reports = tuple(nodes.reports[unit] for unit in sorted(alive))
        for unit in reports:
            if unit.planned is not None and unit.planned.accepted:
                missed = 0 if unit.drone in accepted else self._missed.get(unit.drone, 0) + 1
                self._missed[unit.drone] = missed
        return SwarmRound(k, reports, accepted, nodes.bytes_sent(log))

    def reference(self, times: FloatArray) -> FloatArray:
        """Return the references (N, T, 4, 3): position, velocity, acceleration and jerk.

        Args:
            times: The times (T,) since the start of the next round, s, within it.
        """
        out = np.empty((len(self.nodes.drones), len(times), 4, 3))
        for i, one in enumerate(self.flying):
            since = times + self.config.round_s * (self.round - one.identity.start_round)
            out[i, :, :3] = one.states(since)
            interval = (since / one.input_sampling_s + 1e-9).astype(int)
            past = interval >= len(one.jerk)
            out[i, :, 3] = one.jerk[np.minimum(interval, len(one.jerk) - 1)]
            out[i, past, 3] = 0.0
        return out
