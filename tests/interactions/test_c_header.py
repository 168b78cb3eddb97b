"""The exported C header, compiled by a C compiler and held against the float64 model."""

from __future__ import annotations

import itertools
import json
import subprocess
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs.cli import main
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.c_header import c_header
from swarm_envs.interactions.forces import all_forces
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.c_programs import build, needs_compiler

NEIGHBOURS = 6
BELIEFS = Path(str(resources.files("swarm_envs.baselines.neural_swarm").joinpath("weights")))
SHIPPED = ("learned", *sorted(BELIEFS.glob("*.safetensors")))

# Reads states of six neighbours, of which the first `count` are there, and writes three forces.
PROGRAM = """
#define LEARNED_SELF_TEST
#include "learned.h"
#include <stdio.h>
struct row { int count, own, types[6]; float position[3], velocity[3], relative[36]; };
int main(void)
{
    struct row r;
    float force[3];
    while (fread(&r, sizeof r, 1, stdin) == 1) {
        learned_force(r.own, r.position, r.velocity, r.count, r.types, r.relative, force);
        if (fwrite(force, sizeof force, 1, stdout) != 1) return 2;
    }
    return learned_self_test() < 1e-3f ? 0 : 1;
}
"""
ROW = np.dtype(
    [
        ("count", np.int32),
        ("own", np.int32),
        ("types", np.int32, NEIGHBOURS),
        ("position", np.float32, 3),
        ("velocity", np.float32, 3),
        ("relative", np.float32, (NEIGHBOURS, 6)),
    ]
)


def in_c(text: str, folder: Path, rows: np.ndarray) -> np.ndarray:
    """Forces (rows, 3), N, from a compiled header."""
    (folder / "learned.h").write_text(text)
    (folder / "program.c").write_text(PROGRAM)
    build(folder, "program.c")
    done = subprocess.run([folder / "program"], input=rows.tobytes(), capture_output=True)
    assert done.returncode == 0, "the header's own test finds it wrong"
    return np.frombuffer(done.stdout, np.float32).reshape(-1, 3)


def in_python(model: InteractionModel, row: np.ndarray) -> np.ndarray:
    """The float64 model's force (3,) on the drone of one row, N."""
    others = row["relative"][: row["count"]].astype(np.float64)
    position, velocity = (row[key].astype(np.float64) for key in ("position", "velocity"))
    p = np.concatenate([position[None], position + others[:, :3]])[None]
    v = np.concatenate([velocity[None], velocity + others[:, 3:]])[None]
    types = np.concatenate([[row["own"]], row["types"][: row["count"]]])[None].astype(np.int64)
    out = np.empty_like(p)
    all_forces(model.packed, types, p, v, out)
    return out[0, 0]


def random_rows(rng: np.random.Generator, count: int, kinds: int) -> np.ndarray:
    """States of every kind: low and aloft, none to six neighbours, beyond clamps and volume."""
    rows = np.zeros(count, ROW)
    rows["count"] = rng.integers(0, NEIGHBOURS + 1, count)
    rows["own"] = rng.integers(0, kinds, count)
    rows["types"] = rng.integers(0, kinds, (count, NEIGHBOURS))
    rows["position"] = rng.uniform([-2.0, -2.0, 0.02], [2.0, 2.0, 1.5], (count, 3))
    rows["velocity"] = rng.normal(0.0, 0.6, (count, 3))
    reach = [0.36, 0.36, 1.15]
    rows["relative"][..., :3] = rng.uniform(np.negative(reach), reach, (count, NEIGHBOURS, 3))
    rows["relative"][..., 3:] = rng.normal(0.0, 0.8, (count, NEIGHBOURS, 3))
    return rows


def edge_rows() -> np.ndarray:
    """Neighbours just inside and outside of every face of the volume, drones about the anchor."""
    edges = [(0.35, 0.0, 0.1), (0.0, -0.35, 0.1), (0.0, 0.0, 1.1), (0.25, 0.0, 0.1), (0, 0, -0.8)]
    cases = list(itertools.product(edges, (1 - 1e-5, 1 + 1e-5), (0.6 - 1e-4, 0.6, 0.6 + 1e-4)))
    rows = np.zeros(len(cases), ROW)
    for row, (edge, factor, height) in zip(rows, cases, strict=True):
        row["count"], row["position"][2] = 1, height
        row["relative"][0, :3] = np.multiply(edge, factor)
        row["velocity"] = row["relative"][0, 3:] = 0.3, -0.2, 0.1
    return rows


@needs_compiler
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_models_in_c(name: str | Path, tmp_path: Path) -> None:
    model = load(name)
    rows = np.concatenate([random_rows(np.random.default_rng(0), 4000, 2), edge_rows()])
    force = in_c(c_header(model), tmp_path, rows)
    expected = np.array([in_python(model, row) for row in rows])
    error = np.abs(force - expected).max() / GRAM_FORCE
    assert np.abs(expected).max() > 5.0 * GRAM_FORCE
    assert error < 1e-3


@needs_compiler
@pytest.mark.parametrize("anchor", [None, 0.5])
def test_any_model_in_c(tmp_path: Path, anchor: float | None) -> None:
    """Odd widths and names of types, no window, no ranges, with and without anchor."""
    rng = np.random.default_rng(1)
    kinds = ("big one", "a+b", "SELF_TEST")
    widths = {f"phi.{t}": (6, 9, 7, 5) for t in kinds} | {"phi.environment": (4, 3, 5)}
    widths |= {f"rho.{t}": (5, 12, 1) for t in kinds}
    tensors = {f"drag.{t}": rng.uniform(0.0, 0.1, 3) for t in kinds}
    for network, sizes in widths.items():
        for k, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
            tensors[f"{network}.{k}.weight"] = rng.normal(size=(outputs, inputs)) / inputs**0.5
            tensors[f"{network}.{k}.bias"] = rng.normal(size=outputs)
    note = {"format": "deep-set-1", "types": kinds, "anchor_height_m": anchor, "window": None}
    note["command"] = "closes /* the */ comment"
    save_file(tensors, tmp_path / "odd.safetensors", metadata={"swarm_envs": json.dumps(note)})
    model = load(tmp_path / "odd.safetensors")
    rows = random_rows(rng, 500, 3)
    force = in_c(c_header(model), tmp_path, rows)
    expected = np.array([in_python(model, row) for row in rows])
    np.testing.assert_allclose(force, expected, atol=1e-3 * GRAM_FORCE)


def test_the_header_needs_nothing(tmp_path: Path) -> None:
    text = c_header(load("learned"), "belief")
    assert "#include" not in text
    assert "double" not in text
    assert "malloc" not in text
    assert "learned_" not in text
    assert text == c_header(load("learned"), "belief")
    assert text != c_header(load("learned"), "belief", seed=1)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, facts = tmp_path / "wash.h", tmp_path / "facts.json"
    assert main(["export", "force", "--out", str(out), "--json", str(facts)]) == 0
    assert out.read_text() == c_header(load("learned"), "wash")
    assert json.loads(facts.read_text())["weights"] == load("learned").field.weights.size
    assert "wash_force_z" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("model", "name", "said"),
    [
        ("wake", "wake", "'wake' is no deep set"),
        ("learned", "2fast", "name is '2fast', but must be a letter"),
        ("learned", "a b", "name is 'a b'"),
    ],
)
def test_what_cannot_be_exported(model: str, name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        c_header(load(model), name)
