"""Rounds of MLR-DMPC without a network: every message arrives, every compute unit knows all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import HalfSpaces, Neighbors
from swarm_envs.baselines.mlr_dmpc.condensed_qp import condensed
from swarm_envs.baselines.mlr_dmpc.deadlock import SwarmSnapshot, next_detours, no_detours
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, hover
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import Planned, plan_trajectory
from swarm_envs.state import BoolArray, FloatArray, IntArray

PlanesFor = Callable[[Trajectory, int], HalfSpaces]
Situation = tuple[Trajectory, int, Neighbors, FloatArray]


class Rounds:
    """A swarm whose plans of round k are flown from round k + 1.

    Until a drone has said in round k + 1 that it flies a new plan, the old one is a candidate too,
    and the drone is not planned again. Compute units take the M highest hybrid priorities.
    """

    def __init__(
        self,
        starts: FloatArray,
        targets: FloatArray,
        compute_units: int,
        config: MlrDmpcConfig,
        seed: int = 0,
        solver: str = "daqp",
        planes_for: PlanesFor | None = None,
    ) -> None:
        self.config = config = config.for_swarm(len(starts))
        self.compute_units, self.solver = compute_units, solver
        self.targets, self.planes_for = np.array(targets), planes_for
        still = (config.num_inputs, config.input_sampling_s)
        self.candidates: list[list[Trajectory]] = [[hover(p, *still)] for p in starts]
        self.round = 0
        self.detours = no_detours(len(starts))
        self.rng = np.random.default_rng(seed)
        self.planned: list[Planned] = []
        self._planned_in = np.full(len(starts), -5)
        self._priority = np.ones(len(starts))

    def step(self) -> None:
        """Fly one round."""
        self.detours = next_detours(
            self.detours, self.snapshot(), self.round, self.config, self.rng
        )
        chosen = np.argsort(-self._priority, kind="stable")[: self.compute_units]
        chosen = np.array([i for i in chosen if len(self.candidates[i]) == 1], dtype=int)
        self._priority = self._hybrid()
        known, plans = self.known(chosen), {}
        for unit, i in enumerate(chosen):
            plans[i] = self.plan(i, unit, known)
        self.planned += plans.values()
        self.candidates = [candidates[-1:] for candidates in self.candidates]
        for i, plan in plans.items():
            self._priority[i], self._planned_in[i] = 0.0, self.round
            if plan.accepted:
                self.candidates[i].append(plan.trajectory)
        self.round += 1

    def plan(self, i: int, unit: int, known: Neighbors, solver: str = "") -> Planned:
        """The plan of drone i from the next round on; `known` may hold the drone itself."""
        own, target = self.candidates[i][0], self.detours.current(self.targets)[i]
        start = self.round + 1
        planes = [self.planes_for(own, start)] if self.planes_for else []
        return plan_trajectory(
            own,
            start,
            unit,
            others(known, i),
            target,
            self.config,
            solver or self.solver,
            planes,
        )

    def known(self, chosen: IntArray) -> Neighbors:
        """All candidates of all drones from the next round on."""
        times = condensed(self.config).collision_times
        drone = np.repeat(np.arange(len(self.candidates)), [len(c) for c in self.candidates])
        since = [
            self.config.round_s * (self.round + 1 - t.identity.start_round)
            for candidates in self.candidates
            for t in candidates
        ]
        flat = [t for candidates in self.candidates for t in candidates]
        positions = [t.positions(s + times) for t, s in zip(flat, since, strict=True)]
        return Neighbors(np.array(positions), drone, np.isin(drone, chosen % len(self.candidates)))

    def snapshot(self) -> SwarmSnapshot:
        """The swarm at the beginning of the round."""
        states, ends = [], []
        for candidates in self.candidates:
            begun = [t for t in candidates if t.identity.start_round <= self.round][-1]
            since = self.config.round_s * (self.round - begun.identity.start_round)
            states.append(begun.states(np.array([since]))[0])
            ends.append(candidates[-1].positions(np.array([candidates[-1].duration_s]))[0])
        state = np.array(states)
        return SwarmSnapshot(state[:, 0], state[:, 1], np.array(ends), self.targets)

    def situation(self) -> Situation:
        """What the first drone that may be planned flies, the next round, the others, its target.

        Every second one of the others is planned at the same time.
        """
        i = next(i for i, known in enumerate(self.candidates) if len(known) == 1)
        known = others(self.known(np.arange(i, i + len(self.candidates), 2)), i)
        return self.candidates[i][0], self.round + 1, known, self.targets[i]

    def arrived(self) -> BoolArray:
        """(N,) who is at the target."""
        away = np.linalg.norm(self.snapshot().positions - self.targets, axis=1)
        return away <= self.config.arrival_m

    def run(self, limit_s: float, each: Callable[[Rounds], None] | None = None) -> float:
        """Fly until all have arrived; how long that took, or infinity, s."""
        begin = self.round
        while (time := self.config.round_s * (self.round - begin)) < limit_s:
            if self.arrived().all():
                return time
            self.step()
            if each:
                each(self)
        return np.inf

    def _hybrid(self) -> FloatArray:
        swarm = self.snapshot()
        away = np.linalg.norm(self.detours.current(self.targets) - swarm.ends, axis=1)
        return away * (self.round - self._planned_in)


def others(known: Neighbors, i: int) -> Neighbors:
    """What all drones but i may fly."""
    keep = known.drone != i
    return Neighbors(known.positions[keep], known.drone[keep], known.concurrent[keep])


def least_distance(known: Neighbors, config: MlrDmpcConfig) -> float:
    """Least scaled distance of two candidates of different drones at any sample, m."""
    scaled = known.positions * config.inverse_scaling
    least = np.inf
    for c, drone in enumerate(known.drone):
        other = scaled[known.drone > drone]
        distance = np.linalg.norm(other - scaled[c], axis=-1)
        least = min(least, float(distance.min(initial=np.inf)))
    return least


def keep_clear(swarm: Rounds) -> None:
    """All that any drone may fly is apart, to the end of every plan; every plan was feasible."""
    assert (
        least_distance(swarm.known(np.zeros(0, dtype=np.int64)), swarm.config)
        >= swarm.config.distance_m - 1e-6
    )
    for planned in swarm.planned:
        assert planned.shifted_slack >= -1e-6
    swarm.planned.clear()


def circle(n: int, radius: float = 1.5, height: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Starts (n, 3) on a circle, and the opposite places as targets, m."""
    angle = 2.0 * np.pi * np.arange(n) / n
    starts = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, height)], axis=1)
    return starts, starts * [-1.0, -1.0, 1.0]


def scattered(
    n: int, config: MlrDmpcConfig, rng: np.random.Generator, spacing: float = 0.3
) -> FloatArray:
    """Places (n, 3) in the box, no two nearer than a scaled spacing, m."""
    lower, upper = np.array(config.box)
    places: list[FloatArray] = []
    while len(places) < n:
        place = rng.uniform(lower + 0.1, upper - 0.1)
        between = (np.array(places).reshape(-1, 3) - place) * config.inverse_scaling
        if not (np.linalg.norm(between, axis=1) < spacing).any():
            places.append(place)
    return np.array(places)


def situation(
    seed: int, rounds: int, n: int, config: MlrDmpcConfig, compute_units: int = 2
) -> Situation:
    """A drone in a swarm under way: what it flies, the next round, the others, its target."""
    rng = np.random.default_rng(seed)
    swarm = Rounds(
        scattered(n, config, rng), scattered(n, config, rng), compute_units, config, seed
    )
    while swarm.round < rounds or all(len(known) == 2 for known in swarm.candidates):
        swarm.step()
    return swarm.situation()
