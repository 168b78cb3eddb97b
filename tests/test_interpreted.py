"""Kernels mean the same compiled and interpreted: Python is the second implementation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.scenarios import SCENARIOS
from tests.helpers.sources import ROOT


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of what a process without compilation writes."""
    folder = tmp_path_factory.mktemp("interpreted")
    command = [sys.executable, "-m", "tests.helpers.scenarios", str(folder)]
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("name", SCENARIOS)
def test_interpreted_kernels_give_what_compiled_ones_give(name: str, interpreted: Path) -> None:
    compiled = SCENARIOS[name]()
    with np.load(interpreted / f"{name}.npz") as arrays:
        assert set(arrays) == set(compiled)
        for field, expected in compiled.items():
            np.testing.assert_allclose(arrays[field], expected, rtol=1e-6, atol=1e-9, err_msg=field)
