"""Files of simulated flights: npz without pickle, in single precision."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.training.collection.log import FlightLog


def flight_file(out: Path, name: str) -> Path:
    """Return the file of a flight."""
    return out / f"{name}.npz"


def save_log(path: Path, log: FlightLog) -> None:
    """Write a log, atomically."""
    arrays = {name: array.astype(np.float32) for name, array in log._asdict().items()}
    with written_whole(path) as partial:
        np.savez(partial, allow_pickle=False, **arrays)


def read_log(path: Path) -> FlightLog:
    """Read a file that `save_log` wrote.

    Raises:
        FileNotFoundError: there is none.
    """
    with np.load(path, allow_pickle=False) as file:
        return FlightLog(*(file[name].astype(np.float64) for name in FlightLog._fields))
