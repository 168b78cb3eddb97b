"""Which public names say what they are: fields of classes and constants of modules too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import zip_longest

from tests.helpers.imports import SOURCES, imports, parsed


def fields(body: list[ast.stmt]) -> Iterator[tuple[list[str], str]]:
    """Public names that each statement binds, and the docstring below it, if any."""
    for node, after in zip_longest(body, body[1:]):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        names = [part.id for t in targets for part in ast.walk(t) if isinstance(part, ast.Name)]
        public = [name for name in names if not name.startswith("_")]
        if public and not _is_type_variable(node):
            yield public, _text(after)


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
    found = {field for names, text in fields(node.body) if text for field in names}
    found |= set(re.findall(r"^\s+(\w+): ", ast.get_docstring(node) or "", re.MULTILINE))
    module = name.rpartition(".")[0]
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
    for names, text in fields(parsed(module).body):
        if not text:
            yield from (name for name in names)
    for node in parsed(module).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            known = explained(f"{module}.{node.name}")
            for names, _ in fields(node.body):
                yield from (f"{node.name}.{name}" for name in names if name not in known)


def count(module: str) -> int:
    """How many constants and fields are public in a module."""
    inside = [n.body for n in parsed(module).body if isinstance(n, ast.ClassDef)]
    return sum(len(names) for b in (parsed(module).body, *inside) for names, _ in fields(b))
