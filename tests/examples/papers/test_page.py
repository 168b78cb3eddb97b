"""The table of docs/papers.md: what it names exists, and its numbers are those of the results."""

from __future__ import annotations

import importlib
import json
from collections import Counter
from functools import reduce
from pathlib import Path

import pytest

from examples.papers import page
from examples.papers.dmpc_swarm.__main__ import COMMANDS as DMPC_SWARM
from examples.papers.neural_swarm2.__main__ import COMMANDS as NEURAL_SWARM2
from examples.papers.rth3d.__main__ import COMMANDS as RTH3D

COMMANDS = {"neural_swarm2": NEURAL_SWARM2, "dmpc_swarm": DMPC_SWARM, "rth3d": RTH3D}
ITEMS = page.items()
RESULTS = page.load_results()


def test_every_function_that_is_named_exists():
    for item in ITEMS:
        if item.code:
            module, _, name = item.code.partition(":")
            assert reduce(getattr, name.split("."), importlib.import_module(module)), item


def test_every_test_that_is_named_exists():
    for source in (source for item in ITEMS for source in item.sources):
        if source.startswith("tests/"):
            path, _, name = source.partition("::")
            assert f"def {name}(" in (page.ROOT / path).read_text(encoding="utf-8"), source


def test_every_command_that_is_named_exists_and_found_what_is_said_of_it():
    for item in ITEMS:
        for source in item.sources:
            if not source.startswith("tests/"):
                paper, command, _ = source.split(" ", 2)
                assert command in COMMANDS[paper], source
                assert item._replace(evidence=source).results(RESULTS), source


def test_what_is_not_compared_or_differs_says_why():
    for item in ITEMS:
        verdict = item.verdict(RESULTS)
        if verdict == "not compared":
            assert item.reason, item
        if verdict == "differs":
            reasons = [row["difference"].partition(": ")[2] for row in item.results(RESULTS)]
            assert item.reason or any(reasons), item


def test_most_items_hold():
    counts = Counter(item.verdict(RESULTS) for item in ITEMS)
    assert len(ITEMS) >= 103 and counts["holds"] >= 78


def test_the_tables_are_what_items_and_results_give():
    for name, text in page.pages(RESULTS).items():
        assert (page.GENERATED / f"{name}.md").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("said", "verdict"),
    [
        (["agrees", "nothing to compare"], "holds"),
        (["agrees", "differs: for a reason"], "differs"),
        (["differs, unexplained"], "differs"),
        (["put in", "nothing to compare"], "put in"),
        (["put in", "agrees"], "holds"),
        (["nothing to compare"], "measured"),
        ([], "not compared"),
    ],
)
def test_a_verdict_counts_what_could_have_come_out_otherwise(said, verdict):
    found = {"rth3d figure-5": [{"quantity": "ratio", "difference": each} for each in said]}
    item = page.Item("RTH3D", "Fig. 5", "", "", "rth3d figure-5 ratio", "")
    assert item.verdict(found) == verdict


def test_results_are_collected_by_command(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "RESULTS", tmp_path / "kept.json")
    row = {"quantity": "x", "paper": "1", "result": 1.0, "spread": None, "difference": "agrees"}
    for name, rows in (("figure_3a", [row]), ("losses", None)):
        path = tmp_path / "runs" / "dmpc_swarm" / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"comparison": rows} if rows else {}), encoding="utf-8")
    page.collect(tmp_path / "runs")
    assert page.load_results() == {"dmpc_swarm figure-3a": [row]}
    page.collect(Path(tmp_path / "nothing"))
    assert page.load_results() == {"dmpc_swarm figure-3a": [row]}
