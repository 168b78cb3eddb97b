"""Files of weights that are damaged, or whole, but with numbers that no kernel may be given."""

from __future__ import annotations

import itertools
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs.interactions import load
from swarm_envs.interactions.weights_file import load_weights

Tensors = dict[str, np.ndarray]
TYPES = ["S", "L"]
WIDTHS = {"phi.S": (6, 5, 3), "phi.L": (6, 5, 3), "phi.environment": (4, 5, 3)}
WIDTHS |= {"rho.S": (3, 4, 1), "rho.L": (3, 4, 1)}
WINDOW = {"lateral_m": [0.25, 0.35], "vertical_m": [0.8, 1.1]}
RANGE: dict[str, list[list[float]]] = {
    "pair": [[-1.0] * 6, [1] * 6],
    "environment": [[-2] * 4, [2.0] * 4],
}


def sound_tensors() -> Tensors:
    tensors = {f"drag.{name}": np.full(3, 0.01) for name in TYPES}
    for name, widths in WIDTHS.items():
        for k, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
            tensors[f"{name}.{k}.weight"] = np.ones((outputs, inputs))
            tensors[f"{name}.{k}.bias"] = np.zeros(outputs)
    return tensors


def sound_note() -> dict[str, Any]:
    note = {"format": "deep-set-1", "types": TYPES, "window": WINDOW, "input_range": RANGE}
    return note | {"anchor_height_m": 0.6}


def write(path: Path, tensors: Tensors, note: object) -> Path:
    save_file(tensors, path, metadata={"swarm_envs": json.dumps(note)})
    return path


def refused(path: Path, cause: str) -> None:
    known = "a 'deep-set-1' or 'pairwise-1' or 'composed-1' file"
    pattern = rf"weights file '.*' is damaged or not {known} \(.*{cause}.*\); fit it"
    with pytest.raises(ValueError, match=pattern):
        load_weights(path)


def test_a_sound_file_is_read_as_it_stands(tmp_path: Path) -> None:
    types, field, note = load_weights(write(tmp_path / "w", sound_tensors(), sound_note()))
    assert types == ("S", "L")
    assert note == sound_note()
    assert field.window.tolist() == [0.25, 0.35, 0.8, 1.1]
    assert field.pair_range.tolist() == RANGE["pair"]
    assert field.environment_range.tolist() == RANGE["environment"]
    assert field.anchor_height == 0.6


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("window", None),
        ("window", {"lateral_m": [0.35, 0.35], "vertical_m": [1.1, 1.1]}),
        ("input_range", None),
        ("anchor_height_m", None),
        ("anchor_height_m", 0),
    ],
)
def test_what_a_note_may_say_too(tmp_path: Path, key: str, value: object) -> None:
    load_weights(write(tmp_path / "w", sound_tensors(), sound_note() | {key: value}))


@pytest.mark.parametrize(
    ("name", "tensor", "cause"),
    [
        ("phi.S.0.weight", np.ones(30), "shape"),
        ("phi.S.0.weight", np.ones((5, 7)), "maps 7 to 3"),
        ("phi.S.0.weight", np.ones((0, 6)), "shape"),
        ("phi.S.1.weight", np.ones((3, 4)), "do not fit"),
        ("phi.L.1.bias", np.zeros(2), "shape"),
        ("phi.environment.0.bias", np.full(5, np.inf), "not finite"),
        ("phi.environment.0.bias", np.full(5, -1.1e6), r"beyond 1e\+06"),
        ("drag.S", np.zeros(2), "drag"),
        ("drag.S", np.full(3, -0.1), "drag"),
        ("rho.S.3.weight", np.ones((1, 1)), "networks have"),
    ],
)
def test_tensors_that_would_be_read_out_of_bounds_or_wrongly(
    tmp_path: Path, name: str, tensor: np.ndarray, cause: str
) -> None:
    refused(write(tmp_path / "w", sound_tensors() | {name: tensor}, sound_note()), cause)


@pytest.mark.parametrize("damage", [b"these are no weights", pickle.dumps({"w": 1}), None])
def test_damaged_files(tmp_path: Path, damage: bytes | None) -> None:
    path = write(tmp_path / "w", sound_tensors(), sound_note())
    path.write_bytes(path.read_bytes()[:-100] if damage is None else damage)
    refused(path, "")
    save_file(sound_tensors(), path)
    refused(path, "")
    write(path, sound_tensors(), sound_note() | {"format": "deep-set-9"})
    refused(path, "")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no\.safetensors' does not exist; give the path"):
        load(tmp_path / "no.safetensors")


def test_a_missing_tensor(tmp_path: Path) -> None:
    for name in sound_tensors():
        if not name.startswith("drag."):
            tensors = sound_tensors()
            del tensors[name]
            refused(write(tmp_path / "w", tensors, sound_note()), "")


def one_pair(edit: Callable[[list[list[float]]], object]) -> dict[str, Any]:
    pair = [[float(number) for number in row] for row in RANGE["pair"]]
    edit(pair)
    return RANGE | {"pair": pair}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("types", []),
        ("types", ["S", "S"]),
        ("types", ["S", 1]),
        ("types", ["S", "environment"]),
        ("window", {}),
        ("window", WINDOW | {"lateral_m": [0.35, 0.25]}),
        ("window", WINDOW | {"lateral_m": [-0.1, 0.35]}),
        ("window", WINDOW | {"vertical_m": [0.8]}),
        ("window", WINDOW | {"vertical_m": [0.8, float("nan")]}),
        ("input_range", [[0.0], [1.0]]),
        ("input_range", {"pair": RANGE["pair"]}),
        ("input_range", one_pair(lambda pair: pair[0].pop())),
        ("input_range", one_pair(lambda pair: pair.reverse())),
        ("input_range", one_pair(lambda pair: pair[1].__setitem__(2, float("inf")))),
        ("anchor_height_m", -0.1),
        ("anchor_height_m", True),
        ("anchor_height_m", 10**400),
    ],
)
def test_notes_that_make_no_sense(tmp_path: Path, key: str, value: object) -> None:
    refused(write(tmp_path / "w", sound_tensors(), sound_note() | {key: value}), "")


@pytest.mark.parametrize("note", [[], None])
def test_a_note_that_is_no_object(tmp_path: Path, note: object) -> None:
    refused(write(tmp_path / "w", sound_tensors(), note), "not a JSON object")
