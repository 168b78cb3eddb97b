"""Which episode of a cell is shown, and that it is the one that was scored."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import load, record_episode
from swarm_envs.training.scoreboard import replays
from swarm_envs.viewing.replay import page_data
from tests.helpers.scoreboards import AGENTS, TASKS, scores, write_scores

OPTIONS: dict[str, Any] = {
    "num_drones": 2,
    "physics": "batch",
    "interactions": "none",
    "horizon_s": 0.5,
}


def flown(success, collided=False, apart=0.3):
    return {"success": success, "collided": collided, "minimum_separation_m": apart}


REFUSED = {"success": False, "collided": False, "minimum_separation_m": None, "refused": True}


@pytest.mark.parametrize(
    ("episodes", "index", "why"),
    [
        ([flown(True), flown(False), flown(False, True)], 2, "failure with a collision, of 2 fail"),
        ([flown(True), flown(False), flown(False)], 1, "the first failure, of 2 failures"),
        ([flown(True), flown(True, apart=0.1), flown(True)], 1, "come nearest; all succeed"),
        ([flown(True, apart=None), flown(True, apart=None)], 0, "the first; all succeed"),
        ([flown(False), flown(False, True)], 0, "the first; all fail"),
        ([REFUSED, flown(True, apart=0.4), flown(True, apart=0.2)], 2, "come nearest"),
        ([REFUSED, flown(False), flown(True)], 1, "the first failure, of 1"),
    ],
)
def test_the_rule_of_choice(episodes, index, why):
    seeded = [{**episode, "seed": 100 + k} for k, episode in enumerate(episodes)]
    chosen = replays.choose_episode("swap-2-v1", "hover", seeded)
    assert chosen is not None
    assert chosen["seed"] == 100 + index
    assert chosen["episode"] == index
    assert chosen["success"] == episodes[index]["success"]
    assert chosen["file"] == "replays/swap-2-v1--hover.html"
    assert why in chosen["why"]


def test_what_was_not_flown_has_no_replay():
    assert replays.choose_episode("swap-2-v1", "hover", [{**REFUSED, "seed": 1}]) is None


def test_no_two_agents_share_a_page():
    names = [*AGENTS, "a/b.py:C", "a-b.py:C", "a b.py:C", "../x", "é" * 300, "runs/a", "runs/b/"]
    files = [replays.file_of("swap-circle-2-v1", name) for name in names]
    assert len(set(files)) == len(names)
    assert all(re.fullmatch(r"replays/[A-Za-z0-9][A-Za-z0-9._+-]{0,120}\.html", f) for f in files)
    assert replays.file_of("t", "swap-ppo-8+filter") == "replays/t--swap-ppo-8+filter.html"


def small_board(folder, *agents):
    """A scoreboard of one task: hover fails on it."""
    content, family = scores(), TASKS[0][0]
    task = {**content["tasks"][0], "options": OPTIONS}
    entries = [{"name": n, "label": n, "privileged": False, "help": ""} for n in agents]
    cells = [
        {
            "task": task["id"], "agent": name, "status": "flown", "episodes": 2, "values": {},
            "replay": replays.choose_episode(
                task["id"], name, [{**flown(False), "seed": 11}, {**flown(False), "seed": 12}]
            ),
        }
        for name in agents
    ]  # fmt: skip
    content |= {"tasks": [task], "agents": entries, "cells": cells}
    content |= {"aggregates": {family: {}}, "profiles": {}}
    return write_scores(folder, content)


def shown(path):
    text = path.read_text(encoding="utf-8")
    data = re.search(r'<script id="data" type="application/json">(.*?)<', text)
    assert data is not None
    return json.loads(data[1])


def test_pages_show_the_episode_are_kept_and_flown_again_only_if_missing(tmp_path):
    folder = small_board(tmp_path, "hover", "random")
    assert replays.record_replays(folder) == []
    pages = sorted((folder / "replays").glob("*.html"))
    assert [p.name for p in pages] == [
        "swap-circle-2-v1--hover.html", "swap-circle-2-v1--random.html"
    ]  # fmt: skip
    assert all(p.stat().st_size < 60_000 for p in pages)

    env = swap_v0.parallel_env(**OPTIONS, **load("random").requires)
    flight = record_episode(env, load("random"), seed=11)
    env.close()
    data = page_data(flight, [])
    assert shown(pages[1])["position"] == data["position"]

    pages[0].write_text("kept: hover, seed 11; ...")
    before = pages[1].read_bytes()
    pages[1].unlink()
    assert replays.record_replays(folder) == []
    assert pages[0].read_text().startswith("kept")
    assert pages[1].read_bytes() == before
    pages[0].write_text("of another episode: hover, seed 12; ...")
    assert replays.record_replays(folder) == []
    assert len(shown(pages[0])["time"]) > 5


def test_what_goes_wrong_is_said_and_the_others_are_there(tmp_path):
    folder = small_board(tmp_path, "hover", "hoover")
    scored = json.loads((folder / "scores.json").read_text())
    scored["cells"][0]["replay"]["success"] = True
    write_scores(folder, scored)
    unlike, unknown = sorted(replays.record_replays(folder), key=lambda line: "hoover" in line)
    assert re.match(r"hover on swap-circle-2-v1: .* seed 11 fails now, unlike", unlike)
    assert re.match(r"hoover on swap-circle-2-v1: ValueError: .*'hover'", unknown)
    assert (folder / "replays" / "swap-circle-2-v1--hover.html").is_file()
