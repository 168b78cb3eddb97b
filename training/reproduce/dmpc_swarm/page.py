"""A flight of references as a recording, for the replay page."""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.training.reproduce.dmpc_swarm.flights import Flight
from swarm_envs.vehicles import SMALL
from swarm_envs.viewing.record import About, Recording


def recording(flight: Flight, config: MlrDmpcConfig, about: str, seed: int) -> Recording:
    """References as if they had been flown without error: level, in still air.

    Args:
        flight: what to show.
        config: its box is drawn as the arena.
        about: how it was run, such as `3 CUs, HT`.
        seed: of the run.
    """
    shape = flight.position.shape
    level = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*shape[:2], 4)).copy()
    step = float(flight.time[1] - flight.time[0])
    nobody = np.full(shape[:2], -1, dtype=np.int64)
    never = np.zeros(shape[:2], dtype=bool)
    return Recording(
        team=(SMALL,) * shape[1],
        time=flight.time,
        position=flight.position,
        quaternion=level,
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
            arena=config.box,
            solids=(),
            metrics={},
        ),
    )
