"""The package's modules, how high each stands, and whom it imports, read from the sources."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "swarm_envs"
OUTER = ("agents", "baselines", "training")

BASE = 0  # vehicles, state and the other single modules at the bottom
_BASE_MODULES = (
    *("", "vehicles", "state", "errors", "motors", "hall", "files", "c_text", "compiled"),
    *("tables", "neighbors", "arguments", "trajectories", "noise"),
)
LEVELS = dict.fromkeys(_BASE_MODULES, BASE)
LEVELS |= {"interactions": 1, "control": 1, "physics": 1, "tasks": 2, "viewing": 2, "envs": 3}
LEVELS |= {"deploy": 3, "shows": 6}
FACE = 4  # swap_v0 and the like: what users import
OUTER_LEVELS = {"agents": 5, "baselines": 6, "training": 7}
CLI = 8


def files_below(folder: Path, pattern: str = "*") -> list[Path]:
    """Files of a folder in order, but for caches: another process may empty those meanwhile."""
    found = []
    for home, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        found += [Path(home, name) for name in names if fnmatch(name, pattern)]
    return sorted(found)


def sources() -> dict[str, Path]:
    """Every module of the package by its import name."""
    found = {f.relative_to(PACKAGE): f for f in files_below(PACKAGE, "*.py")}
    for folder in OUTER:
        found |= {f.relative_to(ROOT): f for f in files_below(ROOT / folder, "*.py")}
    starters = Path("assignments")  # for students: only its __init__ is the package's
    found = {path: f for path, f in found.items() if starters not in [*path.parents][1:]}
    names = {".".join(("swarm_envs", *p.with_suffix("").parts)): f for p, f in found.items()}
    return {name.removesuffix(".__init__"): f for name, f in sorted(names.items())}


SOURCES = sources()


def level(name: str) -> int:
    """How high a module stands: it may import its own level and those below."""
    part = f"{name}.".split(".")[1]
    if part in ("cli", "commands", "assignments"):
        return CLI
    return OUTER_LEVELS.get(part, LEVELS.get(part, FACE))


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def running_nodes(node: ast.AST, deep: bool = True) -> Iterator[ast.AST]:
    """The nodes below one that run; only those that run at import unless `deep`."""
    for child in ast.iter_child_nodes(node):
        if is_type_checking(child):
            continue
        if not deep and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        yield child
        yield from running_nodes(child, deep)


def imports(tree: ast.AST, name: str, deep: bool = True) -> Iterator[tuple[str, str]]:
    """Pairs of local name and full dotted name that a module's import statements bind."""
    is_package = SOURCES.get(name, Path()).name == "__init__.py"
    for node in running_nodes(tree, deep):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.asname or alias.name.split(".")[0], alias.name
        elif isinstance(node, ast.ImportFrom):
            parts = name.split(".")
            up = parts[: len(parts) - node.level + is_package] if node.level else []
            origin = ".".join([*up, *filter(None, [node.module])])
            for alias in node.names:
                yield alias.asname or alias.name, f"{origin}.{alias.name}"


def imported_modules(tree: ast.AST, name: str, deep: bool = True) -> set[str]:
    """Modules of this package that one module imports."""
    found = set()
    for _, target in imports(tree, name, deep):
        if target == "swarm_envs" or target.startswith("swarm_envs."):
            found.add(target if target in SOURCES else target.rpartition(".")[0])
    return found


@cache
def parsed(name: str) -> ast.Module:
    """The syntax tree of a module."""
    return ast.parse(SOURCES[name].read_text(encoding="utf-8"))
