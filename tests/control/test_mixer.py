"""The mixer: exact inside the rotors' range, and what is given up outside it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from swarm_envs.control.loop import mix_rotors
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


def mix(vehicle: Vehicle, thrust: float, torque: FloatArray) -> FloatArray:
    """Rotor thrusts (4,) that the mixer gives."""
    limits = (vehicle.max_rotor_thrust, vehicle.arm / np.sqrt(2), vehicle.thrust_to_torque)
    x, y, z = torque.tolist()
    return np.array(list(mix_rotors(thrust, x, y, z, *limits)))


def wrench_of_rotors(vehicle: Vehicle) -> FloatArray:
    """(4, 4): thrust and torque of each rotor's newton, written from the rotors' places."""
    d = vehicle.arm / np.sqrt(2)
    place = np.array([[d, -d], [-d, -d], [-d, d], [d, d]])  # x forward, y left
    spin = np.array([-1, 1, -1, 1]) * vehicle.thrust_to_torque
    return np.stack([np.ones(4), place[:, 1], -place[:, 0], spin])  # a force up at (x, y)


def exact_rotors(vehicle: Vehicle, thrust: float, torque: FloatArray) -> FloatArray:
    """Solution of the mixer's linear equations."""
    return np.linalg.solve(wrench_of_rotors(vehicle), np.array([thrust, *torque]))


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())
def test_every_rotor_command_in_range_comes_back_from_its_wrench(vehicle: Vehicle) -> None:
    rotors = np.random.default_rng(0).uniform(0, vehicle.max_rotor_thrust, (200, 4))
    for row in rotors:
        thrust, *torque = wrench_of_rotors(vehicle) @ row
        np.testing.assert_allclose(mix(vehicle, thrust, np.array(torque)), row, rtol=0, atol=1e-14)


@settings(max_examples=200, deadline=None)
@given(vehicles, shares)
def test_priorities(vehicle: Vehicle, share: tuple[float, float, float, float]) -> None:
    thrust, torque = scaled_wrench(vehicle, share)
    rotors = mix(vehicle, thrust, torque)
    largest = vehicle.max_rotor_thrust
    assert 0 <= rotors.min() <= rotors.max() <= largest
    given_torque = (wrench_of_rotors(vehicle) @ rotors)[1:]
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
