"""Speed of the equations in `swarm_envs.reference`: NumPy, JAX and torch, and crazyflow beside.

    python -m benchmarks.reference
    python -m benchmarks.reference --device gpu --environments 1024 4096 16384 65536
    python -m benchmarks.reference --libraries jax torch --precision float32 --json speed.json

An agent-step is one drone flying one decision: 48 a second, on physics at 240 Hz, set-points held.
Four drones hover in each environment, a large one over three small ones; forces are evaluated at
every step, or once a decision (48 Hz) and held. On the CPU, CPU time of one core; on a GPU, wall
time; without compilation. Of libraries that are not installed the table says so.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.peers import ONE_THREAD, RATES, batch_peer_row
from benchmarks.rows import Row, run, spread
from swarm_envs import reference
from swarm_envs.reference import State, step
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of, gains_of
from swarm_envs.state import Setpoint

TEAM, DECISION = "LSSS", 5  # steps of a decision
PLACES = np.array([[0.0, 0.0, 1.6], [0.05, 0.0, 1.2], [-0.2, 0.2, 1.0], [0.2, -0.2, 1.4]])
MODELS: dict[str, Callable[..., Any]] = {
    "none": reference.still_air,
    "wake": reference.wake,
    "learned": reference.learned,
    "deep-set": reference.deep_set,
}
HEAP = {"MALLOC_MMAP_THRESHOLD_": "100000000", "MALLOC_TRIM_THRESHOLD_": "1000000000"}
"""For glibc: large arrays that NumPy frees are kept, not given back to the system at every line."""


def decision(
    name: str, rate: int, repeat: Any, body: Any, gains: Any, air: Any, setpoint: Any
) -> Callable[[State], State]:
    """Return a function that flies a state for one decision, with forces of a model at a rate."""
    forces = MODELS[name] if name == "none" else partial(MODELS[name], air=air)

    def decide(state: State) -> State:
        force = forces if rate == 240 else held(forces(state.position, state.velocity))
        return repeat(lambda state: step(state, setpoint, body, gains, force), state)

    return decide


def repeated(once: Callable[[State], State], state: State) -> State:
    """Apply a step as often as a decision has steps."""
    for _ in range(DECISION):
        state = once(state)
    return state


def repeated_by_jax(once: Callable[[State], State], state: State) -> State:
    """Do the same in a loop that is compiled once, not step by step."""
    import jax

    flown: State = jax.lax.fori_loop(0, DECISION, lambda _, state: once(state), state)
    return flown


def held(force: Any) -> Callable[..., Any]:
    """Return a force that stays, wherever drones are."""
    return lambda position, velocity, points=None: force


def prepared(library: str, device: str, precision: str, envs: int, name: str) -> tuple[Any, ...]:
    """Body, gains, air, set-point and state as arrays of a library, and how to wait for it."""
    start = PLACES + np.random.default_rng(0).normal(0.0, 0.02, (envs, *PLACES.shape))
    made = (
        bodies_of(TEAM),
        gains_of(),
        aerodynamics_of(name, TEAM),
        Setpoint.hold(start),
        reference.hovering(start, bodies_of(TEAM)),
    )
    if library == "jax":
        import jax

        jax.config.update("jax_enable_x64", precision == "float64")
        place = jax.devices(device)[0]
        moved = tuple(converted(x, partial(jax.device_put, device=place), precision) for x in made)
        return *moved, jax.block_until_ready
    if library == "torch":
        import torch

        torch.set_num_threads(1)
        place = torch.device("cuda" if device == "gpu" else "cpu")
        to = partial(torch.asarray, device=place)
        on_gpu = device == "gpu"
        wait = lambda state: torch.cuda.synchronize() if on_gpu else None  # noqa: E731
        return *(converted(x, to, precision) for x in made), wait
    return *(converted(x, lambda array: array, precision) for x in made), lambda state: None


def converted(tree: Any, to: Callable[..., Any], precision: str) -> Any:
    """Every array of a tuple, list or dictionary in another precision, and moved."""
    if isinstance(tree, np.ndarray):
        return to(tree.astype(precision) if tree.dtype == np.float64 else tree)
    if isinstance(tree, dict):
        return {name: converted(value, to, precision) for name, value in tree.items()}
    if isinstance(tree, tuple) and hasattr(tree, "_make"):
        return type(tree)._make(converted(value, to, precision) for value in tree)
    if isinstance(tree, tuple | list):
        return type(tree)(converted(value, to, precision) for value in tree)
    return tree


def library_row(options: argparse.Namespace, library: str, name: str, rate: int, envs: int) -> Row:
    """Agent-steps per second of a library."""
    what = f"{library}, {options.precision}, {name}"
    counts = {"environments": envs, "drones": len(TEAM), "force_rate": rate}
    row: Row = {"what": what, **counts, "unit": "agent-steps/s"}
    if importlib.util.find_spec(library) is None:
        return row | {"value": None, "note": "not installed"}
    *numbers, state, wait = prepared(library, options.device, options.precision, envs, name)
    decide = decision(name, rate, repeated_by_jax if library == "jax" else repeated, *numbers)
    if library == "jax":
        import jax

        decide = jax.jit(decide)
    with without_gradients(library):
        state = decide(state)
        wait(state)
        clock = time.process_time if options.device == "cpu" else time.perf_counter
        rates = []
        for _ in range(options.repetitions):
            begin, count = clock(), 0
            while clock() - begin < 0.5:
                state = decide(state)
                wait(state)
                count += 1
            rates.append(envs * len(TEAM) * count / (clock() - begin))
    return row | spread(rates)


def without_gradients(library: str) -> Any:
    """Return a context in which torch records nothing."""
    if library != "torch":
        return contextlib.nullcontext()
    import torch

    return torch.no_grad()


def rows(options: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured, in the order of the table."""
    for envs in options.environments:
        for library in options.libraries:
            for name in options.forces:
                for rate in (240, 48) if name != "none" else (240,):
                    yield library_row(options, library, name, rate, envs)
    if options.peers:
        for rates in RATES:
            for envs in options.environments:
                yield batch_peer_row(options.peers, rates, envs, len(TEAM), options.repetitions)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add what only this benchmark takes."""
    parser.add_argument("--device", default="cpu", choices=("cpu", "gpu"), help="of JAX and torch")
    parser.add_argument("--environments", type=int, nargs="+", default=[1024], help="of 4 drones")
    parser.add_argument("--precision", default="float64", choices=("float64", "float32"), help=" ")
    libraries = ("numpy", "jax", "torch")
    parser.add_argument("--libraries", nargs="+", default=libraries, choices=libraries, help=" ")
    parser.add_argument("--forces", nargs="+", default=list(MODELS), choices=MODELS, help=" ")
    parser.add_argument("--peers", help="interpreter that has crazyflow, on the CPU")


if __name__ == "__main__":
    if "MALLOC_TRIM_THRESHOLD_" not in os.environ:  # read when a process begins
        one = ONE_THREAD | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        again = [sys.executable, "-m", "benchmarks.reference", *sys.argv[1:]]
        os.execve(sys.executable, again, os.environ | one | HEAP)
    run(__doc__, rows, repetitions=5, configure=configure)
