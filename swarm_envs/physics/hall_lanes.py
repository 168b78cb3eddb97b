"""The world `"hall"` in lanes: random forces and the state estimate.

Each drone estimates its state by a filter of constant gain: accelerometer and gyroscope predict it
at every physics step, and frames of motion capture correct it, with delay, noise and losses. Except
for rotations, this is linear in the errors of the estimate. The simulation therefore advances the
*errors*; the estimate is the true state plus its error. With standard normal numbers n:

1. prediction: e_v += a n, e_p += e_v dt; e_q += g n, e_w = g n / dt;
2. a frame of age d: i = -v d + s n - e_p, e_p += K_p i, e_v += K_v i; the same for e_q with the
   angular velocity. The velocity is taken as constant over the delay.

The controller receives the estimate, which `see` writes.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import equation, kernel, part
from swarm_envs.control.loop import four, three
from swarm_envs.interactions.packed import Scratch
from swarm_envs.noise import even_number, moved, pair_of_normals, stream_of
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import ADAPTATION_END, HALL_ENDS, LANES, Records

__all__ = ["sense_in_hall"]

DRAWS = 9  # Random numbers of 64 bits for a drone in a physics step


@equation
def turned(
    q: tuple[float, float, float, float], angle: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Return an attitude rotated by a small rotation vector (rad) in the world frame."""
    x, y, z = 0.5 * angle[0], 0.5 * angle[1], 0.5 * angle[2]
    a = q[0] + x * q[3] + y * q[2] - z * q[1]
    b = q[1] - x * q[2] + y * q[3] + z * q[0]
    c = q[2] + x * q[1] - y * q[0] + z * q[3]
    d = q[3] - x * q[0] - y * q[1] - z * q[2]
    scale = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * scale, b * scale, c * scale, d * scale


@part
def load_hall(
    columns: FloatArray,
    environments: Records,
    members: IntArray,
    count: int,
    blocks: Records,
    tile: FloatArray,
) -> None:
    """Copy the hall's columns of the drones of the first `count` members into the blocks.

    Unused lanes of the last block have valid numbers, zeros or those of another tile.
    """
    drones, slot = columns.shape[1], 0
    for place in range(count):
        e = members[place]
        for i in range(drones):
            row, n, lane = columns[e, i], slot // LANES, slot % LANES
            for c in range(ADAPTATION_END, HALL_ENDS[1]):
                tile[n, c, lane] = row[c]
            first = stream_of(environments[e].hall_key, i)
            blocks[n].stream[lane] = moved(first, environments[e].age * DRAWS)
            slot += 1


