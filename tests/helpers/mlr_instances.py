"""Random swarms under random trouble, and what must hold in every one of their rounds."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import RecoveryNodes
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound, UnitOutage
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, sampled_positions
from swarm_envs.files import write_json
from swarm_envs.state import FloatArray

TOLERANCE = 1e-6
PLACE = np.array([[-1.2, -1.2, 0.5], [1.2, 1.2, 2.7]])


@dataclass(frozen=True)
class Instance:
    """A swarm and its troubles; JSON and back."""

    seed: int
    drones: int
    units: int
    loss: float = 0.0
    drone_loss: float = 0.0
    jams: tuple[tuple[int, int, str, str], ...] = ()
    outages: tuple[tuple[int, int, int], ...] = ()
    joins: tuple[tuple[int, int], ...] = ()
    leaves: tuple[tuple[int, int], ...] = ()
    informed: bool = True
    rounds: int = 30
    recovery: bool | str = True
    trigger: str = "HT"

    @staticmethod
    def random(seed: int, **changes: object) -> Instance:
        """4 to 16 drones, losses to 60 %, jams, crashes and returns, joins and leaves."""
        rng = np.random.default_rng(seed)
        drones = int(rng.integers(4, 17))
        units = int(rng.integers(1, min(drones, 5)))
        first = int(rng.integers(0, 25))
        jam = (first, first + int(rng.integers(0, 12)))
        who = ("units", "drones", "all", "unit 0", "drone 1")
        loss = float(rng.choice([0.0, 0.01, 0.1, 0.3, 0.6])) * float(rng.random())
        out = int(rng.integers(0, 25))
        fields: dict[str, object] = {
            "loss": loss,
            "drone_loss": float(rng.choice([0.0, loss, 0.6 * rng.random()])),
            "jams": ((*jam, str(rng.choice(who)), str(rng.choice(who))),) * int(rng.random() < 0.4),
            "outages": ((int(rng.integers(units)), out, out + int(rng.integers(0, 20))),)
            * int(rng.random() < 0.4),
            "joins": ((drones - 1, int(rng.integers(0, 15))),) * int(rng.random() < 0.3),
            "leaves": ((0, int(rng.integers(5, 30))),) * int(rng.random() < 0.2),
            "informed": bool(rng.random() < 0.7),
            "trigger": str(rng.choice(["HT", "RR", "DT"])),
        }
        return Instance(seed, drones, units, **{**fields, **changes})  # type: ignore[arg-type]

    def swarm(self) -> MlrDmpcSwarm:
        """The swarm at its start."""
        rng = np.random.default_rng((self.seed, 1))
        config = MlrDmpcConfig()
        jams = tuple(
            Jam(first_round=a, last_round=b, senders=s, receivers=r) for a, b, s, r in self.jams
        )
        return MlrDmpcSwarm(
            spread(rng, self.drones, config),
            spread(rng, self.drones, config),
            config=config,
            compute_units=self.units,
            trigger=self.trigger,
            loss=LossModel(unit_loss=self.loss, drone_loss=self.drone_loss, jams=jams),
            recovery=self.recovery,
            seed=self.seed,
            informed=self.informed,
            outages=[UnitOutage(unit=u, first_round=a, last_round=b) for u, a, b in self.outages],
            joins=dict(self.joins),
            leaves=dict(self.leaves),
        )

    def write(self, path: Path) -> None:
        """Keep it, to be replayed by `read(path).run()`."""
        write_json(path, asdict(self))

    @staticmethod
    def read(path: Path) -> Instance:
        """An instance that was kept."""
        content = json.loads(path.read_text())
        for name in ("jams", "outages", "joins", "leaves"):
            content[name] = tuple(tuple(one) for one in content[name])
        return Instance(**content)

    def run(self) -> Findings:
        """Fly it, and note all that is broken."""
        swarm, findings = self.swarm(), Findings()
        for _ in range(self.rounds):
            before = [(drone.flying, drone.lock) for drone in swarm.nodes.drones]
            report = swarm.run_round()
            findings.check(swarm, report, before)
        return findings


@dataclass
class Findings:
    """What was seen in a flight."""

    broken: list[str] = field(default_factory=list)
    least: float = np.inf
    plans: int = 0
    failures: int = 0
    accepted: int = 0
    covering: int = 0
    up_to_date: int = 0

    def check(self, swarm: MlrDmpcSwarm, report: SwarmRound, before: list[tuple]) -> None:
        """Check a round that has just ended."""
        self._distances(swarm, report.round)
        self.accepted += len(report.accepted)
        for unit in report.units:
            if unit.planned is None:
                continue
            self.plans += 1
            self.failures += not unit.planned.accepted
            if unit.planned.shifted_slack < -TOLERANCE:
                self.broken.append(
                    f"round {report.round}: what drone {unit.drone} flies breaks a row by "
                    f"{-unit.planned.shifted_slack:.2e} m (Theorem 1)"
                )
        if isinstance(swarm.nodes, RecoveryNodes):
            self._lemmas(swarm.nodes, report.round, before)

    def _distances(self, swarm: MlrDmpcSwarm, round_: int) -> None:
        """Whatever any may fly keeps its distance from whatever any other may."""
        config = swarm.config
        owner, paths = [], []
        for drone, may in enumerate(swarm.may_fly):
            owner += [drone] * len(may)
            paths += [sampled_positions(one, round_ + 1, config) for one in may]
        gap = distances(np.array(paths), config)
        gap[np.equal.outer(owner, owner)] = np.inf
        least = float(gap.min(initial=np.inf))
        self.least = min(self.least, least)
        if least < config.distance_m - TOLERANCE:
            i, j = np.unravel_index(np.argmin(gap), gap.shape)
            self.broken.append(
                f"round {round_}: drones {owner[i]} and {owner[j]} may come to {least:.6f} m"
            )

    def _lemmas(self, nodes: RecoveryNodes, round_: int, before: list[tuple]) -> None:
        equal: dict[tuple, tuple[int, list]] = {}
        for unit in filter(None, nodes.units):
            info = unit.information
            for drone in info.flying():
                tracker, (flown, lock) = info.trackers[drone], before[drone]
                if lock == info.view.id and tracker.covering:
                    self.covering += 1
                    if not any(same(one, flown, round_) for one in tracker.candidates):
                        self.broken.append(
                            f"round {round_}: unit {info.unit} does not know that drone {drone} "
                            f"flies {flown.identity} (Lemma 1)"
                        )
                if tracker.up_to_date(round_) and lock == info.view.id:
                    self.up_to_date += 1
                    mine = sorted(tracker.possible)
                    other, theirs = equal.setdefault((info.view.id, drone), (info.unit, mine))
                    if theirs != mine:
                        self.broken.append(
                            f"round {round_}: units {other} and {info.unit} hold {theirs} and "
                            f"{mine} of drone {drone} (Lemma 2)"
                        )


def same(known: Trajectory, flown: Trajectory, round_: int) -> bool:
    """Whether a trajectory is the flown one, from a round on; at rest, its place is all of it."""
    if known.identity != flown.identity:
        return False
    times = 0.2 * (np.arange(20.0) + round_ - flown.identity.start_round)
    return bool(np.abs(known.positions(times) - flown.positions(times)).max() < 1e-6)


def distances(paths: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """(C, C) least scaled distances of paths (C, S, 3)."""
    out = np.full((len(paths), len(paths)), np.inf)
    scaled = paths * config.inverse_scaling
    for i, path in enumerate(scaled):
        out[i] = np.sqrt(((scaled - path) ** 2).sum(axis=-1).min(axis=-1))
    return out


def spread(rng: np.random.Generator, count: int, config: MlrDmpcConfig) -> FloatArray:
    """(count, 3) random points that keep their distance."""
    points: list[FloatArray] = []
    while len(points) < count:
        point = rng.uniform(*PLACE)
        apart = [np.linalg.norm((point - one) * config.inverse_scaling) for one in points]
        if min(apart, default=1.0) > config.distance_m + 0.02:
            points.append(point)
    return np.array(points)
