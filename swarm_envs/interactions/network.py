"""The models `deep-set` and `pairwise`: ReLU networks of pairs, drones and codes in kernels.

`deep-set` is a heterogeneous deep set (Neural-Swarm2, version 1, eq. 10). The vertical force on
drone i, in grams, is

    rho_I(i)( phi_env(-z, -v) + sum_j w_ij phi_I(j)(p_j - p_i, v_j - v_i) ),

with ReLU networks phi and rho and the window w of the interaction volume. `pairwise` is a sum of
pair forces by small networks, for comparison:

    f_env,I(i)(-z, -v) + sum_j w_ij f_I(j)->I(i)(p_j - p_i, v_j - v_i).

It cannot represent that the downwash of two drones is less than the sum of theirs (Neural-Swarm2,
Sec. VII-C). An *anchored* model subtracts the force on a lone drone at the anchor height with the
same velocity, so that above this height the force on a lone drone is only drag. Inputs are clamped
to the measured range.

Both are lists of steps: a network, its inputs, and the sums to which its outputs are added. A
network is applied to samples of several drones or pairs, also of different environments, at once.
The result for a sample does not depend on the other samples.
"""

from __future__ import annotations

from swarm_envs.compiled import equation, part
from swarm_envs.interactions.composed import add_pushes
from swarm_envs.interactions.packed import (
    ANY,
    BLOCKS,
    DEPTH,
    ENVIRONMENT,
    FIRST_LAYER,
    INPUTS,
    NEIGHBOR,
    OWN,
    SAMPLES,
    SOURCE,
    START,
    TARGET,
    TO_CODES,
    TO_PUSHES,
    UNITS,
    PackedField,
    Scratch,
)
from swarm_envs.state import IntArray
from swarm_envs.tables import Records
from swarm_envs.vehicles import GRAM_FORCE

FREE = 1
"""Slot 2 i is drone i in its state, slot 2 i + 1 the same drone alone at the anchor height."""


