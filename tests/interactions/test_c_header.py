"""The C header of a force model, compiled by a C compiler and held against the simulator."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions import load as load_model
from swarm_envs.interactions.c_header import c_header
from swarm_envs.interactions.forces import all_forces
from swarm_envs.vehicles import GRAM_FORCE

COMPILER = next(filter(None, map(shutil.which, ("gcc", "cc", "clang"))), None)
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion"]
STRICT += ["-Wconversion", "-Wshadow", "-ffp-contract=off"]
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def run_program(folder: Path, source: str, rows: np.ndarray) -> np.ndarray:
    """Return what a program that includes a header writes for rows, as float32."""
    (folder / "program.c").write_text(source)
    command = [str(COMPILER), *STRICT, "program.c", "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run([folder / "program"], input=rows.tobytes(), capture_output=True)
    assert done.returncode == 0, "the header's own test finds it wrong"
    return np.frombuffer(done.stdout, np.float32)


NEIGHBOURS = 6
BELIEFS = Path(str(resources.files("swarm_envs.baselines.neural_swarm").joinpath("weights")))
SHIPPED_FORCES = ("learned", "deep-set", *sorted(BELIEFS.glob("*.safetensors")))


# Reads states of six neighbours, of which the first `count` are there, and writes three forces.
FORCE_PROGRAM = """
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
FORCE_ROW = np.dtype(
    [
        ("count", np.int32),
        ("own", np.int32),
        ("types", np.int32, NEIGHBOURS),
        ("position", np.float32, 3),
        ("velocity", np.float32, 3),
        ("relative", np.float32, (NEIGHBOURS, 6)),
    ]
)


def check_force(model: InteractionModel, folder: Path, rows: np.ndarray) -> None:
    """Compare the header of a model, compiled, with the float64 model."""
    (folder / "learned.h").write_text(c_header(model))
    force = run_program(folder, FORCE_PROGRAM, rows).reshape(-1, 3)
    expected = np.array([force_in_python(model, row) for row in rows])
    assert np.abs(expected).max() > 5.0 * GRAM_FORCE
    np.testing.assert_allclose(force, expected, rtol=0.0, atol=1e-3 * GRAM_FORCE)


def force_in_python(model: InteractionModel, row: np.ndarray) -> np.ndarray:
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
    rows = np.zeros(count, FORCE_ROW)
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
    rows = np.zeros(len(cases), FORCE_ROW)
    for row, (edge, factor, height) in zip(rows, cases, strict=True):
        row["count"], row["position"][2] = 1, height
        row["relative"][0, :3] = np.multiply(edge, factor)
        row["velocity"] = row["relative"][0, 3:] = 0.3, -0.2, 0.1
    return rows


@needs_compiler
@pytest.mark.parametrize("name", SHIPPED_FORCES)
def test_shipped_models_in_c(name: str | Path, tmp_path: Path) -> None:
    model = load_model(name)
    rows = np.concatenate([random_rows(np.random.default_rng(0), 4000, 2), edge_rows()])
    check_force(model, tmp_path, rows)


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
    model = load_model(tmp_path / "odd.safetensors")
    check_force(model, tmp_path, random_rows(rng, 500, 3))


def test_only_deep_sets_are_exported() -> None:
    with pytest.raises(ValueError, match="'wake' is neither composed nor a deep set"):
        c_header(load_model("wake"), "wake")


def test_the_header_needs_no_heap_and_its_names_begin_with_the_prefix() -> None:
    text = c_header(load_model("learned"), "pilot")
    assert not re.search("double|malloc|learned_|#include (?!<math.h>)", text)
    assert text != c_header(load_model("learned"), "pilot", 1)  # another self-test
    for name in ("2fast", "a b"):
        with pytest.raises(ValueError, match=f"name is '{name}', but must be a letter"):
            c_header(load_model("learned"), name)
