"""The mixer: exact inside the rotors' range, and what is given up outside it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from swarm_envs.control.tracking import mix, wrench
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import LARGE, SMALL, VEHICLES, Vehicle

vehicles = st.sampled_from([SMALL, LARGE])
# As multiples of what the rotors can give at most about each axis; beyond 1 is out of reach.
shares = st.tuples(*(st.floats(-2.0, 2.0),) * 4)


def scaled_wrench(
    vehicle: Vehicle, share: tuple[float, float, float, float]
) -> tuple[float, FloatArray]:
    thrust, roll, pitch, yaw = share
    largest, offset = vehicle.max_rotor_thrust, vehicle.arm / np.sqrt(2)
    torque = 2 * largest * np.array([offset, offset, vehicle.thrust_to_torque])
    return 4 * largest * thrust, torque * [roll, pitch, yaw]


def exact_rotors(vehicle: Vehicle, thrust: float, torque: FloatArray) -> FloatArray:
    """Solution of the mixer's linear equations, written from the rotors' places."""
    d = vehicle.arm / np.sqrt(2)
    place = np.array([[d, -d], [-d, -d], [-d, d], [d, d]])  # x forward, y left
    spin = np.array([-1, 1, -1, 1]) * vehicle.thrust_to_torque
    rows = np.stack([np.ones(4), place[:, 1], -place[:, 0], spin])  # a force up at (x, y)
    return np.linalg.solve(rows, np.array([thrust, *torque]))


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())
def test_every_rotor_command_in_range_comes_back_from_its_wrench(vehicle: Vehicle) -> None:
    rotors = np.random.default_rng(0).uniform(0, vehicle.max_rotor_thrust, (200, 4))
    thrust, torque = wrench(vehicle, rotors)
    for row, t, m in zip(rotors, thrust, torque, strict=True):
        np.testing.assert_allclose(mix(vehicle, t, m), row, rtol=0, atol=1e-14)
        np.testing.assert_allclose(exact_rotors(vehicle, t, m), row, rtol=0, atol=1e-14)


@settings(max_examples=200, deadline=None)
@given(vehicles, shares)
def test_priorities(vehicle: Vehicle, share: tuple[float, float, float, float]) -> None:
    thrust, torque = scaled_wrench(vehicle, share)
    rotors = mix(vehicle, thrust, torque)
    largest = vehicle.max_rotor_thrust
    assert (rotors >= 0).all()
    assert (rotors <= largest).all()

    _, given_torque = wrench(vehicle, rotors)
    tilting = exact_rotors(vehicle, 0.0, np.array([torque[0], torque[1], 0.0]))
    turning = exact_rotors(vehicle, 0.0, np.array([0.0, 0.0, torque[2]]))
    # Roll and pitch are given exactly where they fit, else scaled alike as little as possible.
    kept = min(1.0, largest / max(np.ptp(tilting), 1e-12))
    np.testing.assert_allclose(given_torque[:2], kept * torque[:2], rtol=0, atol=1e-14)
    expected = kept * tilting + thrust_and_yaw(thrust / 4, kept * tilting, turning, largest)
    np.testing.assert_allclose(rotors, expected, rtol=0, atol=1e-7 * largest)


def thrust_and_yaw(
    wanted: float, tilting: FloatArray, turning: FloatArray, largest: float
) -> FloatArray:
    """Base thrust nearest to the wanted one, with the largest share of yaw: two linear programs."""
    unit = largest / 1e4  # the solver's tolerance is absolute
    wanted, tilting, turning = wanted / unit, tilting / unit, turning / unit
    # Variables: base, share, distance of the base from the wanted one.
    rows = np.stack([np.ones(4), turning, np.zeros(4)], axis=-1)
    near = np.array([[1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    upper = np.concatenate([rows, -rows, near])
    slack = 1e-5
    bound = np.concatenate([1e4 - tilting + slack, tilting + slack, [wanted, -wanted]])
    box = [(None, None), (0, 1), (0, None)]
    distance = linprog([0.0, 0.0, 1.0], upper, bound, bounds=box).fun
    box[2] = (0, distance + slack)
    base, share, _ = linprog([0.0, -1.0, 0.0], upper, bound, bounds=box).x
    return np.asarray(unit * (base + share * turning))


@pytest.mark.parametrize(
    ("thrust", "torque", "message"),
    [
        (np.nan, [0, 0, 0], "thrust is nan"),
        (1.0, [0, 0], r"torque has shape \(2,\)"),
        (1.0, [0, np.inf, 0], r"torque is inf at index \(1,\)"),
    ],
)
def test_bad_wrenches_are_refused(thrust: float, torque: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mix(SMALL, thrust, torque)
