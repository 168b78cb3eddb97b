"""The scoreboard as text: numbers are those of the cells, and a page keeps the rest of itself."""

from __future__ import annotations

import json
from typing import Any

import pytest

from swarm_envs.training.scoreboard.standings import (
    BEGIN,
    END,
    align_columns,
    main,
    put_into,
    standings,
    success_rates,
)
from tests.helpers.pages import DOCS

STANDING = {"value": 0.456, "interval": [0.4, 0.5], "tasks": 1, "of": 2}


def cell(task: str, agent: str, status: str, rate: float = 0.0) -> dict[str, Any]:
    values = {"success_rate": {"value": rate}} if status == "flown" else {}
    return {"task": task, "agent": agent, "status": status, "values": values, "episodes": 8}


CONTENT = {
    "manifest": {
        "command": "swarm-envs benchmark --out '/home/me/a b' --workers 2",
        "cpu_s": 121.0,
        "machine": {"cores": 2, "cpu": "A"},
        "versions": {"swarm_envs": "9"},
    },
    "tasks": [{"id": f"swap-circle-{n}-v1", "task": "swap"} for n in (2, 4)]
    + [{"id": "ring-5-v1", "task": "ring"}],
    "agents": [{"name": "a", "privileged": True}, {"name": "b", "privileged": False}],
    "cells": [
        cell("swap-circle-2-v1", "a", "flown", 0.875),
        cell("swap-circle-4-v1", "a", "unsupported"),
        cell("ring-5-v1", "a", "unsupported"),
        cell("swap-circle-2-v1", "b", "failed"),
        cell("swap-circle-4-v1", "b", "flown", 1.0),
        cell("ring-5-v1", "b", "flown", 0.0),
    ],
    "aggregates": {"swap": {"a": STANDING, "b": {**STANDING, "tasks": 2}}, "ring": {}},
}


def test_rows_are_what_the_cells_say():
    assert standings(CONTENT) == [
        ["agent", "swap", "ring"],
        ["a*", "0.46 [0.40, 0.50] (1 of 2)", "-"],
        ["b", "0.46 [0.40, 0.50]", "-"],
    ]
    assert success_rates(CONTENT, "swap") == [
        ["agent", "circle 2", "circle 4"],
        ["a*", "88", "-"],
        ["b", "failed", "100"],
    ]
    assert success_rates(CONTENT, "ring") == [["agent", "5"], ["b", "0"]]


def test_tables_for_terminals_and_for_pages():
    rows = [["agent", "x"], ["longer*", "1"]]
    assert align_columns(rows) == ["agent    x", "longer*  1"]


def test_a_page_gets_the_results_and_keeps_the_rest(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    (tmp_path / "scores.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    main([str(tmp_path), "--into", str(page)])
    first = page.read_text(encoding="utf-8")
    assert first.startswith(f"before\n{BEGIN}\n") and first.endswith(f"\n{END}\nafter\n")
    assert "old" not in first
    assert "`swarm-envs benchmark --out board --workers 2`: 48 episodes, 2 CPU minutes" in first
    assert "| b | failed | 100 |" in first
    main([str(tmp_path), "--into", str(page)])
    assert page.read_text(encoding="utf-8") == first


def test_a_page_without_a_place_for_results_is_refused():
    with pytest.raises(ValueError, match="must have one '<!-- results -->'"):
        put_into("nothing here", "x")
    assert put_into((DOCS / "benchmark.md").read_text(encoding="utf-8"), "x").count("\nx\n") == 1
