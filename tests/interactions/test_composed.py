"""The composed model: that of the equations; it is smooth; files are checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs.interactions import load
from swarm_envs.interactions.field import fade_weight
from swarm_envs.reference import fade, learned
from swarm_envs.reference_numbers import aerodynamics_of
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, VEHICLES, Vehicle

TYPES = ("A", "B")
FULL, END, TOP, EDGE = 0.25, 0.35, 0.8, 1.1
WINDOW = {"lateral_m": [FULL, END], "vertical_m": [TOP, EDGE]}
FAST, FASTER = 1.0, 1.2
RANGE = {
    "pair": [[-END, -END, -1.0, -FAST, -FAST, -FASTER], [END, END, 1.0, FAST, FAST, FASTER]],
    "environment": [[-1.6, -0.6, -0.6, -1.0], [-0.07, 0.6, 0.6, 1.0]],
}
DRAG, ANCHOR = 0.02, 0.6


def drawn(networks: Mapping[str, Sequence[int]], rng: np.random.Generator) -> dict[str, FloatArray]:
    """Tensors `name.layer.weight` and `name.layer.bias` of networks, given by their widths."""
    tensors = {}
    for name, widths in networks.items():
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            tensors[f"{name}.{k}.weight"] = rng.normal(size=(outputs, inputs))
            tensors[f"{name}.{k}.bias"] = rng.normal(size=outputs)
    return tensors


def write(path: Path, without: str = "", **changes: Any) -> None:
    """Write a random model; `changes` are of tensors by name, and one may be left out."""
    rng, tensors = np.random.default_rng(3), {f"drag.{t}": np.full(3, DRAG) for t in TYPES}
    networks = {f"pair.{other}.{own}": (5, 7, 5, 2) for other in TYPES for own in TYPES}
    networks |= {f"environment.{t}": (3, 7, 5, 1) for t in TYPES}
    tensors |= drawn(networks, rng)
    for other in TYPES:
        tensors[f"delay.{other}"] = rng.uniform(0.1, 0.3, 1)
        for own in TYPES:
            tensors[f"wake.{other}.{own}"] = rng.uniform([5, 0.04, 0.01, 1], [25, 0.08, 0.05, 3])
    tensors["joining"] = np.array([1.3, 0.8, 0.1])
    tensors |= changes
    tensors.pop(without, None)
    note = {"format": "composed-1", "types": TYPES, "anchor_height_m": ANCHOR}
    note |= {"window": WINDOW, "input_range": RANGE}
    save_file(tensors, path, metadata={"swarm_envs": json.dumps(note)})


def team_of(kinds: list[str]) -> list[Vehicle]:
    small = vars(VEHICLES["S"])
    return [Vehicle(**{**small, "token": t, "interaction_type": t}) for t in kinds]


@pytest.mark.parametrize("drones", [1, 3, 26])
def test_forces_are_those_of_the_formula(drones: int, tmp_path: Path) -> None:
    path = tmp_path / "composed.safetensors"
    write(path)
    rng, model = np.random.default_rng(drones), load(path)
    position = rng.uniform([-0.3, -0.3, 0.05], [0.3, 0.3, 1.6], (1, drones, 3))
    velocity = rng.normal(0.0, 0.5, (1, drones, 3))
    team = team_of([TYPES[k % 3 % 2] for k in range(drones)])
    expected = learned(position, velocity, aerodynamics_of(model, team))
    np.testing.assert_allclose(model.forces(position, velocity, team), expected, rtol=0, atol=1e-12)


def test_the_horizontal_force_is_smooth_through_the_axis() -> None:
    """It changes its sign there, and the vertical force has its greatest size about there."""
    across = np.linspace(-0.02, 0.02, 401)
    position = np.zeros((401, 2, 3))
    position[:, 0, 0], position[:, :, 2] = across, [1.0, 1.3]
    force = load("learned").forces(position, np.zeros_like(position), "LL")[:, 0, 0]
    assert force[200] == 0.0
    np.testing.assert_allclose(force, -force[::-1], atol=1e-15)
    assert np.abs(np.diff(force)).max() < 0.5 * GRAM_FORCE  # per tenth of a millimetre


def test_no_weight_is_below_nothing() -> None:
    """Rounding at the edge of the window would make a power of a negative push: not a number."""
    distance = END - np.geomspace(1e-9, 1e-3, 5000)
    compiled = np.array([fade_weight(d, FULL, END) for d in distance])
    for weight in (compiled, fade(distance, FULL, END)):
        assert weight.min() == 0.0


DAMAGES: dict[str, tuple[dict[str, Any], str]] = {
    "q below 1": ({"joining": np.array([0.9, 0.5, 0.1])}, "q must be at least 1"),
    "no height": ({"joining": np.array([1.1, 0.5, 0.0])}, "h above 0"),
    "more than all": ({"joining": np.array([1.1, 1.5, 0.1])}, "M at most 1"),
    "a shape": ({"joining": np.ones(2)}, "must be 3 numbers"),
    "no width": ({"wake.A.B": np.array([9.0, 0.0, 0.1, 1.0])}, "without width"),
    "negative": ({"wake.A.B": np.array([-9.0, 0.1, 0.1, 1.0])}, "not negative"),
    "delay": ({"delay.B": np.array([-0.1])}, "must be 1 numbers that are not negative"),
    "not finite": ({"delay.B": np.array([np.nan])}, "not finite"),
    "widths": ({"pair.A.A.0.weight": np.ones((7, 6))}, "maps 6 to 2 numbers"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_refused(damage: str, tmp_path: Path) -> None:
    changes, message = DAMAGES[damage]
    write(tmp_path / "composed.safetensors", **changes)
    with pytest.raises(ValueError, match=message):
        load(tmp_path / "composed.safetensors")


@pytest.mark.parametrize("missing", ["wake.B.A", "delay.A", "joining", "pair.A.B.1.weight"])
def test_a_missing_tensor_is_refused(missing: str, tmp_path: Path) -> None:
    path = tmp_path / "composed.safetensors"
    write(path, without=missing)
    with pytest.raises(ValueError, match="damaged"):
        load(path)
