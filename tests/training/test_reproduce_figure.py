"""Fig. 5: maps, superposition gap and larger swarms against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.training.reproduce.force_map_figure import (
    examine_formation,
    ring_places,
    stack_places,
)
from swarm_envs.training.reproduce.heat_maps import (
    MAP_CASES,
    force_map,
    force_on_ego_g,
    superposed_force_g,
)
from swarm_envs.viewing.style import force_colors
from tests.helpers.papers import run_quietly

CASE = {case.letter: case for case in MAP_CASES}


def wake_that_adds(exponent):
    """The closed form with another rule of combining wakes, and nothing lost at the ground."""
    wake = load("wake")
    field = wake.field._replace(wake_combine=exponent, wake_mitigation=np.array([0.0, 1.0]))
    return InteractionModel("planted", wake.types, field)


def jet_g(upper, lower, lateral, depth):
    """Downward push of one jet, from the formula in the equations, gram-force."""
    field = load("wake").field
    index = "SL".index(upper), "SL".index(lower)
    amplitude, width, spread, exponent = field.wake_pair[index]
    below = width + spread * max(depth, 0.0)
    shape = (width / below) ** exponent * math.exp(-0.5 * (lateral / below) ** 2)
    return amplitude / 0.00980665 * shape / (1 + math.exp(-depth / 0.03))


def test_a_map_is_the_closed_form():
    found = force_map(wake_that_adds(1.0), CASE["c"], 0.05)
    for y, z in ((0.0, 1.2), (0.05, 1.3), (-0.1, 1.1)):
        column, row = np.abs(found.y - y).argmin(), np.abs(found.z - z).argmin()
        expected = -jet_g("S", "S", abs(found.y[column]), 1.5 - found.z[row])
        assert found.at(y, z) == pytest.approx(expected, abs=1e-6)
        assert found.force_g[row, column] == found.at(y, z)


def test_the_wake_of_a_moving_neighbour_trails():
    found = force_map(load("wake"), CASE["d"], 0.01)
    row = int(np.abs(found.z - 1.1).argmin())
    speed = 1.0 / load("wake").field.wake_delay[0]
    assert found.y[found.force_g[row].argmin()] == pytest.approx(-0.8 * 0.4 / speed, abs=0.011)


def test_gaps_are_zero_where_pairs_add_up():
    for case in MAP_CASES:
        found = force_map(wake_that_adds(1.0), case, 0.1)
        assert np.abs(found.gap_g).max() < 1e-9
    for letter in "abcd":
        assert np.abs(force_map(load("learned"), CASE[letter], 0.1).gap_g).max() < 1e-9


def test_the_gap_of_two_equal_wakes_is_known():
    model = wake_that_adds(2.0)
    position = np.array([[[0, 0, 2.0], [0, 0.05, 2.3], [0, -0.05, 2.3]]])
    one = jet_g("S", "S", 0.05, 0.3)
    joint = force_on_ego_g(model, "SSS", position)[0]
    assert joint == pytest.approx(-math.sqrt(2.0) * one, rel=1e-6)
    gap = superposed_force_g(model, "SSS", position)[0] - joint
    assert gap == pytest.approx((math.sqrt(2.0) - 2.0) * one, rel=1e-6)


def test_where_a_drone_fits():
    found = force_map(wake_that_adds(1.0), CASE["b"], 0.01)
    y, z = np.meshgrid(found.y, found.z)
    fits = (np.hypot(y, z - 0.5) >= 0.12 - 1e-9) & (z >= 0.07 - 1e-9)
    assert (found.free == fits).mean() > 0.9995  # points on the very edge may round either way
    with pytest.raises(ValueError, match=r"step_m is 0\.5"):
        force_map(load("wake"), CASE["b"], 0.5)


def test_larger_swarms_count_their_neighbours():
    swarm = examine_formation(wake_that_adds(1.0), "stack", "S" * 16)
    assert swarm.neighbours.tolist() == [4, 5, 6, 7, *[8] * 8, 7, 6, 5, 4]
    assert swarm.joint_g == pytest.approx(swarm.superposed_g, abs=1e-9)
    assert swarm.joint_g[-1] == pytest.approx(0.0, abs=1e-2)
    assert examine_formation(load("wake"), "rings", "S" * 16).neighbours.tolist() == [15] * 16
    assert np.ptp(stack_places(5)[:, 2]) == pytest.approx(1.0)
    apart = np.linalg.norm(ring_places(16)[:, None] - ring_places(16)[None], axis=-1)
    assert apart[apart > 0].min() > 0.12  # no two small drones touch


def test_colours_are_as_strong_either_way():
    for low, high in ((-20.0, 5.0), (-1.0, 1.0)):
        colors = force_colors(low, high)
        white, strongest_down, strongest_up = colors(-low / (high - low)), colors(0.0), colors(1.0)
        assert min(white) > 0.95
        assert strongest_down[0] > strongest_down[2]
        assert strongest_up[2] > strongest_up[0]
    narrow, wide = force_colors(-20.0, 5.0), force_colors(-20.0, 20.0)
    assert np.allclose(narrow(1.0), wide(0.625), atol=0.02)


def test_pictures_and_numbers_are_written_and_the_paper_stands_beside_ours(tmp_path):
    asked = {"figure": 5, "model": "wake", "truth": "wake"}
    summary, said = run_quietly("neural-swarm2", out=tmp_path / "out", **asked)
    assert len(summary["files"]) == 3
    for name in summary["files"].values():
        with Image.open(tmp_path / "out" / name) as image:
            assert min(image.size) > 600
            assert len(np.unique(np.asarray(image.convert("L")))) > 100
    ours = {r["name"]: r["ours_g"] for r in summary["readings"]}
    (line,) = (line for line in said.splitlines() if line.startswith("(g): largest gap"))
    assert line.split()[-3:] == ["11.4", "3.7", f"{ours['superposition_gap']:.1f}"]
    assert "13 more than measured" in said
    assert "SSSLL: 100.0 % of the true force explained" in said
