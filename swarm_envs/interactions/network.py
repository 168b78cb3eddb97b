"""`learned` and `pairwise`: ReLU networks of pairs, drones and codes, evaluated without torch.

`learned` is a heterogeneous deep set (Neural-Swarm2, eq. 10). The vertical force on drone i, in
grams, is

    rho_I(i)( phi_env(-z, -v) + sum_j w_ij phi_I(j)(p_j - p_i, v_j - v_i) ),

with ReLU networks phi and rho and the window w of the interaction volume. `pairwise` is a sum of
pair forces by small networks, for comparison with it:

    f_env,I(i)(-z, -v) + sum_j w_ij f_I(j)->I(i)(p_j - p_i, v_j - v_i).

It cannot say that two wakes push less than their sum (Neural-Swarm2, Sec. VII-C). An *anchored*
model subtracts what a lone drone would feel at the anchor height with the same velocity: above
that height a lone drone feels nothing, whatever it flies. Inputs are clamped to the measured range.

Both are lists of steps: a network, what it is applied to, and where its outputs are added. Each is
applied to all drones or pairs that need it, several at once, of several environments. A sample
gives the same bits whatever is computed with it, so this never shows.
"""

from __future__ import annotations

from swarm_envs.compiled import equation, kernel
from swarm_envs.interactions.packed import (
    ANY,
    BLOCKS,
    CODES,
    DEPTH,
    ENVIRONMENT,
    FIRST_LAYER,
    INPUTS,
    NEIGHBOUR,
    OWN,
    PAIRS,
    SOURCE,
    START,
    TARGET,
    TO_CODES,
    UNITS,
    PackedField,
    Records,
)
from swarm_envs.interactions.scratch import SAMPLES, Scratch
from swarm_envs.state import IntArray
from swarm_envs.vehicles import GRAM_FORCE

FREE = 1
"""The odd slots: a drone alone at the anchor height. The even ones: as it flies."""


