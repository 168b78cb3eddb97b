"""Tests of what an import loads and refuses, of the names that examples import, and of benchmarks.

Which module may import which is checked by import-linter (`make lint`).
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.helpers.sources import OUTER, ROOT, SOURCES, files_below


def python(script: str) -> subprocess.CompletedProcess[str]:
    """Run a script in a process of its own, from the checkout's root."""
    command = [sys.executable, "-c", script]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize("bare", OUTER)
def test_bare_names_refuse_to_be_imported(bare):
    done = python(f"import {bare}")
    assert done.returncode == 1
    assert re.search(rf"ImportError: .*\bimport swarm_envs\.{bare}\b", done.stderr)


def test_importing_loads_nothing_heavy():
    """One process imports them in turn, each with what it may not load."""
    script = "import sys"
    for module, absent in (
        ("swarm_envs", ("torch", "matplotlib", "scipy.optimize", "pybullet")),
        ("swarm_envs.cli", ("torch", "matplotlib", "pybullet")),
        ("swarm_envs.swap_v1", ("torch", "matplotlib", "imageio")),
    ):
        script += f"; import {module}; print({module!r}, {{*{absent!r}}} & {{*sys.modules}})"
    done = python(script)
    assert done.returncode == 0, done.stderr
    assert [line.split(" ", 1)[1] for line in done.stdout.splitlines()] == ["set()"] * 3, (
        done.stdout
    )


def test_no_array_is_unpickled():
    for name, file in SOURCES.items():
        assert not re.search(r"allow_pickle=(?!False)", file.read_text("utf-8")), name


def examples() -> Iterator[tuple[str, str]]:
    """Yield name and text of every piece of Python that the documentation shows."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S):
            yield page.name, block
    for file in (*(ROOT / "examples").rglob("*.py"), *(ROOT / "docs/assignments").glob("*.py")):
        yield file.name, file.read_text("utf-8")
    for file in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        for cell in json.loads(file.read_text("utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                text = re.sub(r"^(\s*)[%!].*", r"\1pass", "".join(cell["source"]), flags=re.M)
                yield file.name, text


def imported(text: str) -> Iterator[tuple[str, str]]:
    """Yield pairs of a module of the package and a name that a piece of Python imports of it."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module in SOURCES:
            yield from ((node.module, alias.name) for alias in node.names)


def test_examples_import_only_public_names():
    for place, text in examples():
        for module, name in imported(text):
            listed = getattr(importlib.import_module(module), "__all__", ())
            assert name in listed or f"{module}.{name}" in SOURCES, f"{place}: {module}.{name}"


@pytest.mark.parametrize("name", [file.stem for file in files_below(ROOT / "benchmarks", "*.py")])
def test_a_benchmark_imports(name):
    """Benchmarks import; no test measures time."""
    assert importlib.import_module(f"benchmarks.{name}").__doc__


def test_every_task_flies_without_docstrings():
    """`python -OO` removes docstrings and assertions; kernels are interpreted, which is faster."""
    code = """
import swarm_envs
for task in swarm_envs.TASKS:
    env = swarm_envs.make(task, physics="batch")
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
"""
    given = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-OO", "-c", code], check=True, env=given)
