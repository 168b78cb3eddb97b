"""Speed of the interaction forces, and of the same networks in torch.

    make bench
    python -m benchmarks.forces --json forces.json

CPU time of one thread, median of repetitions, the weights of `deep-set`, small and large drones
in turn, every pair inside the interaction volume, all above the anchor height. `kernel` is the
compiled function, called from Python; `forces` is the model's method, with all its checks.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.against_worker import cpu_seconds
from benchmarks.rows import Row, run, spread
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.forces import all_forces
from swarm_envs.vehicles import parse_team

Array = npt.NDArray[Any]

SIZES = ((1, 4), (1, 16), (1024, 4))  # environments, and drones in each
LEAST_SECONDS = 0.05  # each repetition calls as often as fills this time


def states(num_envs: int, num_drones: int) -> tuple[Array, Array]:
    """Positions (m) and velocities (m/s), (E, N, 3), of drones that all feel each other."""
    rng = np.random.default_rng(0)
    shape = (num_envs, num_drones, 3)
    position = rng.uniform([-0.12, -0.12, 0.8], [0.12, 0.12, 1.4], shape)
    return position, rng.normal(0.0, 0.3, shape)


def team_of(num_drones: int) -> str:
    """Small and large drones in turn."""
    return ("SL" * num_drones)[:num_drones]


def torch_forces(dtype: str, position: Array, velocity: Array, team: str) -> Callable[[], Any]:
    """A call of the trained network in torch."""
    import torch

    from swarm_envs.training.force_model import load_network
    from tests.helpers.torch_swarms import swarm_force_g

    torch.set_num_threads(1)
    weights = resources.files("swarm_envs.interactions").joinpath("weights/deep-set.safetensors")
    with resources.as_file(weights) as path:
        network = load_network(path).to(getattr(torch, dtype))
    p, v = (torch.from_numpy(a).to(getattr(torch, dtype)) for a in (position, velocity))
    types = [vehicle.interaction_type for vehicle in parse_team(team)]

    def call() -> Any:
        with torch.no_grad():
            return swarm_force_g(network, p, v, types)

    return call


def kernel_forces(model: InteractionModel, position: Array, velocity: Array, team: str) -> Any:
    """A call of the compiled function itself."""
    indices = model.type_indices(parse_team(team))
    types, out = np.repeat(indices[None], len(position), axis=0), np.empty_like(position)

    def call() -> Array:
        all_forces(model.packed, types, position, velocity, out)
        return out

    return call


def force_row(way: str, dtype: str, num_envs: int, num_drones: int, repetitions: int) -> Row:
    """Microseconds of one evaluation of all environments."""
    row: Row = {"what": f"{way}, {dtype}", "environments": num_envs, "drones": num_drones}
    row["unit"] = "us"
    if way == "torch" and importlib.util.find_spec("torch") is None:
        return row | {"value": None, "note": "not installed"}
    position, velocity = states(num_envs, num_drones)
    team, model = team_of(num_drones), load("deep-set").with_precision(dtype)
    calls: dict[str, Callable[[], Callable[[], Any]]] = {
        "kernel": lambda: kernel_forces(model, position, velocity, team),
        "forces": lambda: partial(model.forces, position, velocity, team),
        "torch": lambda: torch_forces(dtype, position, velocity, team),
    }
    call = calls[way]()
    call()
    times = max(1, int(LEAST_SECONDS / max(cpu_seconds(call, 1), 1e-6)))
    found = [1e6 * cpu_seconds(call, times) for _ in range(repetitions)]
    return row | spread(found)


def rows(options: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured, in the order of the table."""
    ways = [("kernel", "float64"), ("kernel", "float32"), ("forces", "float64")]
    ways += [("torch", "float64"), ("torch", "float32")]
    for envs, drones in SIZES:
        for way, dtype in ways:
            yield force_row(way, dtype, envs, drones, options.repetitions)


if __name__ == "__main__":
    run(__doc__, rows, repetitions=15)
