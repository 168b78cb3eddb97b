"""Lint what changed and run the tests nearest to it, for a minute: `make quick`."""

from __future__ import annotations

import ast
import subprocess
import sys
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

from tests.helpers.imports import ROOT, SOURCES, files_below, imported_modules, imports, parsed

BUDGET_S = 60.0  # after this time no further test begins
DOCS_TESTS = ("tests/test_docs.py",)  # what sees a page of the documentation


def changed_files() -> list[str]:
    """Paths below the root that differ from the last commit, or that it changed if none does."""

    def listed(*command: str) -> list[str]:
        done = subprocess.run(("git", *command), cwd=ROOT, capture_output=True, text=True)
        return done.stdout.split("\n")[:-1]

    new = listed("ls-files", "--others", "--exclude-standard")
    paths = listed("diff", "--name-only", "HEAD") + new or listed("diff", "--name-only", "HEAD~1")
    return [path for path in paths if (ROOT / path).is_file()]


@cache
def test_files() -> dict[str, frozenset[str]]:
    """Every file of tests by its module's name, and the modules that it imports."""
    found = {}
    for file in files_below(ROOT / "tests", "*.py"):
        name = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(file.read_text(encoding="utf-8"))
        helpers = {full for _, full in imports(tree, name) if full.startswith("tests.")}
        helpers |= {helper.rpartition(".")[0] for helper in helpers}
        found[name] = frozenset(imported_modules(tree, name) | helpers)
    return found


def nearest_tests(changed: Iterable[str]) -> list[str]:
    """Test files that import what changed, directly or through others; the nearest first."""
    paths, pages = list(changed), [path for path in changed if path.endswith((".md", ".rst"))]
    by_path = {str(file.relative_to(ROOT)): name for name, file in SOURCES.items()}
    graph = {name: imported_modules(parsed(name), name) for name in SOURCES} | test_files()
    reached = {by_path.get(path, path.removesuffix(".py").replace("/", ".")) for path in paths}
    order = sorted(reached & set(graph))
    while layer := sorted(n for n, used in graph.items() if n not in reached and used & reached):
        reached |= set(layer)
        order += layer
    tests = [f"{name.replace('.', '/')}.py" for name in order if ".test_" in name]
    return [*dict.fromkeys([*(DOCS_TESTS if pages else ()), *tests])]


class Budget:
    """A pytest plugin that begins no test after a given time."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.end = seconds, time.monotonic() + seconds

    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        """End the session behind the first test that ends late."""
        if time.monotonic() > self.end:
            text = f"{self.seconds:g} s are over at {item.nodeid}; `make test` runs them all"
            item.session.shouldstop = text


def main() -> int:
    """Print what is checked, and return the exit status of the first that fails."""
    changed = changed_files()
    python = [path for path in changed if path.endswith(".py")]
    print(f"{len(changed)} files changed: {' '.join(changed)}")
    for command in (["check"], ["format", "--check"]):
        if (
            python
            and subprocess.run([Path(sys.executable).parent / "ruff", *command, *python]).returncode
        ):
            return 1
    tests = nearest_tests(changed)
    return int(pytest.main(["-q", "-x", *tests], plugins=[Budget(BUDGET_S)])) if tests else 0


if __name__ == "__main__":
    sys.exit(main())