@kernel(fastmath={"contract"})
def network(layout: IntArray, n: int, weights: Records, used: int, rows: Records) -> int:
    """Apply a ReLU network to samples: two at a time, five inputs at a time, all outputs at once.

    Each sum begins with the bias and takes the inputs in their order, by fused multiply-adds.

    Args:
        layout: as in `PackedField`.
        n: which of its networks.
        weights: as in `PackedField`.
        used: how many samples there are. An odd number is filled up by whatever lies there.
        rows: as in `Scratch`; the first of them are the inputs.

    Returns:
        Where the rows of the outputs begin.
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
                for o in range(units):
                    w0, w1, w2, w3, w4 = w[0, o], w[1, o], w[2, o], w[3, o], w[4, o]
                    y[0, o] = ((((y[0, o] + w0 * a0) + w1 * a1) + w2 * a2) + w3 * a3) + w4 * a4
                    y[1, o] = ((((y[1, o] + w0 * b0) + w1 * b1) + w2 * b2) + w3 * b3) + w4 * b4
            if layer < layout[n, DEPTH] - 1:
                for o in range(units):
                    y[0, o] = 0.0 if y[0, o] < 0.0 else y[0, o]  # NaN stays
                    y[1, o] = 0.0 if y[1, o] < 0.0 else y[1, o]
        source, target = target, source
    return source


@equation
def put_pair(field: PackedField, n: int, at: int, scratch: Scratch) -> None:
    """Put pair `at` into the next row, if network `n` is applied to it."""
    measured, desk, pair = field.constants[0]["pair_range"], scratch.desk[0], scratch.pairs[at]
    here, there = scratch.drones[pair["i"]], scratch.drones[pair["j"]]
    own, used = field.layout[n, OWN], desk["used"]
    if there["type"] != field.layout[n, NEIGHBOUR] or not (own == ANY or here["type"] == own):
        return
    two, s, blocks = scratch.rows[used // 2]["v"], used % 2, field.layout[n, FIRST_LAYER + BLOCKS]
    for k in range(3):
        apart = there["position"][k] - here["position"][k]
        moving = there["velocity"][k] - here["velocity"][k]
        two[s, k] = min(max(apart, measured[0, k]), measured[1, k])
        two[s, k + 3] = min(max(moving, measured[0, k + 3]), measured[1, k + 3])
    for k in range(6, INPUTS * blocks):
        two[s, k] = 0.0
    desk["slot"][used], desk["share"][used], desk["used"] = 2 * pair["i"], pair["weight"], used + 1


@equation
def put_drone(field: PackedField, n: int, slot: int, scratch: Scratch) -> None:
    """Put a drone's motion, or its code, into the next row, if network `n` is applied to it.

    Args:
        field: the model.
        n: which of its networks.
        slot: 2 i of drone i as it flies, 2 i + 1 alone at the anchor height.
        scratch: working memory.
    """
    model, desk, drone = field.constants[0], scratch.desk[0], scratch.drones[slot // 2]
    own, source, anchor = field.layout[n, OWN], field.layout[n, SOURCE], model["anchor_height"]
    measured, used, free = model["environment_range"], desk["used"], slot % 2 == FREE
    if source == CODES or (free and field.layout[n, TARGET] == TO_CODES):
        wanted = drone["felt"]
    else:
        wanted = drone["low"]
    if wanted == 0 or (free and anchor == 0.0) or not (own == ANY or drone["type"] == own):
        return
    two, s, blocks = scratch.rows[used // 2]["v"], used % 2, field.layout[n, FIRST_LAYER + BLOCKS]
    if source == ENVIRONMENT:
        height = anchor if free else drone["position"][2]
        two[s, 0] = min(max(-height, measured[0, 0]), measured[1, 0])
        for k in range(1, 4):
            two[s, k] = min(max(-drone["velocity"][k - 1], measured[0, k]), measured[1, k])
        for k in range(4, INPUTS * blocks):
            two[s, k] = 0.0
    else:
        code = scratch.rows[SAMPLES + slot // 2]["v"]
        for k in range(INPUTS * blocks):
            two[s, k] = code[slot % 2, k]
    desk["slot"][used], desk["share"][used], desk["used"] = slot, 1.0, used + 1


@equation
def network_forces(field: PackedField, total: int, scratch: Scratch) -> None:
    """Add the networks' vertical forces on the first `total` drones, whose pairs are known."""
    rows, desk, hidden = scratch.rows, scratch.desk[0], field.constants[0]["hidden"]
    for i in range(total):
        if scratch.drones[i]["felt"] != 0:
            code = rows[SAMPLES + i]["v"]
            for k in range(hidden):
                code[0, k] = code[1, k] = 0.0
    desk["used"] = 0
    for n in range(field.layout.shape[0]):
        of_pairs, to_codes = field.layout[n, SOURCE] == PAIRS, field.layout[n, TARGET] == TO_CODES
        end = desk["pairs"] if of_pairs else 2 * total
        for at in range(end):
            if of_pairs:
                put_pair(field, n, at, scratch)
            else:
                put_drone(field, n, at, scratch)
            used = desk["used"]
            if used < SAMPLES and at < end - 1:
                continue
            result = network(field.layout, n, field.weights, used, rows)
            for s in range(used):
                slot, share, output = desk["slot"][s], desk["share"][s], rows[result + s // 2]["v"]
                drone, free = scratch.drones[slot // 2], slot % 2 == FREE
                if to_codes:
                    code = rows[SAMPLES + slot // 2]["v"]
                    for k in range(hidden):
                        code[slot % 2, k] += share * output[s % 2, k]
                    if free and drone["low"] == 0:  # as it flies, it feels no more of the ground
                        for k in range(hidden):
                            code[0, k] += share * output[s % 2, k]
                else:
                    force = output[s % 2, 0] * GRAM_FORCE
                    drone["force"][2] += -force if free else share * force
            desk["used"] = 0


def pairwise_names(types: tuple[str, ...]) -> list[str]:
    """Names of a pairwise model's networks in a weights file, in the order of the field."""
    pairs = [f"pair.{neighbor}.{ego}" for neighbor in types for ego in types]
    return [*pairs, *(f"environment.{name}" for name in types)]
