"""A radio that reads all messages and loses the worst; swarms with joins, leaves and dead units.

Distances are computed here from jerks alone, by other formulas than those of the package.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from swarm_envs.baselines.mlr_dmpc.messages import MessageKind, ViewId
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import RecoveryNodes
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel, LossProcess, RoundLog
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound, UnitOutage
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.state import BoolArray, FloatArray
from tests.helpers.mlr_rounds import scattered

TOLERANCE = 1e-6  # by how much rounding to float32 may take from a distance, m
_FINE = 5  # parts of the time between two samples at whose ends distances are looked at
_BEGINS, _ENDS = 0.08, 0.15
"""Chance by round that the radio begins a trick, and that it ends it: else nobody would plan."""
TRICKS = ("none", "plans", "states", "views", "closest", "split", "deaf")
"""The messages that the radio singles out: see `_Radio`."""


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """A swarm and all that happens to it. The same numbers give the same flight."""

    seed: int  # of starts, targets, and of all that is drawn
    drones: int
    units: int
    unit_loss: float = 0.0
    drone_loss: float = 0.0
    jams: tuple[tuple[int, int, str, str], ...] = ()  # first and last round, senders, receivers
    bursts: float = 0.0  # share of time in which a link is bad, for three rounds on average
    trick: str = "none"  # one of `TRICKS`
    outages: tuple[tuple[int, int, int], ...] = ()  # unit, first and last round
    joins: tuple[tuple[int, int], ...] = ()  # drones that join, and when
    leaves: tuple[tuple[int, int], ...] = ()  # drones that leave, and when
    informed: bool = True
    rounds: int = 40
    recovery: Any = True
    trigger: Any = "WT"

    @staticmethod
    def drawn(seed: int, **changes: Any) -> Trouble:
        """4 to 16 drones and 1 to 4 units with everything at once, by a seed."""
        rng = np.random.default_rng((seed, 7))
        drones, order = int(rng.integers(4, 17)), rng.permutation(16)
        joining, leaving = int(rng.integers(0, 4)), int(rng.integers(0, 3))
        units = int(rng.integers(1, min(drones - joining, 4) + 1))
        order = order[order < drones]
        first, out = int(rng.integers(0, 25)), int(rng.integers(0, 25))
        who = [str(rng.choice(["units", "drones", "all", "unit 0", "drone 1"])) for _ in range(2)]
        loss = float(rng.choice([0.0, 0.01, 0.1, 0.3, 0.6]) * rng.random())
        drawn = Trouble(
            seed=seed,
            drones=drones,
            units=units,
            unit_loss=loss,
            drone_loss=float(rng.choice([0.0, loss, 0.6 * rng.random()])),
            jams=((first, first + int(rng.integers(0, 12)), who[0], who[1]),)
            * int(rng.random() < 0.3),
            bursts=float(rng.choice([0.0, 0.0, 0.05, 0.2])),
            trick=str(rng.choice(TRICKS)),
            outages=((int(rng.integers(units)), out, out + int(rng.integers(0, 20))),)
            * int(rng.random() < 0.4),
            joins=tuple((int(i), int(rng.integers(0, 20))) for i in order[:joining]),
            leaves=tuple((int(i), int(rng.integers(3, 30))) for i in order[joining:][:leaving]),
            informed=bool(rng.random() < 0.6),
            trigger=str(rng.choice(["WT", "HT", "RR", "DT"])),
        )
        return replace(drawn, **changes)

    def swarm(self, config: MlrDmpcConfig | None = None) -> MlrDmpcSwarm:
        """The swarm at its start, in a place so narrow that drones meet at once."""
        config = replace(config or MlrDmpcConfig(), trigger=self.trigger)
        rng = np.random.default_rng((self.seed, 1))
        half = 0.35 * np.sqrt(self.drones)
        place = np.array([[-half, -half, 0.5], [half, half, 2.5]])
        jams = tuple(
            Jam(first_round=a, last_round=b, senders=s, receivers=r) for a, b, s, r in self.jams
        )
        return MlrDmpcSwarm(
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, place),
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, place),
            config=config,
            compute_units=self.units,
            loss=LossModel(unit_loss=self.unit_loss, drone_loss=self.drone_loss, jams=jams),
            recovery=self.recovery,
            seed=self.seed,
            informed=self.informed,
            outages=[UnitOutage(unit=u, first_round=a, last_round=b) for u, a, b in self.outages],
            joins=dict(self.joins),
            leaves=dict(self.leaves),
        )

    def fly(self, config: MlrDmpcConfig | None = None) -> Flight:
        """Fly it, and note all that is broken."""
        swarm = self.swarm(config)
        swarm._loss = _Radio(self, swarm)  # type: ignore[assignment]
        flight = Flight(swarm.config)
        for _ in range(self.rounds):
            before = [(drone.flying, drone.view.id) for drone in swarm.nodes.drones]
            flight.check(swarm, swarm.run_round(), before)
        flight.joined = sum(swarm.airborne[i] for i, _ in self.joins)
        return flight


class _Radio:
    """Which messages arrive: those of the swarm's model, by bursts, and by a trick that reads them.

    `plans`: a plan reaches its drone or the other units, seldom both. `states`: what a drone says
    after a plan for it is lost. `views`: news of views reach some nodes only. `closest`: the two
    drones that are nearest to each other, and whoever plans for them, are heard by few. `split`:
    two groups of nodes, which change slowly, hear only themselves. `deaf`: units hear drones but
    not each other, and news of views come to few drones.
    """

    def __init__(self, trouble: Trouble, swarm: MlrDmpcSwarm) -> None:
        self.rng = np.random.default_rng((trouble.seed, 3))
        self._trouble, self._swarm, self._drones = trouble, swarm, len(swarm.nodes.drones)
        self._nodes = self._drones + trouble.units
        self._bad = np.zeros((self._nodes, self._nodes), dtype=bool)
        self._planned: set[int] = set()
        self._tricked = True
        self._side: BoolArray = np.zeros(self._nodes, dtype=bool)
        self._model: LossProcess = swarm._loss
        self._send = swarm.nodes.send
        swarm.nodes.send = self._listen  # type: ignore[assignment, method-assign]

    def _listen(self, k: int, *given: Any) -> Any:
        """Note what is sent in a round."""
        sent = self._send(k, *given)
        self._log: RoundLog[Any] = RoundLog(k, *sent, np.ones((1, 1), dtype=bool))
        return sent

    def arrivals(self, round_: int) -> BoolArray:
        """(senders, receivers) whether messages of a round arrive."""
        rng, share = self.rng, self._trouble.bursts
        draws = rng.random(self._bad.shape)
        turns = share / max(1.0 - share, 1e-9) / 3.0
        self._bad = np.where(self._bad, draws >= 1.0 / 3.0, draws < turns)
        arrived = self._model.arrivals(round_) & ~self._bad
        self._tricked ^= bool(rng.random() < (_ENDS if self._tricked else _BEGINS))
        if self._trouble.trick != "none" and self._tricked:
            getattr(self, f"_{self._trouble.trick}")(self._log, arrived)
        self._planned = {m.drone for m in self._plans_of(self._log).values()}
        np.fill_diagonal(arrived, True)
        return arrived

    def _plans_of(self, log: RoundLog[Any]) -> dict[int, Any]:
        return {unit: m for unit, m in log.slots.items() if m.kind is MessageKind.PLAN}

    def _plans(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        for unit, message in self._plans_of(log).items():
            row = arrived[self._drones + unit]
            if self.rng.random() < 0.5:
                row[self._drones :] = False
            else:
                row[message.drone] = False

    def _states(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        for drone in self._planned:
            arrived[drone, self.rng.random(self._nodes) < 0.8] = False
        self._plans(log, arrived)

    def _views(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        for unit, message in log.slots.items():
            if getattr(message, "members", None) is not None and log.senders[unit] >= self._drones:
                arrived[log.senders[unit], self.rng.random(self._nodes) < 0.7] = False

    def _deaf(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        arrived[self._drones :, self._drones :] = False
        self._views(log, arrived)

    def _closest(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        swarm = self._swarm
        here = swarm.reference(np.array([0.0]))[:, 0, 0] * swarm.config.inverse_scaling
        gap = np.linalg.norm(here[:, None] - here, axis=-1) + 9.0 * np.eye(self._drones)
        pair = {int(i) for i in np.unravel_index(np.argmin(gap), gap.shape)}
        for unit, message in log.slots.items():
            if message.drone in pair and log.senders[unit] >= self._drones:
                arrived[log.senders[unit], self.rng.random(self._nodes) < 0.6] = False
        for drone in pair:
            arrived[drone, self.rng.random(self._nodes) < 0.5] = False

    def _split(self, log: RoundLog[Any], arrived: BoolArray) -> None:
        self._side ^= self.rng.random(self._nodes) < 0.1
        arrived &= self._side[:, None] == self._side


@dataclass
class Flight:
    """The findings of a flight."""

    config: MlrDmpcConfig
    least_m: float = np.inf  # of all that any two may fly, at samples from t(k+1) on, scaled
    between_m: float = np.inf  # the same within the next round, at a fifth of the samples' distance
    plans: int = 0
    rejected: int = 0  # plans that were not accepted
    accepted: int = 0  # by drones
    joined: int = 0  # drones that joined and are in the air at the end
    covering: int = 0  # for how many trackers Lemma L1 was checked
    up_to_date: int = 0  # and Lemma L2
    broken: list[str] = field(default_factory=list)

    def check(
        self, swarm: MlrDmpcSwarm, report: SwarmRound, before: list[tuple[Trajectory, ViewId]]
    ) -> None:
        """Check a round that has just ended, in which drones flew and were locked as before."""
        self._distances(swarm, report.round)
        self.accepted += len(report.accepted)
        for unit in report.units:
            if unit.planned is None:
                continue
            self.plans += 1
            self.rejected += not unit.planned.accepted
            if unit.planned.shifted_slack < -TOLERANCE:
                self.broken.append(
                    f"round {report.round}: what drone {unit.drone} flies breaks a row by "
                    f"{-unit.planned.shifted_slack:.2e} m (Theorem T1)"
                )
        if isinstance(swarm.nodes, RecoveryNodes):
            self._lemmas(swarm.nodes, report.round, before)

    def _distances(self, swarm: MlrDmpcSwarm, round_: int) -> None:
        """Whatever any may fly keeps its distance from whatever any other may."""
        config = swarm.config
        owner = np.array([i for i, may in enumerate(swarm.may_fly) for _ in may])
        paths = [one for may in swarm.may_fly for one in may]
        samples = np.arange(config.num_samples + 1, dtype=np.float64)
        instants = np.arange(config.samples_per_round * _FINE + 1) / _FINE
        for name, parts, keep in (
            ("least_m", samples, config.sampled_distance_m),
            ("between_m", instants, config.distance_m),
        ):
            times = config.collision_sampling_s * parts
            gap, pair = _least(paths, owner, round_ + 1, times, config)
            setattr(self, name, min(getattr(self, name), gap))
            if gap < keep - TOLERANCE:
                self.broken.append(f"round {round_}: drones {pair} may come to {gap:.6f} m, {name}")

    def _lemmas(
        self, nodes: RecoveryNodes, round_: int, before: list[tuple[Trajectory, ViewId]]
    ) -> None:
        equal: dict[tuple[ViewId, int], tuple[int, list[Any]]] = {}
        for unit in filter(None, nodes.units):
            info = unit.information
            trackers, every = info.trackers, np.arange(len(before))
            for drone in np.flatnonzero(info.flying).tolist():
                flown, lock = before[drone]
                _, candidates = trackers.candidates(every == drone)
                if lock == info.view.id and trackers.covering[drone]:
                    self.covering += 1
                    if not any(same(one, flown, round_) for one in candidates):
                        self.broken.append(
                            f"round {round_}: unit {info.unit} does not know that drone {drone} "
                            f"flies {flown.identity} (Lemma L1)"
                        )
                heard = trackers.confirmed[drone] == round_ - 1 and trackers.covering[drone]
                if heard and lock == info.view.id:
                    self.up_to_date += 1
                    mine = [one.identity for one in candidates]
                    other, theirs = equal.setdefault((info.view.id, drone), (info.unit, mine))
                    if theirs != mine:
                        self.broken.append(
                            f"round {round_}: units {other} and {info.unit} hold {theirs} and "
                            f"{mine} of drone {drone} (Lemma L2)"
                        )


def same(known: Trajectory, flown: Trajectory, round_: int) -> bool:
    """Return True if a trajectory is the flown one from a round on; at rest, if its place is."""
    if known.identity != flown.identity:
        return False
    times = 0.2 * (np.arange(20.0) + round_ - flown.identity.start_round)
    return bool(np.abs(known.positions(times) - flown.positions(times)).max() < 1e-6)


def _least(
    paths: list[Trajectory],
    owner: np.ndarray[Any, Any],
    round_: int,
    times: FloatArray,
    config: MlrDmpcConfig,
) -> tuple[float, tuple[int, int]]:
    """Least scaled distance of paths of different owners at times since a round's start, whose."""
    if len(set(owner)) < 2:
        return np.inf, (-1, -1)
    scaled = np.array([_positions(one, round_, times, config) for one in paths]) / config.scaling
    apart = scaled[:, None] - scaled
    gap = np.sqrt((apart**2).sum(axis=-1).min(axis=-1))
    gap[owner[:, None] == owner] = np.inf
    i, j = np.unravel_index(np.argmin(gap), gap.shape)
    return float(gap[i, j]), (int(owner[i]), int(owner[j]))


def _positions(
    one: Trajectory, round_: int, times: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """(T, 3) by superposition: each jerk, from its start on, adds a cubic less another cubic."""
    step = one.input_sampling_s
    since = times + config.round_s * (round_ - one.identity.start_round)
    since = np.minimum(since, step * len(one.jerk))
    begins = step * np.arange(len(one.jerk) + 1)
    cubes = np.maximum(since[:, None] - begins, 0.0) ** 3 / 6.0
    changes = np.diff(one.jerk, axis=0, prepend=0.0, append=0.0)
    powers = np.stack([np.ones_like(since), since, since**2 / 2.0], axis=1)
    return np.asarray(powers @ one.state + cubes @ changes)
