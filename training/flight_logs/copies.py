"""Copies: the same numbers in two files would put training rows into the held-out ones."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.training.flight_logs.drone import DroneLog
from swarm_envs.training.interaction_rows import InteractionRows


def flight_key(drones: Iterable[DroneLog]) -> str:
    """What a flight and its copies share: motion and signals of its drones.

    Names, origin of time, the order of the drones and digits beyond float32 make no difference.
    """
    keys = (_digest(d.position, d.velocity, d.quaternion, d.pwm) for d in drones)
    return hashlib.sha256("".join(sorted(keys)).encode()).hexdigest()


def table_key(rows: InteractionRows) -> str:
    """What a table and its copies share: inputs by step, without labels and marks."""
    parts = (rows.position, rows.velocity, rows.neighbor, rows.neighbor_type, rows.step)
    inputs = np.concatenate([_single(part).reshape(len(rows), -1) for part in parts], axis=1)
    return _digest(inputs[np.lexsort(inputs.T)])


def refuse_copy(known: dict[str, str], key: str, name: str) -> None:
    """Remember a sound file by its key; refuse one whose key an earlier file has.

    Raises:
        ValueError: naming both files.
    """
    first = known.setdefault(key, name)
    if first != name:
        raise ValueError(
            f"{name} is a copy of {first}: the same numbers stand in both, but rows that are held "
            "out may not be trained on; remove one of them"
        )


def _single(values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    return np.asarray(values, dtype=np.float32) + np.float32(0.0)  # no negative zeros


def _digest(*arrays: npt.NDArray[Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(_single(array)).tobytes())
    return digest.hexdigest()
