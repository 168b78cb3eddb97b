"""Flights of DMPC-Swarm's experiments: a swarm of references through a sequence of targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, circle_swap, formation
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import SMALL
from swarm_envs.viewing.record import About, Recording

DRONES = 16
"""As in the paper."""
CRASH_M = 0.12
"""Scaled distance at which the paper counts a crash, m."""
_SEQUENCE_LIMIT_S, _CIRCLE_LIMIT_S = 120.0, 60.0  # when a flight is given up
_RADIUS_M, _HEIGHT_M = 1.5, 1.0  # of the circle
_SAMPLES = 10  # instants kept of each round


@dataclass(frozen=True, kw_only=True)
class SwarmSetup:
    """How a swarm is run."""

    compute_units: int = 3
    """M."""
    trigger: str = "HT"
    """`HT`, `RR` or `DT`."""
    loss: LossModel | float = 0.0
    """Of messages."""
    recovery: bool | str = True
    """As for `simulate`."""
    seed: int = 0
    """Of losses and detours."""


@dataclass(frozen=True)
class ReferenceFlight:
    """What the references of N drones did. T samples, a fiftieth of a second apart."""

    time: FloatArray
    """(T,) s."""
    position: FloatArray
    """(T, N, 3) m."""
    target: FloatArray
    """(T, N, 3) m."""
    arrivals_s: tuple[float, ...]
    """When all had arrived at each formation that they reached."""
    wanted: int
    """Formations to reach."""
    scaled_distance: FloatArray
    """(T,) least scaled distance of any two references, m."""

    @property
    def total_s(self) -> float | None:
        """When the last formation was reached, s; None if it was not."""
        return self.arrivals_s[-1] if len(self.arrivals_s) == self.wanted else None

    @property
    def legs_s(self) -> list[float]:
        """Time for each formation reached, s."""
        return [float(leg) for leg in np.diff([0.0, *self.arrivals_s])]


def fly_sequence(setup: SwarmSetup) -> ReferenceFlight:
    """Plane, pyramid, cube, sphere and plane (Fig. 3a) by 16 drones."""
    places = [formation(name, DRONES) for name in SEQUENCE]
    return fly_references(places[0], places[1:], setup, _SEQUENCE_LIMIT_S, MlrDmpcConfig())


def fly_circle(setup: SwarmSetup) -> ReferenceFlight:
    """Each of 16 drones to the opposite side of a circle."""
    starts, targets = circle_swap(DRONES, _RADIUS_M, _HEIGHT_M)
    return fly_references(starts, [targets], setup, _CIRCLE_LIMIT_S, MlrDmpcConfig())


def fly_references(
    starts: FloatArray,
    formations: Sequence[FloatArray],
    setup: SwarmSetup,
    limit_s: float,
    config: MlrDmpcConfig,
) -> ReferenceFlight:
    """Fly from one formation to the next, each begun in the round after the last was reached.

    Args:
        starts: (N, 3) m.
        formations: targets (N, 3), m, in order.
        setup: how the swarm is run.
        limit_s: when to give up, s.
        config: parameters.
    """
    swarm = MlrDmpcSwarm(starts, formations[0], config=config, **vars(setup))
    since = np.arange(_SAMPLES, dtype=np.float64) * (config.round_s / _SAMPLES)
    positions: list[FloatArray] = []
    targets: list[FloatArray] = []
    arrivals: list[float] = []
    for k in range(round(limit_s / config.round_s)):
        target = formations[len(arrivals)]
        flown = swarm.reference(since)[:, :, 0].transpose(1, 0, 2)
        positions.append(flown)
        targets.append(np.broadcast_to(target, flown.shape))
        away = np.linalg.norm(flown - target, axis=-1).max(axis=-1)
        near = np.flatnonzero(away <= config.arrival_m)
        if len(near):
            arrivals.append(k * config.round_s + float(since[near[0]]))
            if len(arrivals) == len(formations):
                break
        swarm.run_round(targets=formations[len(arrivals)])
    position = np.concatenate(positions)
    time = np.arange(len(position), dtype=np.float64) * (config.round_s / _SAMPLES)
    first, second = np.triu_indices(position.shape[1], 1)
    apart = (position[:, first] - position[:, second]) * config.inverse_scaling
    closest = np.asarray(np.linalg.norm(apart, axis=-1).min(axis=-1))
    reached, wanted = tuple(arrivals), len(formations)
    return ReferenceFlight(time, position, np.concatenate(targets), reached, wanted, closest)


def recording_of(flight: ReferenceFlight, about: str, seed: int) -> Recording:
    """References as if they had been flown without error, level and in still air, for a replay.

    Args:
        flight: what to show.
        about: how it was run, such as `3 CUs, HT`.
        seed: of the run.
    """
    shape = flight.position.shape
    step = float(flight.time[1] - flight.time[0])
    nobody = np.full(shape[:2], -1, dtype=np.int64)
    never = np.zeros(shape[:2], dtype=bool)
    return Recording(
        team=(SMALL,) * shape[1],
        time=flight.time,
        position=flight.position,
        quaternion=np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*shape[:2], 4)).copy(),
        reference=flight.target,
        force=np.zeros(shape),
        velocity=np.gradient(flight.position, step, axis=0),
        rotor_thrust=np.zeros((*shape[:2], 4)),
        goal=flight.target,
        setpoint=flight.position,
        contact_drone=nobody,
        contact_floor=never,
        contact_wall=never,
        contact_obstacle=nobody,
        tumbling=never,
        reward=np.full(shape[:2], np.nan),
        reward_terms={},
        about=About(
            task=f"mlr-dmpc, {about}",
            agent="references",
            seed=seed,
            physics="no",
            decision_rate=round(1.0 / step),
            arena=MlrDmpcConfig().box,
            solids=(),
            metrics={},
        ),
    )
