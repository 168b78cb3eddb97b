"""Kernels mean the same compiled and interpreted: Python is the second implementation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.scenarios import LONG, SCENARIOS
from tests.helpers.sources import ROOT

SHORT = [name for name in SCENARIOS if name not in LONG]


def interpret(folder: Path, *names: str) -> Path:
    """Return the folder, with what a process without compilation writes of scenarios."""
    command = [sys.executable, "-m", "tests.helpers.scenarios", str(folder), *names]
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def check(name: str, folder: Path) -> None:
    """Compare what compiled kernels give in a scenario with what interpreted ones gave."""
    compiled = SCENARIOS[name]()
    with np.load(folder / f"{name}.npz") as arrays:
        assert set(arrays) == set(compiled)
        for field, expected in compiled.items():
            np.testing.assert_allclose(arrays[field], expected, rtol=1e-6, atol=1e-9, err_msg=field)


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of what a process without compilation writes of short scenarios."""
    return interpret(tmp_path_factory.mktemp("interpreted"), *SHORT)


@pytest.mark.parametrize("name", SHORT)
def test_interpreted_kernels_give_what_compiled_ones_give(name: str, interpreted: Path) -> None:
    check(name, interpreted)


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_interpreted_kernels_give_it_in_long_scenarios_too(name: str, tmp_path: Path) -> None:
    check(name, interpret(tmp_path, name))
