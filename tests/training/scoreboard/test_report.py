"""The scoreboard's page, read without a browser; which replays it shows."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import load, record_episode
from swarm_envs.training.scoreboard import replays, report
from swarm_envs.training.scoreboard.board import Metric, read
from swarm_envs.training.scoreboard.markup import format_interval, format_value, html, tag
from swarm_envs.training.scoreboard.report import palette
from swarm_envs.training.scoreboard.tables import goodness
from swarm_envs.viewing.replay import page_data
from tests.helpers.browsers import PageReader
from tests.helpers.scoreboards import AGENTS, EVIL, TASKS, scores, write_scores


def change(content, path, value):
    *way, last = path
    for key in way:
        content = content[key]
    if value is KeyError:
        del content[last]
    else:
        content[last] = value


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["format"], "a list", "its format is 'a list'.*'swarm-envs scoreboard'"),
        (["tasks"], KeyError, "tasks.* is missing"),
        (["cells", 3, "task"], "swap-x", "cells name .* on 'swap-x', which the file does not list"),
        (["cells", 3, "values", "energy_j", "value"], float("nan"), "it holds NaN.*null says"),
        (["cells", 3, "replay", "file"], "javascript:alert(1)", "must be replays/NAME.html"),
        (["aggregates", "hop"], {"rth3d": {"value": 1.0}}, "aggregates name 'rth3d' in 'hop'"),
        (["aggregates", "swap", "rth3d", "value"], 1.5, r"must be a score in \[0, 1\]"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, path, value, said):
    content = scores()
    change(content, path, value)
    write_scores(tmp_path, content)
    with pytest.raises(ValueError, match=f"scores.json' cannot be shown: .*{said}.*write it again"):
        read(tmp_path)


def test_what_is_no_scoreboard_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no scores.json in .*swarm-envs benchmark --out"):
        read(tmp_path)
    for text in ("[]", "{", json.dumps({"format": "swarm-envs scoreboard"})):
        (tmp_path / "scores.json").write_text(text)
        with pytest.raises(ValueError, match="cannot be shown"):
            read(tmp_path)


WIDTH, HEIGHT = report.WIDTH, report.HEIGHT


@pytest.fixture(scope="module")
def content():
    return scores()


@pytest.fixture(scope="module")
def folder(content, tmp_path_factory):
    made = write_scores(tmp_path_factory.mktemp("board"), content)
    (made / "replays").mkdir()
    for cell in content["cells"][::2]:
        if cell["replay"]:
            (made / cell["replay"]["file"]).touch()
    report.write(made)
    return made


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text):
    return PageReader(text)


def test_every_number_of_the_file_is_in_the_page(page, content):
    shown: dict[tuple[str, str], list[Any]] = {}
    for cell in page.all("td"):
        row = cell["row"]
        if "data-task" in row and row.get("id", "").startswith("n"):
            shown.setdefault((row["data-task"], row["data-agent"]), []).append(cell)
    flown = [cell for cell in content["cells"] if cell["status"] == "flown"]
    assert set(shown) == {(cell["task"], cell["agent"]) for cell in flown}
    for cell in flown:
        _, episodes, *values = shown[cell["task"], cell["agent"]]
        assert episodes["text"] == str(cell["episodes"])
        for metric, found in zip(content["metrics"], values, strict=True):
            value = cell["values"][metric["name"]]["value"]
            if value is None:
                assert found["text"] == "\N{EN DASH}"
            else:
                assert float(found["data-v"]) == pytest.approx(value, rel=1e-4)
                scale = 100.0 if metric["unit"] == "%" else 1.0
                digits = re.match(r"[\d.]+", found["text"].replace("\u202f", ""))
                assert digits is not None
                assert float(digits[0]) == pytest.approx(scale * value, rel=0.01, abs=0.05)


def test_without_the_script_the_table_shows_success_and_says_what_is_missing(page, content):
    matrix = [r for r in page.all("tr") if "data-privileged" in r]
    assert {row["data-agent"]: row["data-privileged"] == "yes" for row in matrix} == {
        name: told for name, (told, *_) in AGENTS.items()
    }
    for row in matrix:
        cells = [e for e in page.all("td") if e["row"] is row]
        for task, cell in zip(content["tasks"], cells, strict=True):
            truth = next(
                c for c in content["cells"]
                if (c["task"], c["agent"]) == (task["id"], row["data-agent"])
            )  # fmt: skip
            assert cell["class"] == truth["status"]
            if truth["status"] == "flown":
                rate = truth["values"]["success_rate"]["value"]
                assert float(cell["data-v"]) == pytest.approx(rate, rel=1e-4)
    reasons = [e["title"] for e in page.all("abbr") if e["text"] == "failed"]
    assert set(reasons) == {"AgentFailed: <b>no plan</b> in 60 s"}
    (controls,) = (e for e in page.all("form") if e.get("id") == "controls")
    assert "hidden" in controls


def test_names_that_bite_are_text(page, text):
    assert "onerror=window" in EVIL
    assert EVIL not in text
    assert not page.all("img")
    assert not page.all("b") or all(not e["text"] for e in page.all("b"))  # marks of the boards
    (script,) = page.all("script")
    assert not [key for e in page.elements for key in e if key.startswith("on")]
    (policy,) = (e["content"] for e in page.all("meta") if "http-equiv" in e)
    digest = base64.b64encode(hashlib.sha256(script["text"].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy
    assert "default-src 'none'" in policy
    assert sum(EVIL in e["text"] for e in page.all("th")) > 1  # yet it is there to be read


def test_the_page_asks_for_nothing_and_links_only_what_is_there(page, text, content, folder):
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", text)
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest", text)
    links = {e["href"] for e in page.all("a")}
    within, out = {h for h in links if h[0] == "#"}, {h for h in links if h[0] != "#"}
    ids = [e["id"] for e in page.elements if "id" in e]
    assert len(ids) == len(set(ids))
    assert within <= {f"#{name}" for name in ids}
    assert out == {f"replays/{file.name}" for file in (folder / "replays").iterdir()}
    assert len(out) > 80


def test_the_same_scores_give_the_same_page(folder, text):
    assert report.write(folder) == folder / "report.html"
    assert (folder / "report.html").read_text(encoding="utf-8") == text


def test_leaderboards_have_the_best_first_and_its_colours_are_the_best_s(folder):
    board = read(folder)
    for family in board.families:
        values = [board.aggregates[family][name]["value"] for name in board.ranked(family)]
        assert values == sorted(values, reverse=True)
    colors = palette(board)
    assert sorted(colors.values()) == list(range(8))
    assert {board.ranked(family)[0] for family in board.families} <= set(colors)


def test_lines_of_a_profile_are_its_numbers(folder):
    """Read back from the drawing: the frame's ends are the scales' ends."""
    board = read(folder)
    drawn = report.profile_chart(board, palette(board), "ring")
    left, bottom, width, height = np.array(report.FRAME) * (WIDTH, HEIGHT, WIDTH, HEIGHT)
    lines = [group for group in drawn.iter("g") if group.get("class", "").startswith("line ")]
    assert {group.get("data-agent") for group in lines} == set(board.profiles["ring"]["agents"])
    for group in lines:
        (line,) = group.iter("path")
        numbers = [float(number) for number in re.findall(r"[\d.]+", line.attrib["d"])]
        across, down = np.array(numbers).reshape(-1, 2).T
        fraction = (HEIGHT - down - bottom) / height
        curve = board.profiles["ring"]["agents"][group.attrib["data-agent"]]
        np.testing.assert_allclose(fraction, curve["fraction"], atol=3e-4)
        threshold = (across - left) / width
        np.testing.assert_allclose(threshold, board.profiles["ring"]["thresholds"], atol=3e-4)


def test_numbers_as_people_read_them():
    given = {0.0: "0", 0.03124: "0.0312", 1.5: "1.5", 12.345: "12.3", 12345.6: "12\u202f346"}
    assert {value: format_value(value) for value in given} == given
    assert [format_value(v, "%") for v in (0.0, 0.123, 0.88, 1.0)] == ["0", "12.3", "88.0", "100"]
    assert format_value(-0.5) == "-0.5"
    assert format_interval((0.25, 0.75), "%") == "25.0–75.0"
    assert format_interval(None) == ""


@pytest.mark.parametrize(
    ("unit", "better", "values", "shares"),
    [
        ("%", "higher", [0.25, 1.0, None], [0.25, 1.0, None]),
        ("%", "lower", [0.25, 1.0], [0.75, 0.0]),
        ("m", "lower", [2.0, 4.0, 3.0], [1.0, 0.0, 0.5]),
        ("µs", "lower", [10.0, 1000.0, 100.0], [1.0, 0.0, 0.5]),  # by the logarithm
        ("m", "higher", [3.0, 3.0], [0.5, 0.5]),
        ("", "neither", [1.0, 2.0], [None, None]),
        ("m", "higher", [None], [None]),
    ],
)
def test_how_good_a_value_of_a_column_is(unit, better, values, shares):
    found = goodness(Metric("a", "A", unit, better, ""), values)
    assert found == [share if share is None else pytest.approx(share) for share in shares]


def test_markup_writes_text_as_text():
    made = tag("td", "a < b", tag("i", '"'), " & c", None, class_="x", data_v=0.5, title='"<&')
    assert html(made, "<tail>") == (
        '<td class="x" data-v="0.5" title="&quot;<&amp;">a &lt; b<i>"</i> &amp; c</td>&lt;tail&gt;'
    )
    assert html(tag("input", hidden=True, checked=False, value=None)) == '<input hidden="">'


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
    chosen = replays.choose_episode("swap-2-v2", "hover", seeded)
    assert chosen is not None
    assert chosen["seed"] == 100 + index
    assert chosen["episode"] == index
    assert chosen["success"] == episodes[index]["success"]
    assert chosen["file"] == "replays/swap-2-v2--hover.html"
    assert why in chosen["why"]


def test_what_was_not_flown_has_no_replay():
    assert replays.choose_episode("swap-2-v2", "hover", [{**REFUSED, "seed": 1}]) is None


def test_no_two_agents_share_a_page():
    names = [*AGENTS, "a/b.py:C", "a-b.py:C", "a b.py:C", "../x", "é" * 300, "runs/a", "runs/b/"]
    files = [replays.file_of("swap-circle-2-v2", name) for name in names]
    assert len(set(files)) == len(names)
    assert all(re.fullmatch(r"replays/[A-Za-z0-9][A-Za-z0-9._+-]{0,120}\.html", f) for f in files)
    assert replays.file_of("t", "swap-dagger+filter") == "replays/t--swap-dagger+filter.html"


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
        "swap-circle-2-v2--hover.html", "swap-circle-2-v2--random.html"
    ]  # fmt: skip
    assert all(p.stat().st_size < 60_000 for p in pages)

    env = swap_v1.parallel_env(**OPTIONS, **load("random").requires)
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
    assert re.match(r"hover on swap-circle-2-v2: .* seed 11 fails now, unlike", unlike)
    assert re.match(r"hoover on swap-circle-2-v2: ValueError: .*'hover'", unknown)
    assert (folder / "replays" / "swap-circle-2-v2--hover.html").is_file()
