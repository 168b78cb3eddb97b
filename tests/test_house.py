"""The rules of the house beside ruff's: who may import whom and what, and what every file has."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from graphlib import TopologicalSorter

import pytest

from tests.helpers.imports import (
    OUTER,
    ROOT,
    SOURCES,
    imported_modules,
    imports,
    level,
    parsed,
)


def text_of(name: str) -> str:
    """The text of a module."""
    return SOURCES[name].read_text(encoding="utf-8")


def test_the_package_was_found():
    assert {"swarm_envs", "swarm_envs.vehicles", "swarm_envs.agents"} <= set(SOURCES)
    assert {"swarm_envs.baselines", "swarm_envs.training"} <= set(SOURCES)


def offenders(finder: Callable[[str], object]) -> dict[str, object]:
    """The modules in which a finder finds something, and what."""
    return {name: found for name in SOURCES if (found := finder(name))}


def test_modules_import_only_what_stands_below():
    assert not offenders(
        lambda name: {m for m in imported_modules(parsed(name), name) if level(m) > level(name)}
    )


def test_modules_import_in_no_circle_while_they_are_imported():
    """Within functions two modules may know each other; at import that would depend on order."""
    graph = {name: imported_modules(parsed(name), name, deep=False) for name in SOURCES}
    for name, others in graph.items():
        others -= {other for other in others if f"{name}.".startswith(f"{other}.")}
    assert len([*TopologicalSorter(graph).static_order()]) >= len(SOURCES)


def test_torch_loads_only_where_networks_are_trained():
    heavy = offenders(
        lambda name: (
            "torch" in {full.split(".")[0] for _, full in imports(parsed(name), name, deep=False)}
        )
    )
    assert not [n for n in heavy if not re.match(r"swarm_envs\.(training|agents\.networks)\b", n)]


def test_no_array_is_unpickled():
    """Of all else that unpickles, or draws from a global generator, ruff warns."""
    assert not offenders(lambda name: re.search(r"allow_pickle=(?!False)", text_of(name)))


@pytest.mark.parametrize("bare", OUTER)
def test_bare_names_refuse_to_be_imported(bare):
    script = f"import {bare}"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert re.search(rf"ImportError: .*\bimport swarm_envs\.{bare}\b", done.stderr)


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("swarm_envs", ("torch", "matplotlib", "scipy.optimize", "pybullet")),
        ("swarm_envs.swap_v0", ("torch", "matplotlib", "imageio")),
        ("swarm_envs.cli", ("torch", "matplotlib", "pybullet")),
    ],
)
def test_importing_loads_nothing_heavy(module, absent):
    script = f"import sys, {module}; print([m for m in {absent!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("source", "name", "found"),
    [
        ("from swarm_envs.envs import core", "swarm_envs.tasks.swap", {"swarm_envs.envs.core"}),
        ("from ..envs import core", "swarm_envs.tasks.swap", {"swarm_envs.envs.core"}),
        ("import swarm_envs.training", "swarm_envs.agents.protocol", {"swarm_envs.training"}),
        ("def f():\n    import swarm_envs.agents", "swarm_envs.x", {"swarm_envs.agents"}),
        ("if TYPE_CHECKING:\n    import swarm_envs.training", "swarm_envs.x", set()),
    ],
)
def test_the_reader_of_imports(source, name, found):
    assert imported_modules(ast.parse(source), name) == found


def test_the_order_of_the_house():
    order = ["vehicles", "physics.base", "tasks.swap", "envs.core", "swap_v0", "agents.protocol"]
    order += ["baselines.neural_swarm", "training.force_model", "cli"]
    levels = [level(f"swarm_envs.{name}") for name in order]
    assert levels == sorted(set(levels))


SIMULATOR = {"tables", "state", "noise", "neighbors", "motors", "compiled", "hall", "trajectories"}
SIMULATOR |= {"physics", "control", "interactions", "tasks", "envs"}
SIMULATOR |= {"swap", "ring", "formation", "columns", "crowd", "delivery", "gates", "pursuit"}
"""What computes a step and what it is made of: one package, though in several folders."""


def listed(module: str) -> set[str]:
    """What the `__all__` of a module lists."""
    for node in parsed(module).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def package_of(module: str) -> str:
    """The package to which a module belongs; of baselines and training, the one inside.

    The command line and its commands are one, and so is the simulator with its tasks.
    """
    parts = re.sub(r"_v\d+$", "", module.replace(".cli", ".commands")).split(".")
    deep = len(parts) > 2 and parts[1] in ("baselines", "training")
    name = ".".join(parts[1:3] if deep else parts[1:2])
    return "simulator" if name in SIMULATOR else name


def names_used(tree: ast.AST, reader: str) -> Iterator[tuple[str, str]]:
    """Modules of ours, and a name that a source takes of each."""
    for _, full in imports(tree, reader):
        module, _, name = full.rpartition(".")
        if module in SOURCES and full not in SOURCES:
            yield module, name


def examples() -> Iterator[tuple[str, str]]:
    """Name and text of every piece of Python that readers of the documentation see."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S):
            yield page.name, block
    for file in (*(ROOT / "examples").glob("*.py"), *(ROOT / "docs" / "assignments").glob("*.py")):
        yield file.name, file.read_text()
    for file in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        for cell in json.loads(file.read_text())["cells"]:
            if cell["cell_type"] == "code":
                yield (
                    file.name,
                    re.sub(r"^(\s*)[%!].*", r"\1pass", "".join(cell["source"]), flags=re.M),
                )


def unlisted_between_packages() -> dict[str, set[str]]:
    """What packages take of each other without its being listed, by module."""
    found: dict[str, set[str]] = defaultdict(set)
    for reader in SOURCES:
        for module, name in names_used(parsed(reader), reader):
            if package_of(module) != package_of(reader) and name not in listed(module):
                found[module].add(name)
    return found


def unlisted_in_examples() -> dict[str, set[str]]:
    """What examples take without its being listed, by module."""
    found: dict[str, set[str]] = defaultdict(set)
    for _, text in examples():
        for module, name in names_used(ast.parse(text), ""):
            if name not in listed(module):
                found[module].add(name)
    return found


def test_packages_take_of_each_other_only_what_is_listed():
    assert not unlisted_between_packages()


def test_examples_use_only_what_is_listed():
    assert not unlisted_in_examples()
