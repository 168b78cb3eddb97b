"""The scoreboard's page, read without a browser: its numbers are the file's, its text is inert."""

from __future__ import annotations

import base64
import hashlib
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from swarm_envs.training.scoreboard import report
from swarm_envs.training.scoreboard.axes import HEIGHT, WIDTH
from swarm_envs.training.scoreboard.board import Metric, Value
from swarm_envs.training.scoreboard.colors import palette, ranked
from swarm_envs.training.scoreboard.figures import goodness, interval, micros, number
from swarm_envs.training.scoreboard.labels import Label, placed
from swarm_envs.training.scoreboard.markup import html, tag
from swarm_envs.training.scoreboard.plots import profile
from swarm_envs.training.scoreboard.reading import read
from tests.helpers.scoreboards import AGENTS, EVIL, scores, write_scores

VOID = {"meta", "link", "input", "br", "img"}


class Reader(HTMLParser):
    """Collects a page's elements: tag, attributes, text, and the row of a table they stand in."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements = [], []
        self.feed(text)
        assert [e["tag"] for e in self.open] == []  # everything that was opened was closed

    def handle_starttag(self, name, attributes):
        row = next((e for e in self.open[::-1] if e["tag"] == "tr"), None)
        element = {"tag": name, "row": row, "text": "", **dict(attributes)}
        self.elements.append(element)
        if name not in VOID:
            self.open.append(element)

    def handle_endtag(self, name):
        assert self.open.pop()["tag"] == name

    def handle_data(self, data):
        for element in self.open:
            element["text"] += data

    def all(self, name):
        return [e for e in self.elements if e["tag"] == name]


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
    return Reader(text)


def test_every_number_of_the_file_is_in_the_page(page, content):
    shown = {}
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
                said = float(re.match(r"[\d.]+", found["text"].replace("\u202f", ""))[0])
                assert said == pytest.approx(scale * value, rel=0.01, abs=0.05)


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
        values = [board.standings[family][name].value for name in ranked(board, family)]
        assert values == sorted(values, reverse=True)
    colors = palette(board)
    assert sorted(colors.values()) == list(range(8))
    assert {ranked(board, family)[0] for family in board.families} <= set(colors)


def test_lines_of_a_profile_are_its_numbers(folder):
    """Read back from the drawing: the frame's ends are the scales' ends."""
    board = read(folder)
    drawn = profile(board, palette(board), "ring")
    left, right, top, bottom = 40.0, WIDTH - 18.0, 10.0, HEIGHT - 40.0
    for group in drawn.iter("g"):
        line = next(e for e in group if e.get("class") == "line")
        points = np.array([pair.split() for pair in line.get("d")[1:].split("L")], float)
        curve = board.profiles["ring"].curves[group.get("data-agent")]
        fraction = (bottom - points[:, 1]) / (bottom - top)
        np.testing.assert_allclose(fraction, curve.fraction, atol=3e-4)
        threshold = (points[:, 0] - left) / (right - left)
        np.testing.assert_allclose(threshold, board.profiles["ring"].thresholds, atol=3e-4)


def test_names_in_a_plot_cover_neither_marks_nor_each_other():
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, y = rng.uniform(60, 370, 12), rng.uniform(20, 230, 12)
        marks = [(a - 5, b - 5, a + 5, b + 5) for a, b in zip(x, y, strict=True)]
        labels = [Label("n" * rng.integers(3, 30), a, b, "") for a, b in zip(x, y, strict=True)]
        found = [(c, d - 9, c + 6 * len(a.text), d + 2) for a, c, d in placed(labels, marks)]
        assert len(found) > 4
        boxes = [*found, *marks]
        for k, one in enumerate(found):
            assert one[0] > 40
            assert one[2] < 382
            for other in boxes[k + 1 :]:
                apart = one[2] < other[0] or other[2] < one[0]
                assert apart or one[3] < other[1] or other[3] < one[1]


def test_numbers_as_people_read_them():
    given = {0.0: "0", 0.03124: "0.0312", 1.5: "1.5", 12.345: "12.3", 12345.6: "12\u202f346"}
    assert {value: number(value) for value in given} == given
    assert [number(v, "%") for v in (0.0, 0.123, 0.88, 1.0)] == ["0", "12.3", "88.0", "100"]
    assert number(-0.5) == "-0.5"
    assert interval(Value(0.5, (0.25, 0.75)), "%") == "25.0–75.0"
    assert interval(Value(0.5, None)) == ""
    assert [micros(t) for t in (12.0, 3400.0, 2.5e6)] == ["12 µs", "3.4 ms", "2.5 s"]


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
