"""The loops over lanes are vector instructions; what breaks that is silent, but for this test."""

from __future__ import annotations

import platform
import re
from typing import Any

import numba
import numpy as np
import pytest

from swarm_envs.control.adaptation import filter_residual, find_residual, learn_last_layer
from swarm_envs.control.loop import hold_rates, track
from swarm_envs.interactions import load
from swarm_envs.interactions.forces import swarm_forces
from swarm_envs.interactions.packed import scratch_for
from swarm_envs.physics.contact import SPOT_TYPE, find_pairs, touch
from swarm_envs.physics.hall_lanes import disturb, estimate, see
from swarm_envs.physics.rigid_body import integrate, spin_rotors
from swarm_envs.tables import BLOCK_TYPE, LANES, SETTINGS_TYPE, aligned

pytestmark = [
    pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled"),
    pytest.mark.skipif(
        platform.machine().lower() not in ("x86_64", "amd64"), reason="reads x86 instructions"
    ),
]
_ARITHMETIC = r"\bv?(?:add|sub|mul|div|sqrt|fm\w+?)(p|s)d\b"


def compiled(part: Any, *arguments: Any) -> Any:
    """A part, compiled here for these arguments: code from the cache cannot be read."""
    names = ", ".join(f"a{k}" for k in range(len(arguments)))
    call = eval(f"lambda {names}: part({names})", {"part": part})
    kernel = numba.njit(error_model="numpy")(call)
    kernel(*arguments)
    return kernel


def instructions(part: Any, *arguments: Any) -> tuple[int, int]:
    """Packed and scalar instructions of double arithmetic of a part, compiled for arguments."""
    code = compiled(part, *arguments).inspect_asm()
    found = re.findall(_ARITHMETIC, "\n".join(code.values()))
    return found.count("p"), found.count("s")


def blocks() -> Any:
    memory = aligned(2, BLOCK_TYPE)
    for name in BLOCK_TYPE.names or ():
        memory[name] = 1 if name == "stream" else 0.5
    memory["setpoint_yaw"] = 0.0
    return memory


SETTINGS, ONES = np.zeros(1, SETTINGS_TYPE), np.ones(1, SETTINGS_TYPE)


@pytest.mark.parametrize(
    ("part", "given", "least", "scalar_share"),
    [
        *((part, (), 15, 0.02) for part in (spin_rotors, integrate, see)),
        *((part, (SETTINGS,), 15, 0.1) for part in (hold_rates, touch)),
        # But for the yaw: sine and cosine, which are left out where no set-point yaws.
        *((track, (SETTINGS, adaptive), 15, 0.1) for adaptive in (None, True)),
        *((part, (SETTINGS,), 15, 0.1) for part in (find_residual, filter_residual)),
        (learn_last_layer, (SETTINGS,), 15, 0.1),
        (disturb, (ONES, True), 30, 0.15),  # random numbers included
        (estimate, (ONES,), 30, 0.15),
    ],
)
def test_loops_over_lanes_are_vector_instructions(part, given, least, scalar_share):
    packed, scalar = instructions(part, blocks(), 2, *given)
    assert packed >= least
    assert scalar <= scalar_share * packed


def test_pairs_of_environments_are_compared_side_by_side():
    packed, _ = instructions(find_pairs, blocks(), 4, 4, aligned(4, SPOT_TYPE))
    assert packed >= 8  # scalar ones do the environments that are left over


@pytest.mark.parametrize("name", ["learned", "deep-set"])
def test_forces_count_few_references(name):
    """Numba counts references to arrays that are found in a branch, by an atomic instruction each.

    In the loop over samples that doubles the time of the forces. What stays is outside of loops,
    or in the sweep of many drones.
    """
    field = load(name).packed
    code = compiled(swarm_forces, field, 1, 2, None, scratch_for(field, 1, 2)).inspect_llvm()
    functions = re.split(r"^define ", "".join(code.values()), flags=re.MULTILINE)
    # `swarm_forces` is inlined into the lambda of `compiled`.
    body = next(each for each in functions if "i32 @" in each[:60] and "clambda" in each[:200])
    assert body.count("@NRT_incref(") <= 12


def test_a_row_of_a_block_is_a_cache_line():
    assert all(place[1] % 64 == 0 for place in (BLOCK_TYPE.fields or {}).values())
    assert LANES * 8 == 64
    assert aligned(3, BLOCK_TYPE).ctypes.data % 64 == 0
