"""`pairwise`: a sum of pair forces by small networks, for comparison with the deep set.

The vertical force on drone i, in grams, is

    f_env,I(i)(-z, -v) + sum_j w_ij f_I(j)->I(i)(p_j - p_i, v_j - v_i),

with ReLU networks f and the window w of the interaction volume. Anchor and clamps are the deep
set's. What it cannot say is that two wakes push less than their sum (Neural-Swarm2, Sec. VII-C).
"""

from __future__ import annotations

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.interactions.blocks import Scratch, network, put_environment, put_pair
from swarm_envs.interactions.field import ForceField
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE


@borrowing_kernel
def add_forces(field: ForceField, n: int, count: int, scratch: Scratch, out: FloatArray) -> None:
    """Apply network `n` to `count` lanes and add each force, times its share, to its drone's."""
    layers = scratch.layers
    result = network(field, n, count, layers)
    for lane in range(count):
        force = layers[result, 0, lane] * GRAM_FORCE
        out[scratch.place[0, lane], 2] += scratch.share[lane] * force


@borrowing_kernel
def add_pairs(
    field: ForceField,
    kinds: tuple[int, int],
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Add the forces of neighbours of the first of two types on drones of the second."""
    pairs, layers = scratch.pairs, scratch.layers
    neighbour, own = kinds
    n, lane = neighbour * field.drag.shape[0] + own, 0
    for pair in range(scratch.found[0]):
        i, j = pairs[0, pair], pairs[1, pair]
        if types[i] != own or types[j] != neighbour:
            continue
        put_pair(field.pair_range, position, velocity, i, j, layers, lane)
        scratch.place[0, lane], scratch.share[lane] = i, scratch.weight[pair]
        lane += 1
        if lane == layers.shape[2]:
            add_forces(field, n, lane, scratch, out)
            lane = 0
    if lane > 0:
        add_forces(field, n, lane, scratch, out)


@borrowing_kernel
def add_ground(
    field: ForceField,
    own: int,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Add the environment's forces on drones of a type; an anchored model's below its anchor."""
    anchor, layers = field.anchor_height, scratch.layers
    count = field.drag.shape[0]
    n, lane = count * count + own, 0
    for i in range(position.shape[0]):
        if types[i] != own or (anchor > 0.0 and position[i, 2] >= anchor):
            continue
        for part in range(2 if anchor > 0.0 else 1):
            height = position[i, 2] if part == 0 else anchor
            put_environment(field.environment_range, height, velocity, i, layers, lane)
            scratch.place[0, lane], scratch.share[lane] = i, 1.0 - 2.0 * part
            lane += 1
            if lane == layers.shape[2]:
                add_forces(field, n, lane, scratch, out)
                lane = 0
    if lane > 0:
        add_forces(field, n, lane, scratch, out)


@borrowing_kernel
def pairwise_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Add the networks' vertical forces on M drones to `out`.

    Args:
        field: the model; its networks are those of the pairs, `[neighbour, drone]` in rows, then
            those of the types' environment.
        types: (M,) interaction types.
        position: (M, 3) m.
        velocity: (M, 3) m/s.
        scratch: working memory, which knows their pairs.
        out: (M, 3) forces, N, world frame.
    """
    for own in range(field.drag.shape[0]):
        add_ground(field, own, types, position, velocity, scratch, out)
        for neighbour in range(field.drag.shape[0]):
            kinds = (neighbour, own)
            add_pairs(field, kinds, types, position, velocity, scratch, out)


def pairwise_names(types: tuple[str, ...]) -> list[str]:
    """Names of the networks in a weights file, in the order of the field."""
    pairs = [f"pair.{neighbor}.{ego}" for neighbor in types for ego in types]
    return [*pairs, *(f"environment.{name}" for name in types)]
