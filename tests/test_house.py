"""The rules of the house: who may import whom, what nobody may call, what every file has."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests.helpers.documented import count, unexplained
from tests.helpers.imports import OUTER, ROOT, SOURCES, imported_modules, imports, level, parsed


def text_of(name: str) -> str:
    """The text of a module."""
    return SOURCES[name].read_text(encoding="utf-8")


def banned_calls(source: str) -> set[str]:
    """What a source calls that nobody may: unpickling, global random generators."""
    tree = ast.parse(source)
    bound = dict(imports(tree, ""))
    found = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        head, _, tail = ast.unparse(node.func).partition(".")
        origin = bound.get(head, head)
        if tail and "." in origin and origin.split(".")[0] == head:
            origin = head  # `import a.b` binds a
        full = f"{origin}.{tail}" if tail else origin
        if is_banned(full, node):
            found.add(full)
    return found


OWN_GENERATORS = {"default_rng", "Generator", "SeedSequence", "PCG64", "PCG64DXSM", "Philox"}


def is_banned(full: str, call: ast.Call) -> bool:
    module, _, function = full.rpartition(".")
    if module == "numpy.random":
        return function not in OWN_GENERATORS
    if module == "random":
        return function != "Random"
    if full == "numpy.load":
        pickles = {k.arg: ast.unparse(k.value) for k in call.keywords}.get("allow_pickle", "False")
        return pickles != "False"
    pickle = module in {"pickle", "cloudpickle", "dill", "joblib"}
    return full == "torch.load" or (pickle and function in {"load", "loads"})


def numba_internals(source: str) -> set[str]:
    """What a source takes of numba that may change any day: `numba.core`, llvmlite, private names.

    Where numba is imported every private attribute counts, whatever it is of: nobody can see from
    here which objects numba has made.
    """
    tree = ast.parse(source)
    taken = {full for _, full in imports(tree, "")}
    roots = {full.split(".")[0] for full in taken}
    if not roots & {"numba", "llvmlite"}:
        return set()
    bound = dict(imports(tree, ""))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            head, *rest = ast.unparse(node).split(".")
            origin = bound.get(head, head)
            taken.add(".".join([head if origin.startswith(f"{head}.") else origin, *rest]))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "setattr"):
            taken |= {
                f"{ast.unparse(node.args[0])}.{ast.literal_eval(name)}"
                for name in node.args[1:2]
                if isinstance(name, ast.Constant)
            }
    return {name for name in taken if is_internal(name)}


def is_internal(name: str) -> bool:
    """Whether a dotted name is private, dunders and one's own aside, or of numba's inner parts."""
    head, *rest = name.split(".")
    private = any(part.startswith("_") and not part.endswith("__") for part in rest)
    inner = name.startswith("numba.core") or head == "llvmlite"
    return inner or (private and head not in ("self", "cls", "swarm_envs"))


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


def test_torch_loads_only_where_networks_are_trained():
    heavy = offenders(
        lambda name: (
            "torch" in {full.split(".")[0] for _, full in imports(parsed(name), name, deep=False)}
        )
    )
    assert not [n for n in heavy if not re.match(r"swarm_envs\.(training|agents\.networks)\b", n)]


def test_nothing_unpickles_or_uses_a_global_generator():
    assert not offenders(lambda name: banned_calls(text_of(name)))


def test_nothing_takes_what_numba_keeps_to_itself():
    assert not offenders(lambda name: numba_internals(text_of(name)))


def test_every_public_thing_has_a_docstring():
    assert not offenders(lambda name: list(undocumented(parsed(name))))


def test_fields_and_constants_say_what_they_are():
    """Nearly all: one that a name and its neighbours explain may stand without."""
    bare = [f"{module}.{name}" for module in SOURCES for name in unexplained(module)]
    assert len(bare) <= 0.02 * sum(map(count, SOURCES)), f"without docstring: {bare}"


def undocumented(node: ast.AST, name: str = "module") -> Iterator[str]:
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    if any(ast.unparse(mark) == "overload" for mark in getattr(node, "decorator_list", ())):
        return  # the definition that follows has it
    if isinstance(node, documented) and not ast.get_docstring(node):
        yield name
    if isinstance(node, ast.Module | ast.ClassDef):
        for child in node.body:
            child_name = getattr(child, "name", "_")
            if not child_name.startswith("_"):
                yield from undocumented(child, child_name)


def test_files_are_short_and_finished():
    tests = sorted((ROOT / "tests").rglob("*.py"))
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


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import numpy as np\nnp.random.seed(0)", {"numpy.random.seed"}),
        ("from numpy import random\nrandom.rand(3)", {"numpy.random.rand"}),
        ("import random\nrandom.shuffle(x)", {"random.shuffle"}),
        ("from pickle import loads as f\nf(x)", {"pickle.loads"}),
        ("import torch.nn\ntorch.load('x')", {"torch.load"}),
        ("import numpy as np\nnp.load(f, allow_pickle=True)", {"numpy.load"}),
        ("import numpy as np\nnp.random.default_rng(0).normal()\nnp.load(f)", set()),
    ],
)
def test_the_finder_of_banned_calls(source, found):
    assert banned_calls(source) == found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from numba.core import types", {"numba.core.types"}),
        ("import numba.core.ir as ir", {"numba.core.ir"}),
        ("import llvmlite.binding", {"llvmlite.binding"}),
        ("def f():\n    from llvmlite import ir", {"llvmlite.ir"}),
        ("import numba as nb\nnb.core", {"numba.core"}),
        ("from numba import njit\nnjit(f)._cache", {"njit(f)._cache"}),
        ("import numba\nd = numba.njit(f)\nd._compiler", {"d._compiler"}),
        ("import numba\ngetattr(numba, '_x')", {"numba._x"}),
        ("from numba.np import _x", {"numba.np._x"}),
        ("import numba\nnumba.__version__\nself._x\nnumba.njit(f).signatures", set()),
        ("import numpy as np\nnp.core._x", set()),
    ],
)
def test_the_finder_of_numba_s_internals(source, found):
    assert numba_internals(source) == found


def test_the_finder_of_missing_docstrings():
    source = '"""M."""\nclass A:\n    """A."""\n    def f(self): ...\n    def _g(self): ...\n'
    assert list(undocumented(ast.parse(source))) == ["f"]
    stub = "from typing import overload\n@overload\ndef f(x: int) -> int: ...\n"
    assert list(undocumented(ast.parse(f'"""M."""\n{stub}def f(x): ...\n'))) == ["f"]
