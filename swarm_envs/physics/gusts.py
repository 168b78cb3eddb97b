"""Gusts: an acceleration that all drones of an environment share, wandering at random."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.noise import normal
from swarm_envs.state import FloatArray


class Gusts(NamedTuple):
    """An Ornstein-Uhlenbeck process per environment, exactly discretised."""

    blow: bool
    """Whether there are any."""
    kept: float
    """Share of the acceleration that is left after one physics step: exp(-dt / correlation)."""
    strength: float
    """Standard deviation of each component, m/s^2."""
    acceleration: FloatArray
    """(E, 3) now, m/s^2, world frame."""
    key: npt.NDArray[np.uint64]
    """(E,) stream of its random numbers."""


def new_gusts(num_envs: int, strength: float, correlation_s: float, dt: float) -> Gusts:
    """Gusts that begin as still air.

    Args:
        num_envs: E.
        strength: standard deviation of each component, m/s^2; 0 for none.
        correlation_s: time over which gusts change, s.
        dt: a physics step, s.
    """
    return Gusts(
        blow=strength > 0.0,
        kept=float(np.exp(-dt / correlation_s)),
        strength=float(strength),
        acceleration=np.zeros((num_envs, 3)),
        key=np.zeros(num_envs, np.uint64),
    )


@borrowing_kernel
def gust(e: int, step: int, gusts: Gusts, mass: FloatArray, out: FloatArray) -> None:
    """Advance the gusts of environment `e` by a step and write the force on its drones.

    Args:
        e: the environment.
        step: physics steps since its reset, from 1.
        gusts: changed in place.
        mass: (E, N) kg.
        out: (E, N, 3) force, N, world frame; written in environment e.
    """
    if gusts.blow:
        fresh = gusts.strength * np.sqrt(1.0 - gusts.kept * gusts.kept)
        for k in range(3):
            drawn = normal(gusts.key[e], np.uint64(3 * step + k))
            gusts.acceleration[e, k] = gusts.kept * gusts.acceleration[e, k] + fresh * drawn
            for i in range(mass.shape[1]):
                out[e, i, k] = mass[e, i] * gusts.acceleration[e, k]
