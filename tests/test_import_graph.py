"""The picture of who imports whom is true, and nobody imports in a circle."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter

import pytest

from tests.helpers.import_graph import PICTURE, arrows, below, package_graph, picture, rows
from tests.helpers.imports import SOURCES, imported_modules, parsed


def test_the_picture_in_the_docs_is_current():
    redraw = "docs/imports.svg is out of date: run `python -m tests.helpers.import_graph`"
    assert PICTURE.read_text(encoding="utf-8") == picture(), redraw


def test_packages_import_in_no_circle():
    reached = below(package_graph())
    assert not [name for name, others in reached.items() if name in others]


def test_modules_import_in_no_circle_while_they_are_imported():
    """Within functions two modules may know each other; at import that would depend on order."""
    graph = {name: imported_modules(parsed(name), name, deep=False) for name in SOURCES}
    for name, others in graph.items():
        others -= {other for other in others if f"{name}.".startswith(f"{other}.")}
    assert len([*TopologicalSorter(graph).static_order()]) >= len(SOURCES)


def test_what_follows_from_others_is_not_drawn():
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert arrows(graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
    assert rows(graph) == [["c"], ["b"], ["a"]]


def test_a_circle_is_found():
    with pytest.raises(CycleError):
        below({"a": {"b"}, "b": {"a"}})
