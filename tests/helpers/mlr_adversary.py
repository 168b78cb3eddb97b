"""A radio that reads all messages and loses the worst; swarms with joins, leaves and dead units.

Distances are computed here from jerks alone, by other formulas than those of the package.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from swarm_envs.baselines.mlr_dmpc.compute_unit import UnitRound
from swarm_envs.baselines.mlr_dmpc.messages import MessageKind
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import RoundLog
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.state import BoolArray, FloatArray
from tests.helpers.mlr_rounds import scattered

TOLERANCE = 1e-6
"""By how much rounding to float32 may take from a distance, m."""
_FINE = 5
"""Parts of the time between two samples at whose ends distances are looked at."""
_BEGINS, _ENDS = 0.08, 0.15
"""Chance by round that the radio begins a trick, and that it ends it: else nobody would plan."""
TRICKS = ("none", "plans", "states", "views", "closest", "split", "deaf")
"""What the radio singles out: see `Radio`."""


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """A swarm and all that happens to it. The same seed and sizes give the same flight."""

    seed: int
    """Of starts, targets, and of all that is drawn."""
    drones: int
    """N."""
    units: int
    """M."""
    loss: float = 0.0
    """Share of messages lost, by link, whatever else happens."""
    bursts: float = 0.0
    """Share of time in which a link is bad; bad times last three rounds on average."""
    trick: str = "none"
    """One of `TRICKS`."""
    joins: tuple[tuple[int, int], ...] = ()
    """Drones that join, and when."""
    leaves: tuple[tuple[int, int], ...] = ()
    """Drones that leave, and when."""
    flaps: float = 0.0
    """Chance by round that a unit dies; one that is dead comes back with a chance of 0.3."""
    rounds: int = 40
    """Rounds of the flight."""

    @staticmethod
    def drawn(seed: int) -> Trouble:
        """4 to 12 drones and 1 to 4 units with everything at once, by a seed."""
        rng = np.random.default_rng((seed, 7))
        drones = int(rng.integers(4, 13))
        order = rng.permutation(drones)
        joining = int(rng.integers(1, 4))
        leaving = int(rng.integers(0, 3))
        return Trouble(
            seed=seed,
            drones=drones,
            units=int(rng.integers(1, min(drones - joining, 4) + 1)),
            loss=float(rng.choice([0.0, 0.0, 0.05, 0.2])),
            bursts=float(rng.choice([0.0, 0.0, 0.05, 0.2])),
            trick=str(rng.choice(TRICKS)),
            joins=tuple((int(i), int(rng.integers(0, 20))) for i in order[:joining]),
            leaves=tuple((int(i), int(rng.integers(3, 30))) for i in order[-leaving:][:leaving]),
            flaps=float(rng.choice([0.0, 0.0, 0.02])),
        )

    @staticmethod
    def joining(seed: int, loss: float) -> Trouble:
        """8 to 12 drones, three of which join one after the other, and 3 units."""
        rng = np.random.default_rng(seed)
        drones = int(rng.integers(8, 13))
        joins = tuple((drones - 1 - i, int(rng.integers(0, 15))) for i in range(3))
        return Trouble(seed=seed, drones=drones, units=3, loss=loss, joins=joins, rounds=60)

    def swarm(self, config: MlrDmpcConfig | None = None) -> MlrDmpcSwarm:
        """The swarm at its start, in a place so narrow that drones meet at once."""
        config = config or MlrDmpcConfig()
        rng = np.random.default_rng((self.seed, 1))
        half = 0.35 * np.sqrt(self.drones)
        place = np.array([[-half, -half, 0.5], [half, half, 2.5]])
        return MlrDmpcSwarm(
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, place),
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, place),
            config=config,
            compute_units=self.units,
            seed=self.seed,
            informed=bool(rng.random() < 0.5),
            joins=dict(self.joins),
        )

    def fly(self, config: MlrDmpcConfig | None = None) -> Flight:
        """Fly it, and note all that is broken."""
        swarm = self.swarm(config)
        radio = _Radio(self, swarm)
        flight = Flight(swarm.config.sampled_distance_m, swarm.config.distance_m)
        alive = set(range(self.units))
        for k in range(self.rounds):
            alive = self._flapped(alive, radio.rng)
            log, reports = self._round(swarm, radio, alive, k)
            flight.check(swarm, log, reports)
        flight.joined = sum(swarm.airborne[i] for i, _ in self.joins)
        return flight

    def _flapped(self, alive: set[int], rng: np.random.Generator) -> set[int]:
        draws = rng.random(self.units)
        return {u for u in range(self.units) if draws[u] >= (self.flaps if u in alive else 0.7)}

    def _round(
        self, swarm: MlrDmpcSwarm, radio: _Radio, alive: set[int], k: int
    ) -> tuple[RoundLog[Any], list[UnitRound]]:
        """One round, as `MlrDmpcSwarm.run_round`, but for what arrives."""
        nodes = swarm.nodes
        for drone, since in self.leaves:
            if k >= since:
                nodes.drones[drone].leave()
        joins = dict(self.joins)
        present = {i for i in range(self.drones) if k >= joins.get(i, 0)}
        states, slots, senders = nodes.send(k, swarm.targets, alive, present)
        log = RoundLog(k, states, slots, senders, np.ones((1, 1), dtype=bool))
        log = RoundLog(k, states, slots, senders, radio.arrivals(swarm, log))
        swarm.may_fly = nodes.may_fly(log)
        nodes.receive(log, alive, present)
        swarm.round = k + 1
        return log, [nodes.reports[unit] for unit in sorted(alive)]


class _Radio:
    """Which messages arrive: link by link, by bursts, and by a trick that reads them.

    `plans`: a plan reaches its drone or the other units, seldom both. `states`: what a drone says
    after a plan for it is lost. `views`: news of views reach some nodes only. `closest`: the two
    drones that are nearest to each other, and whoever plans for them, are heard by few. `split`:
    two groups of nodes, which change slowly, hear only themselves. `deaf`: units hear drones but
    not each other, and news of views come to few drones.
    """

    def __init__(self, trouble: Trouble, swarm: MlrDmpcSwarm) -> None:
        self.rng = np.random.default_rng((trouble.seed, 3))
        self._trouble, self._drones = trouble, len(swarm.nodes.drones)
        self._nodes = self._drones + trouble.units
        self._bad = np.zeros((self._nodes, self._nodes), dtype=bool)
        self._planned: set[int] = set()
        self._tricked = True
        self._side: BoolArray = np.zeros(self._nodes, dtype=bool)

    def arrivals(self, swarm: MlrDmpcSwarm, log: RoundLog[Any]) -> BoolArray:
        """(senders, receivers) whether messages of a round arrive."""
        rng, share = self.rng, self._trouble.bursts
        draws = rng.random(self._bad.shape)
        turns = share / max(1.0 - share, 1e-9) / 3.0
        self._bad = np.where(self._bad, draws >= 1.0 / 3.0, draws < turns)
        arrived = rng.random(self._bad.shape) >= self._trouble.loss
        arrived &= ~self._bad
        self._tricked ^= bool(rng.random() < (_ENDS if self._tricked else _BEGINS))
        if self._trouble.trick != "none" and self._tricked:
            getattr(self, f"_{self._trouble.trick}")(swarm, log, arrived)
        self._planned = {m.drone for m in log.slots.values() if m.kind is MessageKind.PLAN}
        np.fill_diagonal(arrived, True)
        return arrived

    def _plans(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        for unit, message in log.slots.items():
            if message.kind is MessageKind.PLAN:
                row = arrived[self._drones + unit]
                if self.rng.random() < 0.5:
                    row[self._drones :] = False
                else:
                    row[message.drone] = False

    def _states(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        for drone in self._planned:
            arrived[drone, self.rng.random(self._nodes) < 0.8] = False
        self._plans(swarm, log, arrived)

    def _views(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        for unit, message in log.slots.items():
            if getattr(message, "members", None) is not None and log.senders[unit] >= self._drones:
                arrived[log.senders[unit], self.rng.random(self._nodes) < 0.7] = False

    def _deaf(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        arrived[self._drones :, self._drones :] = False
        self._views(swarm, log, arrived)

    def _closest(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        here = swarm.reference(np.array([0.0]))[:, 0, 0] * swarm.config.inverse_scaling
        gap = np.linalg.norm(here[:, None] - here, axis=-1) + 9.0 * np.eye(self._drones)
        pair = {int(i) for i in np.unravel_index(np.argmin(gap), gap.shape)}
        for unit, message in log.slots.items():
            if message.drone in pair and log.senders[unit] >= self._drones:
                lost = self.rng.random(self._nodes) < 0.6
                arrived[log.senders[unit], lost] = False
        for drone in pair:
            arrived[drone, self.rng.random(self._nodes) < 0.5] = False

    def _split(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], arrived: BoolArray) -> None:
        self._side ^= self.rng.random(self._nodes) < 0.1
        arrived &= self._side[:, None] == self._side


@dataclass
class Flight:
    """What was seen in a flight."""

    sampled_m: float
    """What is to be kept at samples, m."""
    always_m: float
    """What is to be kept between them, m."""
    least_m: float = np.inf
    """Least scaled distance of all that any two may fly, at samples from t(k+1) on, m."""
    between_m: float = np.inf
    """The same between samples, at a fifth of their distance in time, within the next round, m."""
    plans: int = 0
    """Plans that were made."""
    infeasible: int = 0
    """Those that Theorem 1 denies, although nobody had given up a reference."""
    joined: int = 0
    """Drones that joined and are in the air at the end."""
    broken: list[str] = field(default_factory=list)
    """Sentences on what was broken."""

    def check(self, swarm: MlrDmpcSwarm, log: RoundLog[Any], reports: list[UnitRound]) -> None:
        """Check a round that has just ended."""
        planned = [report.planned for report in reports if report.planned is not None]
        self.plans += len(planned)
        self.infeasible += sum(one.shifted_slack < -TOLERANCE for one in planned)
        config, k = swarm.config, log.round + 1
        owner = np.array([i for i, may in enumerate(swarm.may_fly) for _ in may])
        paths = [one for may in swarm.may_fly for one in may]
        samples = np.arange(config.num_samples + 1, dtype=np.float64)
        instants = np.arange(config.samples_per_round * _FINE + 1, dtype=np.float64)
        coarse = np.asarray(config.collision_sampling_s * samples)
        fine = np.asarray(config.collision_sampling_s / _FINE * instants)
        gap, pair = _least(paths, owner, k, coarse, config)
        self.least_m = min(self.least_m, gap)
        between, whose = _least(paths, owner, k, fine, config)
        self.between_m = min(self.between_m, between)
        if gap < self.sampled_m - TOLERANCE or between < self.always_m - TOLERANCE:
            self.broken.append(
                f"round {log.round}: drones {pair} may come to {gap:.6f} m at samples, drones "
                f"{whose} to {between:.6f} m between them"
            )


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
