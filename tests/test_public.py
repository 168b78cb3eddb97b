"""Public is what `__all__` lists: from outside of a package nobody uses anything else."""

from __future__ import annotations

import ast
import json
import re
from collections import defaultdict
from collections.abc import Iterator

from tests.helpers.imports import ROOT, SOURCES, imports, parsed

MOST_NAMES = 550


def listed(module: str) -> set[str]:
    """What the `__all__` of a module lists."""
    for node in parsed(module).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def package_of(module: str) -> str:
    """The package to which a module belongs; of baselines and training, the one inside.

    The command line and its commands are one, and so are the versions of a task.
    """
    parts = re.sub(r"_v\d+$", "", module.replace(".cli", ".commands")).split(".")
    deep = len(parts) > 2 and parts[1] in ("baselines", "training")
    return ".".join(parts[1:3] if deep else parts[1:2])


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


def test_the_list_is_short():
    names = set().union(*map(listed, SOURCES))
    assert len(names) <= MOST_NAMES


def test_what_is_listed_exists():
    for module in SOURCES:
        bound = {local for local, _ in imports(parsed(module), module)}
        for node in ast.walk(parsed(module)):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                bound.add(node.name)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                bound.add(node.id)
        lazy = {"__getattr__"} <= bound
        assert lazy or listed(module) <= bound, f"{module}: {listed(module) - bound}"


def test_no_public_function_or_class_is_defined_twice():
    places: dict[str, list[str]] = defaultdict(list)
    for module in SOURCES:
        names = {
            node.name
            for node in parsed(module).body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
        }
        for name in names:
            places[name].append(module)
    assert not {name: modules for name, modules in places.items() if len(modules) > 1}
