"""Motors and batteries against Table I, Bitcraze's measurement and the closed form of discharge."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.motors import (
    FULL_VOLTAGE,
    BatteryModel,
    current,
    drain,
    limit_rotors,
    pwm_for_force,
    rotor_force_g,
    voltage,
)
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, LARGE, SMALL, SMALL_STRONG, VEHICLES

VEHICLE_TYPES = list(VEHICLES.values())
each_vehicle = pytest.mark.parametrize("vehicle", VEHICLE_TYPES, ids=lambda v: v.token)
CHARGES = np.linspace(0.001, 1.0, 200)

# Bitcraze, "PWM to thrust": total thrust (g) and current (A) of a Crazyflie on a scale.
MEASURED_THRUST_G = np.array([0.0, 4.8, 10.9, 17.3, 24.4, 32.8, 37.3])
MEASURED_CURRENT_A = np.array([0.24, 0.56, 0.94, 1.37, 1.83, 2.39, 2.71])


Battery = tuple[np.void, np.void, FloatArray]
"""A vehicle's record, the settings, and the voltages without load."""


def batteries(team, model=None, max_thrust=None) -> list[Battery]:
    """Return the arguments that the equations take of each vehicle's battery, from the engine.

    `max_thrust` stands in place of the vehicle's own, N.
    """
    model = model or BatteryModel()
    physics = BatchPhysics(team, interactions="none", battery=model)
    if max_thrust is not None:
        physics.world.drones["max_rotor_thrust"] = max_thrust / 4
    drones, settings = physics.world.drones[0], physics.settings[0]
    return [(drones[i], settings, model.open_circuit) for i in range(len(team))]


def battery_of(vehicle, model=None, max_thrust=None) -> Battery:
    return batteries((vehicle,), model, max_thrust)[0]


def limit_g(vehicle, charge, thrust_g, max_thrust_g=np.inf):
    """Largest thrust of four rotors, grams."""
    battery = battery_of(vehicle, max_thrust=max_thrust_g * GRAM_FORCE)
    return 4 * limit_rotors(charge, thrust_g * GRAM_FORCE, *battery) / GRAM_FORCE


def discharge(vehicle, thrust_n, steps, dt, model=None):
    """Charges and rotor limits while the rotors give a constant thrust from a full battery."""
    battery, charge, rows = battery_of(vehicle, model), 1.0, []
    for _ in range(steps):
        charge, limit = drain(charge, thrust_n, *battery, dt)
        rows.append((charge, limit))
    return np.array(rows)


@pytest.mark.parametrize(
    ("vehicle", "pwm", "volts", "printed"),
    [  # Table I with its printed digits, worked by hand
        (SMALL, 0.6, 3.8, 11.09 - 39.08 * 0.6 - 9.53 * 0.9048 + 20.57 * 0.36 + 38.43 * 0.5429),
        (LARGE, 0.5, 3.6, 44.10 - 122.51 * 0.5 - 36.18 * 0.8571 + 53.11 * 0.25 + 107.68 * 0.42857),
    ],
)
def test_psi1_is_the_printed_polynomial(vehicle, pwm, volts, printed):
    assert rotor_force_g(vehicle, pwm, volts / FULL_VOLTAGE) == pytest.approx(printed, abs=0.02)


@pytest.mark.parametrize(("vehicle", "worst_g", "rms_g"), [(SMALL, 1.0, 0.5), (LARGE, 3.7, 1.65)])
def test_psi2_inverts_psi1_as_well_as_its_docstring_says(vehicle, worst_g, rms_g):
    hover_g = vehicle.hover_rotor_thrust / GRAM_FORCE
    force, volts = np.meshgrid(np.linspace(0.5, 1.5, 101) * hover_g, np.linspace(3.4, 4.0, 61))
    pwm = pwm_for_force(vehicle, force, volts / FULL_VOLTAGE)
    miss = rotor_force_g(vehicle, pwm, volts / FULL_VOLTAGE) - force
    assert pwm.shape == force.shape
    assert abs(miss).max() < worst_g
    assert np.sqrt((miss**2).mean()) < rms_g
    assert abs(miss).max() > 0.9 * worst_g  # the docstring is not looser than the truth


def test_stronger_motors_give_more_at_the_same_signal_and_keep_their_inverse():
    ratio = SMALL_STRONG.max_thrust / SMALL.max_thrust
    force = rotor_force_g(SMALL, 0.7, 0.9)
    assert rotor_force_g(SMALL_STRONG, 0.7, 0.9) == pytest.approx(ratio * force)
    assert pwm_for_force(SMALL_STRONG, ratio * force, 0.9) == pytest.approx(
        pwm_for_force(SMALL, force, 0.9)
    )
    assert SMALL_STRONG.thrust_to_weight == pytest.approx(2.6)


@pytest.mark.parametrize(("vehicle", "printed_g"), [(SMALL, 65.0), (LARGE, 145.0)])
def test_a_full_battery_gives_the_largest_thrust_of_table_1(vehicle, printed_g):
    for share in (0.0, 0.5, 1.0):
        assert limit_g(vehicle, 1.0, share * printed_g) == pytest.approx(printed_g, rel=0.08)


