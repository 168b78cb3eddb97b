"""The composed model `learned`: wakes with corrections by networks.

The vertical force on drone i, in grams, is

    f_z = g_I(i)(-z, |v_xy|, -v_z) - (1 - M exp(-z / h)) (sum_j p_ij^q)^(1/q)

    p_ij = w_ij max(0, wake_I(j)->I(i)(r, dz) + n_I(j)->I(i)(r, dz, v_r, v_t, v_dz)).

wake is the closed form of `swarm_envs.interactions.wake`, with other parameters, and n a ReLU
network that corrects it. No p_ij is negative, so that a neighbor never lifts a drone, and since
q >= 1 the downwash of several neighbors is at most the sum of theirs.

dz is the height of drone j over drone i, and r the lateral distance of i from the axis of j's wake,
which trails behind j. v_r is the component of the relative horizontal velocity toward that axis,
and v_t the rest; near the axis, where the direction to it is undefined, all of it is in v_t. The
window w is a function of the horizontal distance and the depth. All these numbers are invariant
under rotation about the vertical and reflection. g is an anchored ReLU network: it is 0 at the
anchor height and above.

A second output of n, clipped to [-1, 1], is the ratio of the pair's horizontal force toward the
axis to p_ij. The horizontal force is the sum of these, reduced by the same factor as the downwash.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import equation
from swarm_envs.interactions.field import (
    LOWEST_HEIGHT,
    ONSET,
    UNITS_OF_OWN,
    UNITS_OF_PAIR,
    fade_weight,
)
from swarm_envs.interactions.packed import PackedField, Scratch
from swarm_envs.tables import Records
from swarm_envs.vehicles import GRAM_FORCE

__all__ = ["AXIS_RADIUS"]

AXIS_RADIUS = 0.04
"""Distance from a wake's axis below which the direction to it fades to 0, m."""


@equation
def describe_turned(field: PackedField, total: int, scratch: Scratch) -> None:
    """Replace the motions that `describe_motion` wrote by the inputs of the networks.

    Also write the pairs' weights, by the horizontal distance instead of those along x and y, the
    directions to the wakes' axes, and the wakes. `outside` is that of `describe_motion`.
    """
    model = field.constants[0]
    own, measured, window = model["environment_range"], model["pair_range"], model["window"]
    farthest = math.sqrt(measured[1, 0] * measured[1, 0] + measured[1, 1] * measured[1, 1])
    for slot in range(total):
        drone = scratch.drones[slot]
        velocity, motion = drone["velocity"], drone["motion"]
        speed = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
        motion[1], motion[2] = min(speed, own[1, 1]) / UNITS_OF_OWN[1], motion[3] / UNITS_OF_OWN[2]
        motion[0] /= UNITS_OF_OWN[0]
        drone["pushed"] = 0.0
        for k in range(3):
            drone["pairs"][k] = 0.0
    for at in range(scratch.counters[0]["pairs"]):
        pair = scratch.pairs[at]
        lower, upper = scratch.drones[pair["i"]], scratch.drones[pair["j"]]
        here, there, motion = lower["position"], upper["seen"], pair["motion"]
        x, y, dz = there[0] - here[0], there[1] - here[1], there[2] - here[2]
        beside = fade_weight(math.sqrt(x * x + y * y), window[0], window[1])
        pair["weight"] = beside * fade_weight(abs(dz), window[2], window[3])
        late, wind = max(dz, 0.0) * model["wake_delay"][upper["type"]], upper["velocity"]
        x, y = x - wind[0] * late, y - wind[1] * late
        u, v = wind[0] - lower["velocity"][0], wind[1] - lower["velocity"][1]
        square = x * x + y * y
        per_r = 1.0 / math.sqrt(square + AXIS_RADIUS * AXIS_RADIUS)
        toward = (x * u + y * v) * per_r
        across = math.sqrt(max(u * u + v * v - toward * toward, 0.0))
        motion[0], motion[1] = min(math.sqrt(square), farthest), motion[2]
        motion[2] = min(max(toward, measured[0, 3]), measured[1, 3])
        motion[3], motion[4] = min(across, measured[1, 3]), motion[5]
        pair["towards"][0], pair["towards"][1] = x * per_r, y * per_r
        fit, depth = model["wake_pair"][upper["type"], lower["type"]], motion[1]
        width = fit[1] + fit[2] * max(depth, 0.0)
        aside = motion[0] / width
        shape = (fit[1] / width) ** fit[3] * math.exp(-0.5 * (aside * aside))
        pair["wake"] = fit[0] * shape / (1.0 + math.exp(-depth / ONSET))
        for k in range(5):
            motion[k] /= UNITS_OF_PAIR[k]


@equation
def add_pushes(q: float, rows: Records, scratch: Scratch) -> None:
    """Add the outputs of a network of pairs to the sums of their drones; clear the counters."""
    counters = scratch.counters[0]
    for s in range(counters["used"]):
        pair, output = scratch.pairs[counters["pair"][s]], rows[s // 2]["v"]
        drone, towards = scratch.drones[pair["i"]], pair["towards"]
        push = pair["wake"] + output[s % 2, 0] * GRAM_FORCE
        push = 0.0 if push < 0.0 else counters["share"][s] * push  # keeps NaN
        lean = push * min(max(output[s % 2, 1], -1.0), 1.0)
        drone["pushed"] += push**q
        drone["pairs"][0] += lean * towards[0]
        drone["pairs"][1] += lean * towards[1]
        drone["pairs"][2] += push
    counters["used"] = 0


@equation
def join_pushes(field: PackedField, scratch: Scratch) -> None:
    """Add the joint downwash and horizontal force of the pairs to the forces on their drones."""
    model = field.constants[0]
    q, mitigation = model["wake_combine"], model["wake_mitigation"]
    for at in range(scratch.counters[0]["affected"]):
        drone = scratch.drones[scratch.affected[at]]
        pairs, force, total = drone["pairs"], drone["force"], drone["pairs"][2]
        height = max(drone["position"][2], LOWEST_HEIGHT)
        lost = mitigation[0] * math.exp(-height / mitigation[1])
        joined = (1.0 - lost) * drone["pushed"] ** (1.0 / q)
        share = joined / total if total > 0.0 else 0.0
        force[0] += share * pairs[0]
        force[1] += share * pairs[1]
        force[2] -= joined
