"""The rules of the house beside ruff's: who may import whom, and what every file has."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from graphlib import TopologicalSorter
from itertools import zip_longest

import pytest

from tests.helpers.imports import (
    OUTER,
    ROOT,
    SOURCES,
    files_below,
    imported_modules,
    imports,
    level,
    parsed,
)


def fields(body: list[ast.stmt], lines: list[str]) -> Iterator[tuple[list[str], str]]:
    """Public names that each statement binds, and the docstring below or comment beside it."""
    for node, after in zip_longest(body, body[1:]):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        names = [part.id for t in targets for part in ast.walk(t) if isinstance(part, ast.Name)]
        public = [name for name in names if not name.startswith("_")]
        if public and not _is_type_variable(node):
            yield public, _text(after) or lines[(node.end_lineno or 0) - 1].partition("  # ")[2]


def _text(node: ast.stmt | None) -> str:
    value = node.value if isinstance(node, ast.Expr) else None
    text = value.value if isinstance(value, ast.Constant) else ""
    return text if isinstance(text, str) else ""


def _is_type_variable(node: ast.stmt) -> bool:
    value = getattr(node, "value", None)
    return isinstance(value, ast.Call) and ast.unparse(value.func) in ("TypeVar", "ParamSpec")


def classes() -> dict[str, ast.ClassDef]:
    """Every public class of the package by its full name."""
    return {
        f"{module}.{node.name}": node
        for module in SOURCES
        for node in parsed(module).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    }


CLASSES = classes()


def explained(name: str) -> set[str]:
    """Fields of a class that have a docstring, there, in its own, or in a class that it extends."""
    node = CLASSES[name]
    module = name.rpartition(".")[0]
    lines = text_of(module).splitlines()
    found = {field for names, text in fields(node.body, lines) if text for field in names}
    found |= set(re.findall(r"^\s+(\w+): ", ast.get_docstring(node) or "", re.MULTILINE))
    bound = dict(imports(parsed(module), module))
    for base in node.bases:
        word = ast.unparse(base)
        full = bound.get(word, f"{module}.{word}")
        if full in CLASSES:
            found |= explained(full)
    methods = {f.name for f in node.body if isinstance(f, ast.FunctionDef)}
    if {"reset", "act"} <= methods:  # an `Agent`, whose protocol says what these are
        found |= {"requires", "privileged"}
    return found


def unexplained(module: str) -> Iterator[str]:
    """Constants and fields of a module that nothing explains."""
    lines = text_of(module).splitlines()
    for names, text in fields(parsed(module).body, lines):
        if not text:
            yield from (name for name in names)
    for node in parsed(module).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            known = explained(f"{module}.{node.name}")
            for names, _ in fields(node.body, lines):
                yield from (f"{node.name}.{name}" for name in names if name not in known)


def count(module: str) -> int:
    """How many constants and fields are public in a module."""
    lines = text_of(module).splitlines()
    inside = [n.body for n in parsed(module).body if isinstance(n, ast.ClassDef)]
    return sum(len(names) for b in (parsed(module).body, *inside) for names, _ in fields(b, lines))


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


def test_fields_and_constants_say_what_they_are():
    """Nearly all: one that a name and its neighbours explain may stand without."""
    bare = [f"{module}.{name}" for module in SOURCES for name in unexplained(module)]
    assert len(bare) <= 0.02 * sum(map(count, SOURCES)), f"not explained: {bare}"


def test_files_are_short_and_finished():
    tests = files_below(ROOT / "tests", "*.py")
    texts = {file: file.read_text(encoding="utf-8") for file in (*SOURCES.values(), *tests)}
    most = dict.fromkeys(texts, 500) | dict.fromkeys(tests, 750)  # 100 to 300 as a habit
    assert not [file for file, text in texts.items() if text.count("\n") > most[file]]
    assert not [f for f, text in texts.items() if re.search(r"\b(TO" r"DO|FIX" r"ME)\b", text)]


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