def test_psi3_foresees_the_same_maximum_from_every_load():
    """Its rise with the signal answers the sag that the signal causes."""
    for vehicle, charge in itertools.product((SMALL, LARGE), (1.0, 0.5, 0.2)):
        loads = np.linspace(0.0, vehicle.max_thrust / GRAM_FORCE, 20)
        foreseen = np.array([limit_g(vehicle, charge, load) for load in loads])
        assert np.ptp(foreseen) < 0.08 * foreseen.mean()


def test_the_maximum_of_a_loaded_rotor_is_psi3_itself():
    battery = battery_of(LARGE, max_thrust=np.inf)
    thrust = LARGE.mass * 9.80665
    v = voltage(0.6, thrust, *battery)
    p = pwm_for_force(LARGE, thrust / 4 / GRAM_FORCE, v)
    a, b, c = LARGE.pwm_to_max_force
    expected = (a + b * p + c * v) * GRAM_FORCE
    assert limit_rotors(0.6, thrust, *battery) == pytest.approx(expected, rel=1e-12)


def test_the_current_follows_the_measured_one():
    _, settings, _ = battery_of(SMALL)
    drawn = [current(thrust * GRAM_FORCE, settings) for thrust in MEASURED_THRUST_G]
    np.testing.assert_allclose(drawn, MEASURED_CURRENT_A, atol=0.15)


@each_vehicle
def test_voltage_falls_with_use_and_with_load(vehicle):
    battery = battery_of(vehicle)
    loads = np.linspace(0.0, vehicle.max_thrust, 30)
    table = np.array([[voltage(q, load, *battery) for q in CHARGES] for load in loads])
    assert (np.diff(table, axis=1) > 0).all()
    assert (np.diff(table, axis=0) < 0).all()
    assert table.max() < 1.0


def test_open_circuit_voltage_meets_its_table():
    volts = (3.0, 3.7, 4.2)
    battery = battery_of(SMALL, BatteryModel(idle_current_a=0.0, open_circuit_v=volts))
    found = [FULL_VOLTAGE * voltage(q, 0.0, *battery) for q in (0.0, 0.25, 0.5, 1.0)]
    np.testing.assert_allclose(found, [3.0, 3.35, 3.7, 4.2], rtol=1e-12)


def test_the_sag_of_full_throttle_is_the_one_in_psi3():
    battery = battery_of(SMALL, BatteryModel(idle_current_a=0.0))
    sag = voltage(1.0, 0.0, *battery) - voltage(1.0, SMALL.max_thrust, *battery)
    assert sag == pytest.approx(3.02 / 26.72, rel=1e-12)


@each_vehicle
def test_charge_counts_the_current(vehicle):
    """Constant current: the charge used is I t / capacity, whatever the steps."""
    model = BatteryModel(capacity_ah=0.5, idle_current_a=0.3, current_per_newton=5.0)
    thrust, seconds = vehicle.mass * 9.80665, 30.0
    capacity_as = 0.5 * 3600 * vehicle.mass / SMALL.mass
    expected = 1.0 - (0.3 + 5.0 * thrust) * seconds / capacity_as
    for steps in (30, 720):
        charges = discharge(vehicle, thrust, steps, seconds / steps, model)[:, 0]
        assert charges[-1] == pytest.approx(expected, rel=1e-12)
    empty = discharge(vehicle, thrust, 50, 200.0, model)
    assert (np.diff(empty[:, 0]) <= 0).all()
    np.testing.assert_array_equal(empty[-1], (0.0, 0.0))  # and turns no rotor


def test_a_crazyflie_hovers_for_about_seven_minutes():
    light = replace(SMALL, mass=0.027)  # as sold, without the papers' marker and deck
    model = BatteryModel()
    seconds = model.capacity_ah * 3600 / (0.24 + model.current_per_newton * 0.027 * 9.80665)
    assert 6.5 * 60 < seconds < 7.5 * 60
    as_sold = replace(model, capacity_ah=0.25 * SMALL.mass / light.mass)
    charge = discharge(light, light.mass * 9.80665, int(seconds) - 2, 1.0, as_sold)[-1, 0]
    assert 0.0 < charge < 0.01


def test_thrust_falls_with_charge_and_hover_stays_possible():
    for vehicle in (SMALL, LARGE, SMALL_STRONG):
        weight_g = vehicle.mass * 1000
        limits = np.array([limit_g(vehicle, q, weight_g) for q in CHARGES])
        assert (np.diff(limits) > 0).all()
        assert limit_g(vehicle, 0.5, weight_g) > 1.5 * weight_g
        assert limit_g(vehicle, 0.02, weight_g) > weight_g


@each_vehicle
def test_the_limit_is_never_above_the_vehicles_own(vehicle):
    own = 0.5 * vehicle.max_thrust
    assert limit_rotors(1.0, own, *battery_of(vehicle, max_thrust=own)) == own / 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"open_circuit_v": (4.2, 3.0)}, "rise from empty to full"),
        ({"open_circuit_v": (4.2,)}, "at least two"),
    ],
)
def test_impossible_batteries_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        BatteryModel(**options)
