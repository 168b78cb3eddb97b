"""Messages of exceptions: value, rule and fix."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.errors import check_array, check_name, unknown_name

ACTIONS = ("rotors", "setpoint", "acceleration")


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("rotor", "rotors"), ("Acceleration", "acceleration"), ("set_point", "setpoint")],
)
def test_an_unknown_name_suggests_the_nearest(name, nearest):
    with pytest.raises(ValueError) as error:
        check_name("action", name, ACTIONS)
    message = str(error.value)
    assert f"unknown action {name!r}" in message
    assert f"did you mean {nearest!r}?" in message
    assert "valid: 'acceleration', 'rotors', 'setpoint'" in message


def test_a_name_like_no_other_gets_the_list_alone():
    message = unknown_name("action", "qqq", ACTIONS, "in the options")
    assert "did you mean" not in message
    assert message.startswith("unknown action 'qqq' in the options; valid: ")


@pytest.mark.parametrize("name", [None, 3, ("rotors",)])
def test_what_is_no_string_is_refused(name):
    with pytest.raises(ValueError, match="unknown action"):
        check_name("action", name, ACTIONS)


def test_a_wrong_shape_names_both_shapes_and_the_rule():
    with pytest.raises(ValueError) as error:
        check_array("commands", np.zeros((2, 3)), (2, 4), "(N, 4), newton")
    message = str(error.value)
    assert "commands has shape (2, 3)" in message
    assert "must have shape (2, 4) ((N, 4), newton)" in message


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_entry_that_is_not_finite_is_named_with_its_place(bad):
    array = np.zeros((2, 4))
    array[1, 2] = bad
    with pytest.raises(ValueError) as error:
        check_array("commands", array, (2, 4))
    assert f"commands is {bad} at index (1, 2)" in str(error.value)


@pytest.mark.parametrize("value", [["a", "b"], [[1.0], [1.0, 2.0]], None, {"a": 1}])
def test_what_is_no_array_of_numbers_is_named(value):
    with pytest.raises(ValueError, match="commands"):
        check_array("commands", value, (2,))