@part(fastmath={"contract"})
def network(layout: IntArray, n: int, weights: Records, used: int, rows: Records) -> int:
    """Apply a ReLU network to samples: two at a time, five inputs at a time, all outputs at once.

    Each sum begins with the bias and adds the inputs in order, by fused multiply-adds. Groups of
    inputs that are 0 for both samples are skipped, which does not change the sums: about half of
    them, as units are sorted by their frequency of activity. The first of `rows` have the inputs of
    the `used` samples. Return the index of the first row of outputs.
    """
    source, target = 0, SAMPLES // 2
    for layer in range(layout[n, DEPTH]):
        at = FIRST_LAYER + 3 * layer
        start, units = layout[n, at + START], layout[n, at + UNITS]
        bias = weights[start]["v"]
        for two in range((used + 1) // 2):
            x, y = rows[source + two]["v"], rows[target + two]["v"]
            for o in range(units):
                y[0, o] = bias[0, o]
                y[1, o] = bias[0, o]
            for block in range(layout[n, at + BLOCKS]):
                w, k = weights[start + 1 + block]["v"], INPUTS * block
                a0, a1, a2, a3, a4 = x[0, k], x[0, k + 1], x[0, k + 2], x[0, k + 3], x[0, k + 4]
                b0, b1, b2, b3, b4 = x[1, k], x[1, k + 1], x[1, k + 2], x[1, k + 3], x[1, k + 4]
                if layer > 0 and a0 + a1 + a2 + a3 + a4 + b0 + b1 + b2 + b3 + b4 == 0.0:
                    continue  # these units are inactive
                for o in range(units):
                    w0, w1, w2, w3, w4 = w[0, o], w[1, o], w[2, o], w[3, o], w[4, o]
                    y[0, o] = ((((y[0, o] + w0 * a0) + w1 * a1) + w2 * a2) + w3 * a3) + w4 * a4
                    y[1, o] = ((((y[1, o] + w0 * b0) + w1 * b1) + w2 * b2) + w3 * b3) + w4 * b4
            if layer < layout[n, DEPTH] - 1:
                for o in range(units):
                    y[0, o] = 0.0 if y[0, o] < 0.0 else y[0, o]  # keeps NaN
                    y[1, o] = 0.0 if y[1, o] < 0.0 else y[1, o]
        source, target = target, source
    return source


@equation
def put_pair(field: PackedField, n: int, at: int, scratch: Scratch) -> None:
    """Copy the motion of pair `at` to the next sample, if network `n` is applied to it."""
    counters, pair, own = scratch.counters[0], scratch.pairs[at], field.layout[n, OWN]
    if scratch.drones[pair["j"]]["type"] != field.layout[n, NEIGHBOR]:
        return
    if own == ANY or scratch.drones[pair["i"]]["type"] == own:
        used = counters["used"]
        row = scratch.rows[used // 2]["v"][used % 2]
        for k in range(6):
            row[k] = pair["motion"][k]
        for k in range(6, 2 * INPUTS):
            row[k] = 0.0
        counters["slot"][used], counters["share"][used] = 2 * pair["i"], pair["weight"]
        counters["pair"][used], counters["used"] = at, used + 1


@equation
def put_drone(field: PackedField, n: int, slot: int, scratch: Scratch) -> None:
    """Copy a drone's motion, or its code, to the next sample, if network `n` is applied to it.

    The slot is 2 i for drone i in its state, 2 i + 1 for it alone at the anchor height.
    """
    layout, counters, drone = field.layout, scratch.counters[0], scratch.drones[slot // 2]
    free, own, model = slot % 2, layout[n, OWN], field.constants[0]
    # Read outside of the branch, in which Numba would count references to arrays, with a lock
    anchor, anchor_motion = model["anchor_height"], model["anchor_motion"]
    needed = (own == ANY or drone["type"] == own) and not (free == FREE and anchor == 0.0)
    if layout[n, SOURCE] == ENVIRONMENT and not (free == FREE and layout[n, TARGET] == TO_CODES):
        needed = needed and drone["low"] != 0  # no ground effect above the anchor height
    if needed:
        used = counters["used"]
        row = scratch.rows[used // 2]["v"][used % 2]
        if layout[n, SOURCE] == ENVIRONMENT:
            for k in range(4):
                row[k] = drone["motion"][k]
            row[0], row[4] = anchor_motion if free == FREE else row[0], 0.0
        else:
            code = scratch.rows[SAMPLES + slot // 2]["v"]
            for k in range(INPUTS * layout[n, FIRST_LAYER + BLOCKS]):
                row[k] = code[free, k]
        counters["slot"][used], counters["share"][used], counters["used"] = slot, 1.0, used + 1


@equation
def add_outputs(field: PackedField, n: int, rows: Records, scratch: Scratch) -> None:
    """Add the outputs of network `n` to codes or forces, and clear the counters."""
    counters, hidden = scratch.counters[0], field.constants[0]["hidden"]
    if field.layout[n, TARGET] == TO_PUSHES:
        add_pushes(field.constants[0]["wake_combine"], rows, scratch)
        return
    for s in range(counters["used"]):
        slot, share, output = counters["slot"][s], counters["share"][s], rows[s // 2]["v"]
        drone, free = scratch.drones[slot // 2], slot % 2
        if field.layout[n, TARGET] == TO_CODES:
            code = scratch.rows[SAMPLES + slot // 2]["v"]
            # Above the anchor height, the code of the environment is the same for both slots
            for part in range(free if drone["low"] != 0 else 0, free + 1):
                for k in range(hidden):
                    code[part, k] += share * output[s % 2, k]
        else:
            force = output[s % 2, 0] * GRAM_FORCE
            drone["force"][2] += -force if free == FREE else share * force
    counters["used"] = 0


def pairwise_names(types: tuple[str, ...]) -> list[str]:
    """Return the names of a pairwise model's networks, in the order of the field."""
    pairs = [f"pair.{neighbor}.{ego}" for neighbor in types for ego in types]
    return [*pairs, *(f"environment.{name}" for name in types)]
