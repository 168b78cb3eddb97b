"""The force on every drone of a crowd, whatever the model; and which drones feel each other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import announce_compilation, equation, kernel
from swarm_envs.errors import check_array, unknown_name
from swarm_envs.interactions.field import NONE, WAKE
from swarm_envs.interactions.network import network_forces
from swarm_envs.interactions.packed import PackedField
from swarm_envs.interactions.scratch import CROWD, Scratch, scratch_for
from swarm_envs.interactions.wake import wake_forces
from swarm_envs.neighbors import FEW, sort_along_x, within_box
from swarm_envs.state import FloatArray, IntArray


@equation
def pair_weight(window: FloatArray, dx: float, dy: float, dz: float) -> float:
    """Weight of a pair at offset (dx, dy, dz), m: 1 well inside the volume, 0 from its edge on.

    Along each axis it falls by a quintic smoothstep, which is twice differentiable.

    Args:
        window: (4,) lateral full and end, vertical full and end, m.
        dx: offset in x, m.
        dy: offset in y, m.
        dz: offset in z, m.
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
def find_pairs(field: PackedField, count: int, drones: int, scratch: Scratch) -> None:
    """List all ordered pairs inside the interaction volume, the neighbours of a drone ascending.

    Few drones are compared in all environments at once: drone i of place c is number i * count + c
    there, so that all pairs (i, i + apart) are numbers at the same distance, and their comparison
    is a loop that becomes vector instructions. Many are sorted along x, and swept.

    Args:
        field: the model.
        count: environments.
        drones: drones in each, N.
        scratch: knows where they are; its pairs are written.
    """
    window, desk, pairs = field.constants[0]["window"], scratch.desk[0], scratch.pairs
    lateral, vertical, found = window[1], window[3], 0
    if drones <= FEW:
        x, y, z, near = desk["x"], desk["y"], desk["z"], desk["near"]
        for slot in range(count * drones):
            here, k = scratch.drones[slot]["position"], slot % drones * count + slot // drones
            x[k], y[k], z[k] = here[0], here[1], here[2]
        candidates = 0
        for apart in range(drones - 1, 0, -1):
            gap = np.uint64(apart * count)
            for k in range(np.uint64((drones - apart) * count)):
                beside = (abs(x[k + gap] - x[k]) < lateral) & (abs(y[k + gap] - y[k]) < lateral)
                near[k] = beside & (abs(z[k + gap] - z[k]) < vertical)
            for k in range((drones - apart) * count):  # no branch, for it could not be foreseen
                pairs[candidates]["i"], pairs[candidates]["j"] = k + apart * count, k
                candidates += near[k]
        for at in range(candidates):
            a, b = pairs[at]["i"], pairs[at]["j"]
            left = pair_weight(window, x[a] - x[b], y[a] - y[b], z[a] - z[b])
            if left > 0.0:
                pairs[found]["i"] = a % count * drones + a // count
                pairs[found]["j"] = b % count * drones + b // count
                pairs[found]["weight"] = left
                found += 1
        for at in range(found):  # backwards: the other drone's neighbours ascend too
            pair, other = pairs[found - 1 - at], pairs[found + at]
            other["i"], other["j"], other["weight"] = pair["j"], pair["i"], pair["weight"]
        desk["pairs"] = 2 * found
        return
    for first in range(0, count * drones, drones):
        end = first + drones
        here, order, close = (
            scratch.columns[first:end],
            scratch.order[0, first:end],
            scratch.order[1],
        )
        sort_along_x(here, order)
        for place in range(drones):
            i = order[place]
            for c in range(within_box(here, order, place, lateral, vertical, close, 0)):
                j = close[c]
                offset = here[j, 0] - here[i, 0], here[j, 1] - here[i, 1], here[j, 2] - here[i, 2]
                left = pair_weight(window, offset[0], offset[1], offset[2])
                if left > 0.0:
                    pair = pairs[found]
                    pair["i"], pair["j"], pair["weight"] = first + i, first + j, left
                    found += 1
    desk["pairs"] = found


