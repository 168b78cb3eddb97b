"""Vehicles against the printed tables; team strings and back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm_envs.vehicles import LARGE, SMALL, SMALL_STRONG, VEHICLES, parse_team, team_string


@pytest.mark.parametrize(
    ("text", "tokens"),
    [
        ("S", "S"),
        ("SSL", "S S L"),
        ("S*S*LL", "S* S* L L"),
        ("SS*S", "S S* S"),
        ("L2S", "L S"),
        ("SL2S", "S L S"),
        ("S*2L", "S* L"),
    ],
)
def test_team_strings_are_read_in_order(text, tokens):
    assert [v.token for v in parse_team(text)] == tokens.split()


@given(st.lists(st.sampled_from(list(VEHICLES.values())), min_size=1, max_size=12))
def test_team_strings_come_back_as_they_were_written(team):
    assert parse_team(team_string(team)) == tuple(team)
    assert parse_team(team) == tuple(team)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("SXL", ("'X'", "'SXL'", "'S*'", "'L'")),
        ("s", ("'s'",)),
        ("S L", ("' '",)),
        ("*S", ("'*'", "did you mean 'S*'")),
        ("L*", ("'L*'", "valid: 'L', 'S', 'S*'")),
        ("", ("no drones", "such as")),
        ("2", ("no drones",)),
        ((), ("no drones",)),
    ],
)
def test_bad_teams_name_the_value_the_rule_and_the_fix(text, parts):
    with pytest.raises(ValueError) as error:
        parse_team(text)
    for part in parts:
        assert part in str(error.value)


@pytest.mark.parametrize(
    ("vehicle", "mass_g", "thrust_g", "diameter_cm"), [(SMALL, 34, 65, 12), (LARGE, 67, 145, 19)]
)
def test_table_1(vehicle, mass_g, thrust_g, diameter_cm):
    assert vehicle.mass * 1000 == pytest.approx(mass_g)
    assert vehicle.max_thrust / 9.80665 * 1000 == pytest.approx(thrust_g)
    assert vehicle.diameter * 100 == pytest.approx(diameter_cm)
    assert vehicle.radius * 200 == pytest.approx(diameter_cm)
    assert vehicle.motor_rate == 16
    assert vehicle.thrust_to_weight == pytest.approx(thrust_g / mass_g)


def test_inertia_of_large_follows_mass_and_diameter_squared():
    rule = 67 / 34 * (19 / 12) ** 2
    for large, small in zip(LARGE.inertia, (16.572e-6, 16.656e-6, 29.262e-6), strict=True):
        assert large == pytest.approx(small * rule)
    x, y, z = LARGE.inertia
    assert x + y >= z  # what every rigid body obeys


def test_strong_motors_change_thrust_alone():
    assert SMALL_STRONG.max_thrust == pytest.approx(2.6 * 0.034 * 9.80665)
    assert SMALL_STRONG.interaction_type == SMALL.interaction_type == "S"
    for field in ("mass", "inertia", "diameter", "arm", "thrust_to_torque", "motor_rate"):
        assert getattr(SMALL_STRONG, field) == getattr(SMALL, field)


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=lambda v: v.token)
def test_every_vehicle_can_hover_and_its_rotors_fit(vehicle):
    assert 4 * vehicle.hover_rotor_thrust == pytest.approx(vehicle.mass * 9.80665)
    assert vehicle.hover_rotor_thrust < 0.6 * vehicle.max_rotor_thrust
    assert vehicle.rotor_radius < vehicle.arm / math.sqrt(2)  # neighbouring discs do not overlap
    assert VEHICLES[vehicle.token] is vehicle
