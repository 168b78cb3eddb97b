"""Whatever is lost, whoever crashes: nobody collides, and the paper's lemmas hold in each round."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import RecoveryNodes
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound, UnitOutage
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, positions_from
from swarm_envs.files import write_json
from swarm_envs.state import FloatArray
from tests.helpers.mlr_rounds import scattered

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
    trigger: str = "WT"

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
            "trigger": str(rng.choice(["WT", "HT", "RR", "DT"])),
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
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, PLACE),
            scattered(self.drones, config, rng, config.sampled_distance_m + 0.01, PLACE),
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
            before = [(drone.flying, drone.view.id) for drone in swarm.nodes.drones]
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
            paths += [positions_from(one, round_ + 1, config) for one in may]
        gap = distances(np.array(paths), config)
        gap[np.equal.outer(owner, owner)] = np.inf
        least = float(gap.min(initial=np.inf))
        self.least = min(self.least, least)
        if least < config.sampled_distance_m - TOLERANCE:
            i, j = np.unravel_index(np.argmin(gap), gap.shape)
            self.broken.append(
                f"round {round_}: drones {owner[i]} and {owner[j]} may come to {least:.6f} m"
            )

    def _lemmas(self, nodes: RecoveryNodes, round_: int, before: list[tuple]) -> None:
        equal: dict[tuple, tuple[int, list]] = {}
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
                            f"flies {flown.identity} (Lemma 1)"
                        )
                if trackers.up_to_date(round_)[drone] and lock == info.view.id:
                    self.up_to_date += 1
                    mine = [one.identity for one in candidates]
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


FAILURE = Path(tempfile.gettempdir()) / "mlr-dmpc-failure.json"
"""Where the last failing instance lies, after shrinking the simplest one."""
WHO = st.sampled_from(["all", "units", "drones", "unit 0", "drone 1"])


def intervals(most: int) -> st.SearchStrategy[tuple[int, int]]:
    lengths = st.tuples(st.integers(0, most), st.integers(0, 15))
    return lengths.map(lambda pair: (pair[0], pair[0] + pair[1]))


@st.composite
def instances(draw, recovery: bool | str = True) -> Instance:
    drones = draw(st.integers(4, 10))
    units = draw(st.integers(1, min(drones, 4)))
    jams = draw(st.lists(st.tuples(intervals(20), WHO, WHO), max_size=2))
    outages = draw(st.lists(st.tuples(st.integers(0, units - 1), intervals(20)), max_size=2))
    ours = recovery is True
    joins = draw(st.lists(st.integers(0, 12), max_size=1)) if ours else []
    leaves = draw(st.lists(st.integers(0, 20), max_size=1)) if ours else []
    return Instance(
        draw(st.integers(0, 10_000)),
        drones,
        units,
        draw(st.floats(0.0, 0.6)),
        draw(st.floats(0.0, 0.6)),
        tuple((a, b, s, r) for (a, b), s, r in jams),
        tuple((unit, a, b) for unit, (a, b) in outages),
        tuple((drones - 1, k) for k in joins),
        tuple((0, k) for k in leaves),
        draw(st.booleans()),
        30,
        recovery,
        draw(st.sampled_from(["WT", "HT", "RR", "DT"])),
    )


def hold(instance: Instance) -> None:
    """Fly an instance; if anything breaks, keep it to be replayed."""
    try:
        found = instance.run()
        broken = found.broken[:5]
    except Exception:
        instance.write(FAILURE)
        raise
    if broken:
        instance.write(FAILURE)
    assert not broken, f"{broken}; replay with Instance.read({str(FAILURE)!r}).run()"


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(instance=instances())
def test_no_loss_brings_drones_together(instance):
    hold(instance)


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(instance=instances(recovery="paper"))
def test_nor_with_the_papers_own_recovery(instance):
    hold(instance)


def test_without_recovery_the_same_check_finds_collisions():
    broken = [
        Instance.random(seed, recovery=False, joins=(), leaves=(), rounds=15).run().broken
        for seed in (2, 6)
    ]
    assert all("may come to" in "".join(one) for one in broken)


def test_a_failing_instance_can_be_replayed_from_its_file(tmp_path):
    instance = Instance.random(2, recovery=False, joins=(), leaves=(), rounds=8)
    instance.write(tmp_path / "failure.json")
    again = Instance.read(tmp_path / "failure.json")
    assert again == instance
    assert again.run().broken == instance.run().broken != []


def test_the_invariants_are_about_something():
    """Lemmas checked on trackers that claim nothing would hold for any protocol."""
    found = Instance.random(3, loss=0.1, drone_loss=0.1, jams=(), outages=(), joins=()).run()
    assert found.covering > 300 and found.up_to_date > 200 and found.accepted > 10


@pytest.mark.slow
def test_two_thousand_random_instances_are_safe():
    """4 to 16 drones; where SWARM_ENVS_INSTANCES says so, more or fewer."""
    plans = failures = 0
    least = np.inf
    for seed in range(int(os.environ.get("SWARM_ENVS_INSTANCES", "2000"))):
        instance = Instance.random(seed)
        found = instance.run()
        if found.broken:
            instance.write(FAILURE)
        assert not found.broken, (instance, found.broken[:5])
        plans, failures = plans + found.plans, failures + found.failures
        least = min(least, found.least)
    assert least >= MlrDmpcConfig().sampled_distance_m - TOLERANCE
    assert failures < 1e-3 * plans
