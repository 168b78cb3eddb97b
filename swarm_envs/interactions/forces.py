"""Evaluation of force models: pairs of drones, and the forces on the drones of a chunk."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import announce_compilation, equation, inlined, kernel, part
from swarm_envs.errors import check_array, unknown_name
from swarm_envs.interactions.composed import describe_turned, join_pushes
from swarm_envs.interactions.field import COMPOSED, NONE, WAKE
from swarm_envs.interactions.network import add_outputs, network, put_drone, put_pair
from swarm_envs.interactions.packed import (
    CHUNK,
    PAIRS,
    SAMPLES,
    SOURCE,
    PackedField,
    Scratch,
    order_for,
    scratch_for,
)
from swarm_envs.interactions.wake import wake_forces
from swarm_envs.neighbors import FEW, sort_along_x, within_box
from swarm_envs.state import FloatArray, IntArray

__all__ = ["all_forces", "swarm_forces", "types_array"]


@equation
def pair_weight(window: FloatArray, dx: float, dy: float, dz: float) -> float:
    """Return the weight of a pair at an offset, m: 1 well inside the volume, 0 from its edge on.

    It is a product of quintic smoothsteps along the axes; the window (4,) is that of `ForceField`.
    """
    lateral, weight = (window[0], window[1]), 1.0
    for distance, (full, end) in (
        (abs(dx), lateral),
        (abs(dy), lateral),
        (abs(dz), (window[2], window[3])),
    ):
        if distance >= end:
            return 0.0
        if not distance <= full:
            u = (distance - full) / (end - full)
            weight *= 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return weight


@equation
def find_pairs(
    field: PackedField, count: int, drones: int, order: IntArray | None, scratch: Scratch
) -> None:
    """List all ordered pairs inside the interaction volume, a drone's neighbors in ascending order.

    Small teams are compared in all environments at once: drone i of environment c has the index
    i * count + c, so that all pairs (i, i + apart) have the same difference of indices, and the
    loop over them is vectorized. In large teams, drones are sorted along x and swept. `order` is
    that of `order_for`, or None for small teams, which keeps the sweep from being compiled.
    """
    window, counters, pairs = field.constants[0]["window"], scratch.counters[0], scratch.pairs
    lateral, vertical, found = window[1], window[3], 0
    if order is not None and drones > FEW:
        for first in range(0, count * drones, drones):
            here, sorted_here = scratch.columns[first : first + drones], order[0, first:][:drones]
            sort_along_x(here, sorted_here)
            for place in range(drones):
                i = sorted_here[place]
                close = within_box(here, sorted_here, place, lateral, vertical, order[1])
                for c in range(close):
                    j = order[1, c]
                    x, y, z = (
                        here[j, 0] - here[i, 0],
                        here[j, 1] - here[i, 1],
                        here[j, 2] - here[i, 2],
                    )
                    left = pair_weight(window, x, y, z)
                    if left > 0.0:
                        pair = pairs[found]
                        pair["i"], pair["j"], pair["weight"] = first + i, first + j, left
                        found += 1
        counters["pairs"] = found
        return
    x, y, z, near = counters["x"], counters["y"], counters["z"], counters["near"]
    for slot in range(count * drones):
        here, k = scratch.drones[slot]["position"], slot % drones * count + slot // drones
        x[k], y[k], z[k] = here[0], here[1], here[2]
    candidates = 0
    for apart in range(drones - 1, 0, -1):
        gap = np.uint64(apart * count)
        for k in range(np.uint64((drones - apart) * count)):
            beside = (abs(x[k + gap] - x[k]) < lateral) & (abs(y[k + gap] - y[k]) < lateral)
            near[k] = beside & (abs(z[k + gap] - z[k]) < vertical)
        for k in range((drones - apart) * count):  # no branch, which could not be predicted
            pairs[candidates]["i"], pairs[candidates]["j"] = k + apart * count, k
            candidates += near[k]
    for at in range(candidates):
        a, b = pairs[at]["i"], pairs[at]["j"]
        left = pair_weight(window, x[a] - x[b], y[a] - y[b], z[a] - z[b])
        if left > 0.0:
            pair = pairs[found]
            pair["i"], pair["j"] = a % count * drones + a // count, b % count * drones + b // count
            pair["weight"] = left
            found += 1
    for at in range(found):  # backward, so that the other drone's neighbors ascend too
        pair, other = pairs[found - 1 - at], pairs[found + at]
        other["i"], other["j"], other["weight"] = pair["j"], pair["i"], pair["weight"]
    counters["pairs"] = 2 * found


@equation
def describe_motion(field: PackedField, total: int, scratch: Scratch) -> None:
    """Write the motion of drones and pairs, clamped to the measured range.

    A drone whose own motion, or that of one of its pairs, is outside the range is marked `outside`:
    its force is extrapolated. Also write the drag, and the list of drones with further forces.
    """
    model, counters, affected = field.constants[0], scratch.counters[0], 0
    anchor, own, measured = model["anchor_height"], model["environment_range"], model["pair_range"]
    for slot in range(total):
        drone = scratch.drones[slot]
        height, drag = drone["position"][2], model["drag"][drone["type"]]
        drone["motion"][0] = min(max(-height, own[0, 0]), own[1, 0])
        outside = -height > own[1, 0]
        for k in range(3):
            velocity = drone["velocity"][k]
            known = min(max(-velocity, own[0, k + 1]), own[1, k + 1])
            outside |= known != -velocity
            drone["motion"][k + 1], drone["force"][k] = known, -drag[k] * velocity
        drone["outside"] = outside
        drone["low"] = drone["affected"] = anchor == 0.0 or height < anchor
    for at in range(counters["pairs"]):
        pair = scratch.pairs[at]
        here, there, motion = scratch.drones[pair["i"]], scratch.drones[pair["j"]], pair["motion"]
        outside = here["outside"] != 0
        for k in range(3):
            motion[k] = there["seen"][k] - here["position"][k]
            motion[k + 3] = there["velocity"][k] - here["velocity"][k]
        for k in range(6):
            known = min(max(motion[k], measured[0, k]), measured[1, k])
            outside |= known != motion[k]
            motion[k] = known
        here["outside"], here["affected"] = outside, 1
    for slot in range(total):
        scratch.affected[affected] = slot
        affected += scratch.drones[slot]["affected"]
    counters["affected"] = affected
    for at in range(affected):
        code = scratch.rows[SAMPLES + scratch.affected[at]]["v"]
        for k in range(model["hidden"]):
            code[0, k] = code[1, k] = 0.0


@inlined
def swarm_forces(
    field: PackedField, count: int, drones: int, order: IntArray | None, scratch: Scratch
) -> None:
    """Write the interaction and drag forces (N, world frame) on the drones of a chunk.

    The scratch contains types, positions and velocities of `count` environments of `drones` each;
    their pairs are written to it too. `order` is that of `find_pairs`.
    """
    counters = scratch.counters[0]
    counters["pairs"] = counters["used"] = 0
    if field.constants[0]["kind"] != NONE:
        find_pairs(field, count, drones, order, scratch)
    for slot in range(count * drones):
        drone = scratch.drones[slot]
        for k in range(3):
            drone["seen"][k] = drone["position"][k]
    evaluate_forces(field, count * drones, scratch)


@part
def evaluate_forces(field: PackedField, total: int, scratch: Scratch) -> None:
    """Write the forces at the drones' `position`; their neighbors are at their `seen` positions."""
    kind, counters = field.constants[0]["kind"], scratch.counters[0]
    describe_motion(field, total, scratch)
    if kind == WAKE:
        wake_forces(field, total, scratch)
    if kind == COMPOSED:
        describe_turned(field, total, scratch)
    for n in range(field.layout.shape[0]):
        of_pairs = field.layout[n, SOURCE] == PAIRS
        end = counters["pairs"] if of_pairs else 2 * counters["affected"]
        for at in range(end):
            if of_pairs:
                put_pair(field, n, at, scratch)
            else:
                put_drone(field, n, 2 * scratch.affected[at // 2] + at % 2, scratch)
            if counters["used"] == SAMPLES or at == end - 1:
                result = network(field.layout, n, field.weights, counters["used"], scratch.rows)
                add_outputs(field, n, scratch.rows[result:], scratch)
    if kind == COMPOSED:
        join_pushes(field, scratch)


@kernel
def write_forces(
    field: PackedField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
    order: IntArray | None,
    scratch: Scratch,
) -> None:
    """Write the forces of `all_forces`, in chunks of the scratch's number of environments."""
    environments, drones = types.shape
    size = len(scratch.drones) // drones
    for first in range(0, environments, size):
        count = min(size, environments - first)
        for slot in range(count * drones):
            e, i, drone = first + slot // drones, slot % drones, scratch.drones[slot]
            drone["type"] = types[e, i]
            for k in range(3):
                drone["position"][k], drone["velocity"][k] = position[e, i, k], velocity[e, i, k]
        swarm_forces(field, count, drones, order, scratch)
        for slot in range(count * drones):
            force = scratch.drones[slot]["force"]
            for k in range(3):
                out[first + slot // drones, slot % drones, k] = force[k]


def all_forces(
    field: PackedField, types: IntArray, position: FloatArray, velocity: FloatArray, out: FloatArray
) -> None:
    """Write the forces `out` (E, N, 3), N, world frame, on the drones of E environments.

    Types (E, N) are indices of the model's types; positions and velocities are (E, N, 3), m, m/s.
    """
    environments, drones = types.shape
    if types.size == 0:
        return
    size = min(max(1, CHUNK // drones), environments)
    announce_compilation(write_forces)
    # Read-only arrays have another type, for which the kernel would be compiled again
    p, v = (np.require(array, np.float64, ("C", "W")) for array in (position, velocity))
    order = order_for(size, drones) if drones > FEW else None
    write_forces(field, types, p, v, out, order, scratch_for(field, size, drones))


def types_array(names: tuple[str, ...], types: tuple[str, ...], where: str = "") -> IntArray:
    """Return the indices (N,) of interaction type names in a model's types.

    Raises:
        ValueError: a name is not among them; `where` is part of the message.
    """
    for name in names:
        if name not in types:
            raise ValueError(unknown_name("interaction type", name, types, where))
    return np.array([types.index(name) for name in names], dtype=np.int64)


def check_states(
    position: npt.ArrayLike, velocity: npt.ArrayLike, drones: int
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of environments with N drones as arrays (E, N, 3).

    Raises:
        ValueError: the shapes are others, or an entry is not finite.
    """
    try:
        environments = np.shape(position)[:1]
    except ValueError:
        environments = (1,)  # ragged, which raises below
    shape = (*environments, drones, 3)
    return (
        check_array("position", position, shape, "(E, N, 3), N drones in the team"),
        check_array("velocity", velocity, shape, "the shape of position"),
    )
