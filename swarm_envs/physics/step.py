"""The kernel of physics steps, for both engines.

`fly` copies a tile of environments from their records into blocks of `LANES` drones, makes steps of
1/240 s there, and copies them back. A step has four phases:

1. `CONTROL`: the tracking controller computes rotor commands from set-points;
2. `FORCES`: interaction forces and gusts at the present state, metrics, motor lag, batteries;
3. `INTEGRATE`: the rigid bodies; Bullet replaces this phase, with the forces of `wrench`;
4. `CONTACTS`: contacts at the new positions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from swarm_envs.compiled import equation, inlined, kernel, part
from swarm_envs.control.adaptation import adapt
from swarm_envs.control.loop import four, hold_rates, three, track
from swarm_envs.interactions.field import NONE
from swarm_envs.interactions.forces import evaluate_forces, swarm_forces
from swarm_envs.interactions.packed import CHUNK, PackedField, Scratch
from swarm_envs.motors import drain
from swarm_envs.neighbors import FEW
from swarm_envs.physics.contact import (
    PLACES,
    SPOT_TYPE,
    bounce,
    find_pairs,
    find_pairs_sorted,
    touch,
    touch_obstacles,
)
from swarm_envs.physics.hall_lanes import (
    disturb,
    estimate,
    load_hall,
    mark_near,
    see,
    store_hall,
)
from swarm_envs.physics.rigid_body import (
    TIME_STEP,
    gust,
    integrate,
    rotation_entries,
    rotor_wrench,
    spin_rotors,
)
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import (
    ACTIVE,
    ADAPTATION_END,
    BLOCK_TYPE,
    BODY_END,
    CONTACT_COLUMNS,
    CONTACT_VALUES,
    CONTROLLER_END,
    LANES,
    VEHICLE_END,
    Records,
    aligned,
)

SETPOINTS, RATES, ROTORS = 0, 1, 2
"""Inputs of actions: set-points of the tracking controller, thrust and body rates, or rotors."""
BEGIN, CONTROL, FORCES, INTEGRATE, CONTACTS = 1, 2, 4, 8, 16
"""Phases of a step, as flags; `BEGIN` first clears the contacts of the last decision."""
FAR = 1e6  # Distance of drones whose episode has ended, from all drones and from each other, m


class Flight(NamedTuple):
    """The memory of E environments of N drones that `fly` reads and writes."""

    drones: Records  # (E, N)
    columns: FloatArray  # (E, N, columns) the memory of the drones as floats
    environments: Records  # (E,)
    settings: Records  # (1,)


class Forces(NamedTuple):
    """A model of interaction forces, and its scratch memory for one thread."""

    model: PackedField
    order: IntArray | None  # That of `find_pairs`; None in plain flights
    scratch: Scratch


class Variations(NamedTuple):
    """The memory that only flights beyond a plain one need; see `Physics`."""

    obstacles: FloatArray  # (M, 7)
    open_circuit: FloatArray  # (K,) voltages of `swarm_envs.motors.voltage`
    order: IntArray  # (E, N) the drones as last sorted along x, in large teams
    feedforward: Forces  # The forces that the controllers compensate


class Work(NamedTuple):
    """The scratch memory of one thread."""

    blocks: Records
    """Records of `LANES` drones: all drones of a tile, one environment after another."""
    tile: FloatArray  # (blocks, rows, LANES) the memory of the blocks as floats
    members: IntArray  # (C,) the environments of the tile
    due: IntArray  # (C,) indices in `members` of environments whose force is due
    spots: Records  # (N,) for `find_pairs`
    position: FloatArray  # (N, 3) for `find_pairs_sorted`
    stopped: BoolArray
    """(drones of the tile,) True for drones that tumbled in this decision, or whose team did."""


def new_work(num_drones: int) -> Work:
    """Return the scratch memory for environments of a number of drones."""
    size = max(1, min(PLACES, CHUNK // num_drones))
    blocks = aligned(-(-size * num_drones // LANES), BLOCK_TYPE)
    return Work(
        blocks=blocks,
        tile=blocks.view(np.float64).reshape(len(blocks), -1, LANES),
        members=np.zeros(size, np.int64),
        due=np.zeros(size, np.int64),
        spots=aligned(num_drones if num_drones <= FEW else 0, SPOT_TYPE),
        position=np.zeros((num_drones, 3)),
        stopped=np.zeros(size * num_drones, np.bool_),
    )


@part
def load_tile(
    columns: FloatArray, count: int, controlled: bool, adaptive: bool, begins: bool, work: Work
) -> None:
    """Copy the columns of a step for the drones of the first `count` members into the blocks.

    Columns of the tracking controller, and of its adaptation, are left out if there is none. At the
    beginning of a decision, contacts are cleared. Unused lanes of the last block repeat the last
    drone, so that their numbers are valid; they are not copied back. Drones whose episode has ended
    are moved far away from all others, so that they neither touch nor exert forces; they are not
    copied back either, so that they keep their last state.
    """
    drones, slot = columns.shape[1], 0
    skipped = BODY_END if controlled else CONTROLLER_END
    end = ADAPTATION_END if adaptive else VEHICLE_END
    for place in range(count):
        for i in range(drones):
            row, lane = columns[work.members[place], i], slot % LANES
            block = work.tile[slot // LANES]
            for c in range(BODY_END):
                block[c, lane] = row[c]
            for c in range(skipped, end):
                block[c, lane] = row[c]
            if begins:
                for k in range(len(CONTACT_COLUMNS)):
                    block[CONTACT_COLUMNS[k], lane] = CONTACT_VALUES[k]
            if row[ACTIVE] == 0.0:
                block[0, lane] = FAR * (i + 1)
            work.stopped[slot] = False
            slot += 1
    last, block = (slot - 1) % LANES, work.tile[(slot - 1) // LANES]
    for lane in range(last + 1, LANES):
        for c in range(end):
            block[c, lane] = block[c, last]


@part
def store_tile(
    columns: FloatArray, first: int, last: int, controlled: bool, adaptive: bool, work: Work
) -> None:
    """Copy the columns that a step changes, of slots first to last - 1, back from the blocks."""
    drones = columns.shape[1]
    end = CONTROLLER_END if controlled else BODY_END
    learned = ADAPTATION_END if adaptive else VEHICLE_END
    for slot in range(first, last):
        row, lane = columns[work.members[slot // drones], slot % drones], slot % LANES
        block = work.tile[slot // LANES]
        if row[ACTIVE] == 0.0 or work.stopped[slot]:
            continue
        for c in range(end):
            row[c] = block[c, lane]
        for c in range(VEHICLE_END, learned):
            row[c] = block[c, lane]


@part
def stop(
    columns: FloatArray,
    slot: int,
    controlled: bool,
    adaptive: bool,
    team: bool,
    disturbed: bool | None,
    work: Work,
) -> None:
    """Stop a drone, or its team, at this physics step.

    They are copied back now, for the last time in this decision, and are moved far away, as in
    `load_tile`.
    """
    drones = columns.shape[1]
    place = slot - slot % drones
    for other in range(place, place + drones):
        if (team or other == slot) and not work.stopped[other]:
            store_tile(columns, other, other + 1, controlled, adaptive, work)
            if disturbed is not None and disturbed:
                store_hall(columns, work.members, other, other + 1, work.tile, work.stopped)
            work.stopped[other] = True
            b = work.blocks[other // LANES]
            b.position[0, other % LANES] = FAR * (other - place + 1)


@inlined
def stop_tumbling(
    columns: FloatArray,
    count: int,
    controlled: bool,
    adaptive: bool,
    team: bool,
    disturbed: bool | None,
    work: Work,
) -> None:
    """Stop those of the first `count` drones that tumble, or their teams; see `stop`."""
    for slot in range(count):
        if work.blocks[slot // LANES].tumbling[slot % LANES] != 0.0:
            stop(columns, slot, controlled, adaptive, team, disturbed, work)


@part
def gather(count: int, drones: int, work: Work, scratch: Scratch) -> None:
    """Copy types and states of the drones of `work.due[:count]` into a force model's scratch."""
    for place in range(count):
        for i in range(drones):
            slot, drone = work.due[place] * drones + i, scratch.drones[place * drones + i]
            b, lane = work.blocks[slot // LANES], slot % LANES
            drone["type"] = int(b.type[lane])
            for k in range(3):
                drone["position"][k] = b.position[k, lane]
                drone["velocity"][k] = b.velocity[k, lane]


@part
def spread(count: int, drones: int, environments: Records, work: Work, scratch: Scratch) -> None:
    """Copy the forces of a model on the drones of `gather` into the blocks."""
    for place in range(count):
        scale = environments[work.members[work.due[place]]].force_scale
        for i in range(drones):
            slot, drone = work.due[place] * drones + i, scratch.drones[place * drones + i]
            b, lane = work.blocks[slot // LANES], slot % LANES
            b.outside[lane] = drone["outside"]
            for k in range(3):
                b.force[k, lane] = drone["force"][k] * scale


@inlined
def predict(count: int, drones: int, hall: bool | None, feedforward: Forces, work: Work) -> None:
    """Write the forces that the controllers of the first `count` members compensate.

    `hall` is True if they use the hall's state estimate, else None.
    """
    scratch = feedforward.scratch
    for at in range(count * drones):
        drone, b, lane = scratch.drones[at], work.blocks[at // LANES], at % LANES
        drone["type"] = int(b.feedforward_type[lane])
        position = b.position if hall is None else b.seen_position
        velocity = b.velocity if hall is None else b.seen_velocity
        for k in range(3):
            drone["position"][k], drone["velocity"][k] = position[k, lane], velocity[k, lane]
    swarm_forces(feedforward.model, count, drones, feedforward.order, scratch)
    for at in range(count * drones):
        b, lane = work.blocks[at // LANES], at % LANES
        for k in range(3):
            b.feedforward_force[k, lane] = scratch.drones[at]["force"][k]


@equation
def find_due(count: int, hold: int, environments: Records, work: Work) -> int:
    """Write indices of members whose force is due to `work.due`; count a step of all members."""
    due: Any = np.int64(0)  # with a literal, Numba would compile callees twice
    for place in range(count):
        environment = environments[work.members[place]]
        if environment.age % hold == 0:
            work.due[due] = place
            due += 1
        environment.age += 1
    return due


@inlined
def control(
    count: int,
    full: int,
    flight: Flight,
    varied: Variations | None,
    hall: bool | None,
    work: Work,
) -> None:
    """Compute rotor commands from set-points, or from thrust and body rates.

    The `count` members of the tile are in `full` blocks. Other arguments are those of `fly`.
    """
    settings = flight.settings
    if hall is not None:
        see(work.blocks, full)
    if settings[0].level == SETPOINTS:
        if varied is not None and settings[0].compensates:
            predict(count, flight.drones.shape[1], hall, varied.feedforward, work)
        if varied is not None and settings[0].adaptation != 0:
            adapt(work.blocks, full, settings, hall)
        track(work.blocks, full, settings, None if varied is None else True, hall)
    hold_rates(work.blocks, full, settings, hall)


@inlined
def push(
    phases: int,
    count: int,
    full: int,
    flight: Flight,
    varied: Variations | None,
    hall: bool | None,
    acting: Forces,
    work: Work,
) -> None:
    """Evaluate all forces at the present state; advance motors and batteries.

    Without the phase CONTROL, as in `Physics.step`, there are no gusts. The arguments are those of
    `control`.
    """
    settings, environments, size = flight.settings, flight.environments, flight.drones.shape[1]
    due = find_due(count, settings[0].hold, environments, work)
    if due > 0 and acting.model.constants[0]["kind"] != NONE:
        gather(due, size, work, acting.scratch)
        swarm_forces(acting.model, due, size, acting.order, acting.scratch)
        spread(due, size, environments, work, acting.scratch)
        if hall is not None:
            mark_near(due, size, work.due, work.blocks, acting.scratch)
        if varied is not None and settings[0].twists:
            twist(acting, due, size, environments, work)
    if varied is not None and settings[0].gusty and phases & CONTROL:
        for place in range(count):
            environment = environments[work.members[place]]
            gust(environment, place * size, size, settings, work.blocks)
    if hall is not None:
        adds = settings[0].gusty or phases & CONTROL == 0
        disturb(work.blocks, full, settings, adds)
    spin_rotors(work.blocks, full)
    if varied is not None and settings[0].drains:
        empty_batteries(count, flight.drones, settings, varied.open_circuit, work)


@inlined
def find_contacts(
    count: int, full: int, flight: Flight, varied: Variations | None, hall: bool | None, work: Work
) -> None:
    """Update the contacts at the present positions. The arguments are those of `control`."""
    settings, size = flight.settings, flight.drones.shape[1]
    if hall is not None:
        estimate(work.blocks, full, settings)
    touch(work.blocks, full, settings)
    if varied is not None and size > FEW:
        for place in range(count):
            sorted_drones = varied.order[work.members[place]]
            find_pairs_sorted(work.blocks, place * size, work.position, sorted_drones)
    else:
        find_pairs(work.blocks, count, size, work.spots)
    if varied is not None and len(varied.obstacles) > 0:
        touch_obstacles(work.blocks, count * size, varied.obstacles)
    if varied is not None and settings[0].bounces:
        for place in range(count):
            bounce(work.blocks, place * size, size, settings, varied.obstacles)


@kernel
def fly(
    first: int,
    last: int,
    phases: int,
    steps: int,
    flown: BoolArray,
    flight: Flight,
    varied: Variations | None,
    hall: bool | None,
    acting: Forces,
    work: Work,
) -> None:
    """Simulate the environments first to last - 1 in the mask `flown` (E,), a tile at a time.

    Each step has the given phases. Without INTEGRATE, CONTACTS is the first, since Bullet has moved
    the bodies after the last call. A drone that tumbles stops at that step, alone or, with
    `ends_team`, with its team. `acting` are the forces on the drones.

    A plain flight has None for `varied`, and the ideal world for `hall`, which is True in the world
    "hall". Numba leaves out the branches of what is None, which saves a fifth of the time and half
    of the compilation. All else beyond a plain flight is in one record, so that few combinations
    are compiled.
    """
    drones, columns, environments = flight.drones, flight.columns, flight.environments
    s, size, members = flight.settings[0], drones.shape[1], work.members
    controlled, moves = s.level != ROTORS, phases & INTEGRATE != 0
    adapts = controlled and s.adaptation != 0
    disturbed = None if varied is None else hall is not None or s.twists
    torques = None if varied is None else True
    e = first
    while e < last:
        count = 0
        while e < last and count < len(members):
            if flown[e]:
                members[count] = e
                count += 1
            e += 1
        if count == 0:
            continue
        used = count * size
        full = (used + LANES - 1) // LANES
        load_tile(columns, count, controlled, adapts, phases & BEGIN != 0, work)
        if varied is not None and disturbed:
            load_hall(columns, environments, members, count, work.blocks, work.tile)
        if phases & CONTACTS and phases & BEGIN == 0:  # drones may have tumbled in earlier steps
            stop_tumbling(columns, used, controlled, adapts, s.ends_team, disturbed, work)
        for k in range(steps + 1):
            if phases & CONTACTS and (k > 0) == moves:
                find_contacts(count, full, flight, varied, hall, work)
                stop_tumbling(columns, used, controlled, adapts, s.ends_team, disturbed, work)
            if k == steps:
                break
            if phases & CONTROL and controlled:
                control(count, full, flight, varied, hall, work)
            if phases & FORCES:
                push(phases, count, full, flight, varied, hall, acting, work)
            if phases & INTEGRATE:
                integrate(work.blocks, full, torques)
            elif phases & FORCES:
                write_wrenches(count, drones, torques, work)
        store_tile(columns, 0, used, controlled, adapts, work)
        if varied is not None and disturbed:
            store_hall(columns, members, 0, used, work.tile, work.stopped)


@inlined
def twist(acting: Forces, count: int, drones: int, environments: Records, work: Work) -> None:
    """Write the aerodynamic torque: each rotor receives a quarter of the force at its position.

    This is the vertical force of the model for the drone at the rotor's position. The model was
    just evaluated for the first `count` environments of `work.due`. Its pairs, and in some models
    their weights, are those of the drones' centers.
    """
    scratch = acting.scratch
    for rotor in range(4):
        across = 1.0 if rotor == 0 or rotor == 3 else -1.0
        along = 1.0 if rotor >= 2 else -1.0
        for at in range(count * drones):
            slot, drone = work.due[at // drones] * drones + at % drones, scratch.drones[at]
            b, lane = work.blocks[slot // LANES], slot % LANES
            r = rotation_entries(*four(b.quaternion, lane))
            x, y = across * b.rotor_offset[lane], along * b.rotor_offset[lane]
            for k in range(3):
                drone["position"][k] = drone["seen"][k] + r[3 * k] * x + r[3 * k + 1] * y
        evaluate_forces(acting.model, count * drones, scratch)
        for at in range(count * drones):
            place = work.due[at // drones]
            slot = place * drones + at % drones
            b, lane = work.blocks[slot // LANES], slot % LANES
            r = rotation_entries(*four(b.quaternion, lane))
            x, y = across * b.rotor_offset[lane], along * b.rotor_offset[lane]
            share = 0.25 * environments[work.members[place]].force_scale
            force, torque = share * scratch.drones[at]["force"][2], b.interaction_torque
            kept = 0.0 if rotor == 0 else 1.0
            torque[0, lane] = kept * torque[0, lane] + y * force * r[8]
            torque[1, lane] = kept * torque[1, lane] - x * force * r[8]
            torque[2, lane] = kept * torque[2, lane] + force * (x * r[7] - y * r[6])


@part
def empty_batteries(
    count: int, drones: Records, settings: Records, open_circuit: FloatArray, work: Work
) -> None:
    """Update the charges of the batteries, and the limits of the rotors, by one step."""
    size = drones.shape[1]
    for slot in range(count * size):
        b, lane = work.blocks[slot // LANES], slot % LANES
        drone, total = drones[work.members[slot // size], slot % size], 0.0
        for r in range(4):
            total += b.rotor_thrust[r, lane]
        b.battery[lane], b.rotor_limit[lane] = drain(
            b.battery[lane], total, drone, settings[0], open_circuit, TIME_STEP
        )


@part
def write_wrenches(count: int, drones: Records, torques: bool | None, work: Work) -> None:
    """Write the force (N) and torque (N m) on each body, in the body frame, for Bullet.

    `torques` is True if there may be an interaction torque, else None.
    """
    size = drones.shape[1]
    for slot in range(count * size):
        b, lane = work.blocks[slot // LANES], slot % LANES
        out = drones[work.members[slot // size], slot % size].wrench
        rotors, (qx, qy, qz, qw) = four(b.rotor_thrust, lane), four(b.quaternion, lane)
        thrust, out[3], out[4], out[5] = rotor_wrench(
            rotors, b.rotor_offset[lane], b.thrust_to_torque[lane]
        )
        r = rotation_entries(qx, qy, qz, qw)
        (x, y, z), (ex, ey, ez) = three(b.force, lane), three(b.external, lane)
        x, y, z = x + ex, y + ey, z + ez
        gain = b.thrust_gain[lane]
        thrust, out[3], out[4], out[5] = gain * thrust, gain * out[3], gain * out[4], gain * out[5]
        if torques is not None:
            for k in range(3):
                out[3 + k] += b.interaction_torque[k, lane]
        out[0] = r[0] * x + r[3] * y + r[6] * z
        out[1] = r[1] * x + r[4] * y + r[7] * z
        out[2] = r[2] * x + r[5] * y + r[8] * z + thrust