@kernel
def swarm_forces(field: PackedField, count: int, drones: int, scratch: Scratch) -> None:
    """Write the interaction and drag forces on the drones of a crowd.

    A force is marked as an extrapolation (`outside`) when the drone's own height (if too low) or
    speed, or the offset or relative speed of a neighbour inside the interaction volume, lies
    outside what was measured.

    Args:
        field: the model.
        count: environments in the crowd, at most as many as the scratch has places.
        drones: drones in each, N.
        scratch: knows their types, positions and velocities; forces (N, world frame) and marks are
            written, and their pairs.
    """
    model = field.constants[0]
    anchor, own, measured = model["anchor_height"], model["environment_range"], model["pair_range"]
    scratch.desk[0]["pairs"] = 0
    if model["kind"] != NONE:
        find_pairs(field, count, drones, scratch)
    for slot in range(count * drones):
        drone = scratch.drones[slot]
        velocity, height = drone["velocity"], drone["position"][2]
        drag = model["drag"][drone["type"]]
        outside = -height > own[1, 0]
        for k in range(3):
            drone["force"][k] = -drag[k] * velocity[k]
            outside |= not own[0, k + 1] <= -velocity[k] <= own[1, k + 1]
        drone["outside"] = outside
        drone["low"] = drone["felt"] = anchor == 0.0 or height < anchor
    for at in range(scratch.desk[0]["pairs"]):
        here, there = scratch.drones[scratch.pairs[at]["i"]], scratch.drones[scratch.pairs[at]["j"]]
        outside = here["outside"] != 0
        for k in range(3):
            apart = there["position"][k] - here["position"][k]
            moving = there["velocity"][k] - here["velocity"][k]
            outside |= not measured[0, k] <= apart <= measured[1, k]
            outside |= not measured[0, k + 3] <= moving <= measured[1, k + 3]
        here["outside"], here["felt"] = outside, 1
    if model["kind"] == WAKE:
        wake_forces(field, count * drones, scratch)
    elif model["kind"] != NONE:
        network_forces(field, count * drones, scratch)


def all_forces(
    field: PackedField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
) -> None:
    """Write the forces on the drones of any number of environments.

    Args:
        field: the model.
        types: (E, N) interaction types, indices into the model's types.
        position: (E, N, 3) m, world frame.
        velocity: (E, N, 3) m/s, world frame.
        out: (E, N, 3) forces f_a, N, world frame; overwritten.
    """
    environments, drones = types.shape
    if types.size == 0:
        return
    places = min(max(1, CROWD // drones), environments)
    scratch = scratch_for(field, places, drones)
    announce_compilation(swarm_forces)
    for first in range(0, environments, places):
        part = slice(first, first + places)
        count = len(types[part])
        crowd = scratch.drones[: count * drones]
        crowd["type"] = types[part].ravel()
        crowd["position"] = position[part].reshape(-1, 3)
        crowd["velocity"] = velocity[part].reshape(-1, 3)
        swarm_forces(field, count, drones, scratch)
        out[part] = crowd["force"].reshape(count, drones, 3)


@kernel
def active_pairs(window: FloatArray, position: FloatArray) -> int:
    """Number of ordered pairs of one environment inside the interaction volume.

    Args:
        window: (4,) the model's window, m.
        position: (N, 3) m.
    """
    count = 0
    for i in range(position.shape[0]):
        for j in range(position.shape[0]):
            if i != j:
                dx = position[j, 0] - position[i, 0]
                dy = position[j, 1] - position[i, 1]
                dz = position[j, 2] - position[i, 2]
                count += pair_weight(window, dx, dy, dz) > 0.0
    return count


def types_array(names: tuple[str, ...], types: tuple[str, ...], where: str = "") -> IntArray:
    """Indices (N,) of interaction type names in a model's types.

    Raises:
        ValueError: a name is not among them; the message says `where` it was asked for.
    """
    for name in names:
        if name not in types:
            raise ValueError(unknown_name("interaction type", name, types, where))
    return np.array([types.index(name) for name in names], dtype=np.int64)


def check_states(
    position: npt.ArrayLike, velocity: npt.ArrayLike, drones: int
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of environments with N drones as (E, N, 3) arrays.

    Raises:
        ValueError: the shapes are others, or an entry is not finite.
    """
    try:
        environments = np.shape(position)[:1]
    except ValueError:
        environments = (1,)  # ragged: no array at all, which is said below
    shape = (*environments, drones, 3)
    return (
        check_array("position", position, shape, "(E, N, 3), N drones in the team"),
        check_array("velocity", velocity, shape, "the shape of position"),
    )
