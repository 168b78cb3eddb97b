"""The benchmarks import; how fast anything is, no test measures."""

from __future__ import annotations

import importlib

import pytest

from tests.helpers.sources import ROOT, files_below

BENCHMARKS = [file.stem for file in files_below(ROOT / "benchmarks", "*.py")]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_imports(name):
    assert importlib.import_module(f"benchmarks.{name}").__doc__
