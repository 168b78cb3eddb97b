"""Modules of the package and what is public in them, read from the sources without importing."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from itertools import zip_longest
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "swarm_envs"
LEFT_OUT = ("__main__", "commands", "cli")
"""Parts of names that the reference leaves to the page of the commands."""


@cache
def modules() -> dict[str, Path]:
    """File of every module by its import name; folders behind links are the package's too."""
    found = {}
    for file in _python_files(PACKAGE):
        parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
        if not set(LEFT_OUT) & set(parts):
            found[".".join(parts).removesuffix(".__init__")] = file
    return dict(sorted(found.items()))


def _python_files(folder: Path) -> Iterator[Path]:
    yield from folder.glob("*.py")
    for inner in folder.iterdir():
        if (inner / "__init__.py").exists():  # starters of assignments are no modules
            yield from _python_files(inner)


@cache
def public_names() -> frozenset[str]:
    """Full names of all modules, functions, classes, constants, methods and fields."""
    found = set(modules())
    for module, file in modules().items():
        found |= {f"{module}.{name}" for name in _defined(ast.parse(file.read_text("utf-8")).body)}
    return frozenset(name for name in found if "._" not in name)


def _defined(body: list[ast.stmt]) -> Iterator[str]:
    """Names that a module or class binds, constants and fields only where a docstring follows."""
    for node, after in zip_longest(body, body[1:]):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        if isinstance(node, ast.ClassDef):
            yield from (f"{node.name}.{inner}" for inner in _defined(node.body))
        if isinstance(node, ast.Assign | ast.AnnAssign) and _is_text(after):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                yield from (t.id for t in ast.walk(target) if isinstance(t, ast.Name))


def _is_text(node: ast.stmt | None) -> bool:
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


@cache
def type_aliases() -> list[str]:
    """Names in capitals and small letters that modules bind to types, such as `FloatArray`."""
    found = set()
    for file in modules().values():
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                if name[0].isupper() and not name.isupper() and len(name) > 1:
                    found.add(name)
    return sorted(found)


def exports(package: str) -> list[tuple[str, str]]:
    """Return the names in a package's `__all__`, each with its full name."""
    file = modules()[package]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    homes = {
        alias.asname or alias.name: f"{node.module}.{alias.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    assigned = [n.value for n in tree.body if isinstance(n, ast.Assign) and _binds_all(n)]
    offered = [e for value in assigned for e in getattr(value, "elts", [])]
    names = [e.value for e in offered if isinstance(e, ast.Constant)]
    return [(str(name), homes[str(name)]) for name in names if name in homes]


def listed_names(module: str) -> list[tuple[str, str]]:
    """The names in the `__all__` of a module that defines them, with their full names."""
    tree = ast.parse(modules()[module].read_text(encoding="utf-8"))
    assigned = [n.value for n in tree.body if isinstance(n, ast.Assign) and _binds_all(n)]
    found = [e.value for value in assigned for e in getattr(value, "elts", [])]
    return [(str(name), f"{module}.{name}") for name in found]


def _binds_all(node: ast.Assign) -> bool:
    return ast.unparse(node.targets[0]) == "__all__"


def resolve(text: str, where: str) -> str | None:
    """Full name of what a word in backticks names, if it is public.

    Args:
        text: the word, such as `forces`, `InteractionModel.forces`, or a full name.
        where: full name of the thing whose docstring it stands in.
    """
    word = text.removesuffix("()")
    scopes = [where.rsplit(".", k)[0] for k in range(3)] if "." in where else [where]
    candidates = [word, *(f"{scope}.{word}" for scope in scopes)]
    return next((name for name in candidates if name in public_names()), None)
