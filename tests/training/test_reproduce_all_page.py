"""The page of `swarm-envs reproduce all`: well formed, escaped, alone, and readable when narrow."""

from __future__ import annotations

import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from swarm_envs.training.reproduce.papers import PAPERS, Paper
from swarm_envs.training.reproduce.reproduce_page import html_page, markdown_page
from tests.helpers.papers import outcomes

ABOUT = ("By `swarm-envs reproduce all` & <more>.",)
EMPTY = {"meta", "link", "img", "br"}


class Reader(HTMLParser):
    """Keeps text, attributes and identities, and refuses tags that do not close."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.addresses: list[str] = []
        self.identities: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [v or "" for name, v in attrs if name in ("src", "href")]
        self.identities += [v or "" for name, v in attrs if name == "id"]
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.fixture(autouse=True)
def paper(monkeypatch):
    monkeypatch.setitem(PAPERS, "paper", Paper("A <paper>", "", "tests.helpers.papers"))


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "index.html"
    path.write_text(html_page(outcomes(tmp_path), ABOUT, tmp_path), encoding="utf-8")
    return path


def test_the_page_is_well_formed_and_asks_for_nothing_outside(written):
    reader = Reader()
    reader.feed(written.read_text())
    assert not reader.open and not reader.tags & {"script", "iframe", "object"}
    assert all(a.startswith(("#", "data:")) for a in reader.addresses), reader.addresses
    inside = {a[1:] for a in reader.addresses if a.startswith("#")}
    assert inside <= set(reader.identities)
    assert len(set(reader.identities)) == len(reader.identities)


def test_everything_that_was_found_stands_on_the_page(written):
    reader = Reader()
    reader.feed(written.read_text())
    text = " ".join("".join(reader.text).split())
    assert "no <script>alert(1)</script>" in text and "a <b>bold</b> thing & more" in text
    assert "differs, explained: calmer <air> & better models" in text
    assert "differs, unexplained" in text and "nothing to compare" in text
    assert "Not remade: a photograph <here>." in text and "Not run yet." in text
    assert "0.5 (0.4 to 0.6, quartiles)" in text
    assert sum(a.startswith("data:image/png") for a in reader.addresses) == 1


def test_the_table_in_markdown_has_a_line_for_each_row(tmp_path):
    text = markdown_page(outcomes(tmp_path), ABOUT)
    assert text.startswith(f"# Side by side\n\n{ABOUT[0]}\n")
    assert "Of 4 numbers 1 agree, 1 differ for a known reason, 1 differ, unexplained, 1" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + 4 + 3
    assert all(line.count("|") == 6 for line in lines)


def test_results_are_json(tmp_path):
    entries = [outcome.as_json() for outcome in outcomes(tmp_path)]
    assert [entry["state"] for entry in entries] == ["done", "failed", "not run", "not remade"]
    assert [row["verdict"] for row in entries[0]["rows"]][1] == "explained"
    assert entries[0]["rows"][1]["agrees"] == "4.9 to 9.1"


@pytest.fixture
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    program = next(filter(None, map(shutil.which, names)), None)
    with sync_api.sync_playwright() as playwright:
        if program is None and not Path(playwright.chromium.executable_path).exists():
            pytest.skip("there is no Chromium here")
        opened = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1440])
def test_the_page_fits_a_telephone_and_a_screen(browser, written, width):
    shown = browser.new_page(viewport={"width": width, "height": 900})
    asked: list[str] = []
    shown.on("request", lambda request: asked.append(request.url))
    shown.goto(written.as_uri())
    assert shown.evaluate("document.documentElement.scrollWidth - window.innerWidth") <= 0
    assert {url for url in asked if not url.startswith("data:")} == {written.as_uri()}
    assert shown.locator("section.item").count() == 4
    beside = "getComputedStyle(document.querySelector('td')).display"
    assert shown.evaluate(beside) == ("block" if width < 760 else "table-cell")
