"""Rules of a table of rows: what is refused, and how to mend it.

A table holds no angles and no clock, so what can be checked is sizes. The limits lie well outside
of what small quadrotors do; `check_units` of `LogOptions` turns them off.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.training.interaction_rows.rows import FloatArray, InteractionRows
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES

HEIGHT_M = (0.0, 20.0)
"""Median height over the ground."""
FASTEST = 15.0
"""99 % of the speeds, m/s."""
FARTHEST_M = 50.0
"""99 % of the distances of neighbours."""
FORCE_G = (0.3, 60.0)
"""99 % of the vertical forces are smaller than the second, and not all smaller than the first."""
TORQUE_N_M = 0.05
"""99 % of the torques; a small quadrotor gives 6e-3 N m at most."""


def check_table(rows: InteractionRows, units: bool = True) -> None:
    """Refuse a table that cannot be what it says.

    Args:
        rows: of the right shapes, all numbers finite.
        units: look at sizes too.

    Raises:
        ValueError: a rule is broken; the message names the value, the rule and the fix.
    """
    if not len(rows):
        raise ValueError("it holds no row; add rows or remove the file")
    _check_twice(rows)
    if units:
        for check in (_check_height, _check_speed, _check_neighbours, _check_force, _check_torque):
            check(rows)


def notes_of(rows: InteractionRows) -> tuple[str, ...]:
    """What is odd about a table, though nothing is wrong with it."""
    known = {vehicle.interaction_type for vehicle in VEHICLES.values()}
    strange = [name for name in rows.types if name not in known]
    if not strange:
        return ()
    return (f"types {', '.join(map(repr, strange))} belong to no vehicle that ships",)


def _check_twice(rows: InteractionRows) -> None:
    key = np.stack([rows.flight, rows.vehicle, rows.step], axis=1)
    found, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        k = int(np.argmax(count > 1))
        flight, vehicle, step = (int(value) for value in found[k])
        raise ValueError(
            f"step {step} of flight {flight} is there {count[k]} times for vehicle {vehicle} "
            f"(first in row {first[k]}), but a drone has one row at a time; remove doubles, and "
            "count steps and number flights so that none collide"
        )


def _largest(values: FloatArray) -> float:
    return float(np.quantile(values, 0.99)) if values.size else 0.0


def _check_height(rows: InteractionRows) -> None:
    height = float(np.median(rows.position[:, 2]))
    low, high = HEIGHT_M
    if not low <= height <= high:
        fix = "give heights over the ground in m"
        if height < low:
            fix = "z must point up: turn the sign of position, velocity and neighbours round"
        elif height > 200.0:
            fix = "it looks like millimetres: divide by 1000"
        raise ValueError(
            f"position[:, 2] is usually {height:.4g}, but must be {low:g} to {high:g} m; {fix}"
        )


def _check_speed(rows: InteractionRows) -> None:
    speed = _largest(np.linalg.norm(rows.velocity, axis=1))
    if speed > FASTEST:
        fix = "it looks like millimetres a second: divide by 1000"
        raise ValueError(
            f"velocity reaches {speed:.4g}, but must stay below {FASTEST:g} m/s; "
            f"{fix if speed > 100.0 else 'give m/s'}"
        )


def _check_neighbours(rows: InteractionRows) -> None:
    pair = rows.neighbor[rows.has_neighbor]
    apart = _largest(np.linalg.norm(pair[:, :3], axis=1))
    if apart > FARTHEST_M:
        raise ValueError(
            f"neighbor[..., :3] reaches {apart:.4g}, but must stay below {FARTHEST_M:g} m; give "
            "p_j - p_i in m"
        )
    speed = _largest(np.linalg.norm(pair[:, 3:], axis=1))
    if speed > 2.0 * FASTEST:
        raise ValueError(
            f"neighbor[..., 3:] reaches {speed:.4g}, but must stay below {2 * FASTEST:g} m/s; give "
            "v_j - v_i in m/s"
        )


def _check_force(rows: InteractionRows) -> None:
    force = _largest(np.abs(rows.force_g[:, 2]))
    low, high = FORCE_G
    if 0.0 < force < low:
        raise ValueError(
            f"force_g[:, 2] stays below {force:.3g} g, but must reach {low:g} g; it looks like "
            f"newtons: divide by {GRAM_FORCE:.6g}. If the forces are so weak, set check_units to "
            "False"
        )
    if force > high:
        fix = f"if it is millinewtons: divide by {GRAVITY}"
        raise ValueError(
            f"force_g[:, 2] reaches {force:.4g} g, but must stay below {high:g} g; give "
            f"gram-force without the weight; {fix}"
        )


def _check_torque(rows: InteractionRows) -> None:
    if rows.torque is None:
        return
    torque = _largest(np.abs(rows.torque))
    if torque > TORQUE_N_M:
        raise ValueError(
            f"torque reaches {torque:.4g} N m, but must stay below {TORQUE_N_M:g}; give N m"
        )