@part
def store_hall(
    columns: FloatArray,
    members: IntArray,
    first: int,
    last: int,
    tile: FloatArray,
    stopped: BoolArray,
) -> None:
    """Copy changed columns of slots first to last - 1 back, except for drones that have stopped."""
    drones = columns.shape[1]
    for slot in range(first, last):
        if stopped[slot]:
            continue
        row, lane = columns[members[slot // drones], slot % drones], slot % LANES
        for c in range(ADAPTATION_END, HALL_ENDS[0]):
            row[c] = tile[slot // LANES, c, lane]


@part
def mark_near(count: int, drones: int, due: IntArray, blocks: Records, scratch: Scratch) -> None:
    """Write `has_neighbor`: 1 for drones with another in the interaction volume of the force model.

    The forces of `count` environments have just been evaluated; `due` (C,) are their indices in the
    tile. The scratch of the force model lists the pairs.
    """
    for place in range(count):
        for i in range(drones):
            slot = due[place] * drones + i
            blocks[slot // LANES].has_neighbor[slot % LANES] = 0.0
    for at in range(scratch.counters[0]["pairs"]):
        i = scratch.pairs[at]["i"]
        slot = due[i // drones] * drones + i % drones
        blocks[slot // LANES].has_neighbor[slot % LANES] = 1.0


@part
def disturb(blocks: Records, count: int, settings: Records, adds: bool) -> None:
    """Advance the random force of the first `count` blocks; write it to `external`, N, world frame.

    The modeled force is up to date. With `adds`, the random force is added to `external`.
    """
    s, base = settings[0], 1.0 if adds else 0.0
    kept, sideways = s.residual_kept, s.residual_sideways
    fresh = math.sqrt(1.0 - kept * kept)
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            stream = b.stream[lane]
            x, y = pair_of_normals(stream, 0)
            z, _ = pair_of_normals(stream, 1)
            b.stream[lane] = moved(stream, DRAWS)
            fx, fy, fz = three(b.force, lane)
            force = math.sqrt(fx * fx + fy * fy + fz * fz)
            grown = force / (force + b.residual_half[lane])
            size = b.residual_quiet[lane] + b.residual_more[lane] * grown
            alone = b.residual_alone[lane]
            size = alone + b.has_neighbor[lane] * (size - alone)
            x, y = (
                kept * b.residual_process[0, lane] + fresh * x,
                kept * b.residual_process[1, lane] + fresh * y,
            )
            z = kept * b.residual_process[2, lane] + fresh * z
            (
                b.residual_process[0, lane],
                b.residual_process[1, lane],
                b.residual_process[2, lane],
            ) = x, y, z
            (ex, ey, ez), across = three(b.external, lane), sideways * size
            b.external[0, lane], b.external[1, lane] = (
                base * ex + across * x,
                base * ey + across * y,
            )
            b.external[2, lane] = base * ez + size * z + b.force_offset[lane]


@part
def estimate(blocks: Records, count: int, settings: Records) -> None:
    """Advance the errors of the estimates of the first `count` blocks by a step."""
    s = settings[0]
    dt, velocity_walk, attitude_walk = TIME_STEP, s.velocity_walk, s.attitude_walk
    per_step, loss, delay = s.frames_per_step, s.frame_loss, s.frame_delay
    step_frames = TIME_STEP / s.frames_per_step
    position_noise, attitude_noise = s.frame_noise[0], s.frame_noise[1]
    position_gain, velocity_gain, attitude_gain = s.frame_gain[0], s.frame_gain[1], s.frame_gain[2]
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            stream = b.stream[lane]
            a0, a1 = pair_of_normals(stream, 2)
            a2, g0 = pair_of_normals(stream, 3)
            g1, g2 = pair_of_normals(stream, 4)
            p0, p1 = pair_of_normals(stream, 5)
            p2, q0 = pair_of_normals(stream, 6)
            q1, q2 = pair_of_normals(stream, 7)
            phase = b.frame_phase[lane] + per_step
            arrived = 1.0 if phase >= 1.0 else 0.0
            phase -= arrived
            b.frame_phase[lane] = phase
            seen = arrived if even_number(stream, 8) >= loss else 0.0
            age = delay + phase * step_frames
            moves = (a0, a1, a2), (g0, g1, g2), (p0, p1, p2), (q0, q1, q2)
            for k in range(3):
                velocity = b.velocity_error[k, lane] + velocity_walk * moves[0][k]
                position = b.position_error[k, lane] + dt * velocity
                turn = attitude_walk * moves[1][k]
                attitude = b.attitude_error[k, lane] + turn
                missed = position_noise * moves[2][k] - b.velocity[k, lane] * age - position
                turned_by = attitude_noise * moves[3][k] - b.angular_velocity[k, lane] * age
                b.position_error[k, lane] = position + seen * position_gain * missed
                b.velocity_error[k, lane] = velocity + seen * velocity_gain * missed
                b.attitude_error[k, lane] = attitude + seen * attitude_gain * (turned_by - attitude)
                b.gyro_error[k, lane] = turn / dt


@part
def see(blocks: Records, count: int) -> None:
    """Write the state estimate for the controller."""
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            for k in range(3):
                b.seen_position[k, lane] = b.position[k, lane] + b.position_error[k, lane]
                b.seen_velocity[k, lane] = b.velocity[k, lane] + b.velocity_error[k, lane]
                rate = b.angular_velocity[k, lane] + b.gyro_error[k, lane]
                b.seen_angular_velocity[k, lane] = rate
            x, y, z, w = turned(four(b.quaternion, lane), three(b.attitude_error, lane))
            b.seen_quaternion[0, lane], b.seen_quaternion[1, lane] = x, y
            b.seen_quaternion[2, lane], b.seen_quaternion[3, lane] = z, w


@kernel
def sense_in_hall(first: int, last: int, drones: Records, mask: BoolArray, out: Records) -> None:
    """Write the state estimate in the world `"hall"`; rotor thrusts and charges are exact.

    Records (E, N) have the true state and the errors of its estimate. Estimates are written for the
    environments first to last - 1 that are in the mask (E,).
    """
    for e in range(first, last):
        if not mask[e]:
            continue
        for i in range(drones.shape[1]):
            d, o = drones[e, i], out[e, i]
            a, q = d.attitude_error, d.quaternion
            x, y, z, w = turned((q[0], q[1], q[2], q[3]), (a[0], a[1], a[2]))
            o.quaternion[0], o.quaternion[1], o.quaternion[2], o.quaternion[3] = x, y, z, w
            for k in range(3):
                o.position[k] = d.position[k] + d.position_error[k]
                o.velocity[k] = d.velocity[k] + d.velocity_error[k]
                o.angular_velocity[k] = d.angular_velocity[k] + d.gyro_error[k]
            for k in range(4):
                o.rotor_thrust[k] = d.rotor_thrust[k]
            o.battery, o.rotor_limit = d.battery, d.rotor_limit
