"""The pairwise model, written out in numpy: a sum over pairs, faded at the edge of the volume."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, VEHICLES, Vehicle
from tests.helpers.drawn_networks import drawn

TYPES = ("A", "B")
WINDOW = {"lateral_m": [0.25, 0.35], "vertical_m": [0.8, 1.1]}
DRAG = 0.02
Tensors = dict[str, FloatArray]


def written(path: Path, anchor: float | None) -> Tensors:
    """A random model of three layers in a file; its tensors."""
    rng, tensors = np.random.default_rng(3), {f"drag.{t}": np.full(3, DRAG) for t in TYPES}
    networks = {f"pair.{other}.{own}": (6, 7, 5, 1) for other in TYPES for own in TYPES}
    networks |= {f"environment.{t}": (4, 7, 5, 1) for t in TYPES}
    tensors |= drawn(networks, rng)
    note = {"format": "pairwise-1", "types": TYPES, "anchor_height_m": anchor, "window": WINDOW}
    save_file(tensors, path, metadata={"swarm_envs": json.dumps(note)})
    return tensors


def network(tensors: Tensors, name: str, x: FloatArray) -> float:
    for k in range(3):
        x = tensors[f"{name}.{k}.weight"] @ (np.maximum(x, 0.0) if k else x)
        x = x + tensors[f"{name}.{k}.bias"]
    return float(x[0])


def fade(distance: float, full: float, end: float) -> float:
    u = np.clip((distance - full) / (end - full), 0.0, 1.0)
    return float(1 - 10 * u**3 + 15 * u**4 - 6 * u**5)


def weight(offset: FloatArray) -> float:
    x, y, z = np.abs(offset)
    lateral, vertical = WINDOW["lateral_m"], WINDOW["vertical_m"]
    return fade(x, *lateral) * fade(y, *lateral) * fade(z, *vertical)


def ground(tensors: Tensors, own: str, height: float, velocity: FloatArray) -> float:
    return network(tensors, f"environment.{own}", np.array([-height, *-velocity]))


@pytest.mark.parametrize("anchor", [None, 0.6])
@pytest.mark.parametrize("drones", [1, 3, 26])
def test_forces_are_those_of_the_formula(anchor: float | None, drones: int, tmp_path: Path) -> None:
    path = tmp_path / "pairwise.safetensors"
    tensors, rng = written(path, anchor), np.random.default_rng(drones)
    position = rng.uniform([-0.4, -0.4, 0.2], [0.4, 0.4, 1.8], (drones, 3))
    velocity = rng.normal(0.0, 0.3, (drones, 3))
    kinds = [TYPES[k % 3 % 2] for k in range(drones)]
    team = [Vehicle(**{**vars(VEHICLES["S"]), "token": t, "interaction_type": t}) for t in kinds]
    found = load(path).forces(position[None], velocity[None], team)[0]
    shares = []
    for i, own in enumerate(kinds):
        force_g, height = 0.0, position[i, 2]
        if anchor is None:
            force_g += ground(tensors, own, height, velocity[i])
        elif height < anchor:
            force_g += ground(tensors, own, height, velocity[i])
            force_g -= ground(tensors, own, anchor, velocity[i])
        for j in set(range(drones)) - {i}:
            apart = position[j] - position[i]
            inputs = np.concatenate([apart, velocity[j] - velocity[i]])
            shares.append(weight(apart))
            force_g += shares[-1] * network(tensors, f"pair.{kinds[j]}.{own}", inputs)
        expected = [0.0, 0.0, force_g * GRAM_FORCE] - DRAG * velocity[i]
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=1e-12)
    if drones > 3:  # pairs outside, inside, and between
        assert 0.0 in shares
        assert 1.0 in shares
        assert any(0.0 < share < 1.0 for share in shares)
