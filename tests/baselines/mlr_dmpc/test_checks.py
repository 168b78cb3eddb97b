"""Input that MLR-DMPC refuses, and input that it just accepts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.input_checks import checked_indices, checked_points
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm

CONFIG = MlrDmpcConfig()
GAP = CONFIG.sampled_distance_m


def test_points_may_stand_in_the_corners_and_just_apart() -> None:
    points = np.array([*CONFIG.box, [0.0, 0.0, 1.0], [GAP, 0.0, 1.0], [0.0, 0.0, 1.001 + 6 * GAP]])
    found = checked_points("starts", points, CONFIG, 5)
    np.testing.assert_array_equal(found, points)
    assert found is not points


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.zeros(3), r"starts have shape \(3,\)"),
        (np.zeros((2, 2)), r"starts have shape \(2, 2\)"),
        (np.zeros((0, 3)), r"starts have shape \(0, 3\)"),
        ([[0.0, 0.0, 1.0]] * 3, "there are 3 starts, but 2 drones"),
        ([[0.0, 0.0, 1.0], [np.nan, 0.0, 1.0]], "not finite"),
        ([[0.0, 0.0, 1.0], [0.0, 2.001, 1.0]], r"starts\[1\] = \[0.0, 2.001, 1.0\] is outside"),
        ([[0.0, 0.0, 0.299], [0.0, 9.0, 1.0]], r"starts\[0\] = .* is outside"),
        ([[0.0, 0.0, 1.0], [GAP - 1e-3, 0.0, 1.0]], r"\[0\] and starts\[1\] are 0.260 m apart"),
        ([[0.0, 0.0, 1.0], [0.0, 0.0, 2.56]], r"are 0.260 m .* divided by 6, .* keep 0.2614 m"),
    ],
)
def test_other_points_are_refused(points: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        checked_points("starts", np.array(points), CONFIG, 2)


def test_what_heights_are_divided_by_is_relative_to_the_other_axes() -> None:
    config = MlrDmpcConfig(scaling=(2.0, 2.0, 6.0))
    with pytest.raises(ValueError, match="when heights are divided by 3, but"):
        checked_points("starts", np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.1]]), config, 2)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"compute_units": 3}, "compute_units is 3, but must be at most 2"),
        ({"compute_units": 0}, "compute_units is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"recovery": "none"}, "unknown recovery 'none'"),
    ],
)
def test_other_options_are_refused(changes: dict[str, Any], reason: str) -> None:
    places = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match=reason):
        MlrDmpcSwarm(places, places, **{"compute_units": 2, **changes})


def test_rounds_by_index() -> None:
    assert checked_indices("leaves", {0: 0, 3: 9}, 4) == {0: 0, 3: 9}
    for given, reason in (
        ({4: 1}, "leaves names drone 4, but there are 4: 0 to 3"),
        ({-1: 1}, "an index of leaves is -1"),
        ({1: -1}, r"leaves\[1\] is -1"),
    ):
        with pytest.raises(ValueError, match=reason):
            checked_indices("leaves", given, 4)
