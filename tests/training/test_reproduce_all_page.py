"""The page of `swarm-envs reproduce all`: well formed, escaped, alone, and readable when narrow."""

from __future__ import annotations

import pytest

from swarm_envs.training.reproduce.papers import PAPERS, Paper
from swarm_envs.training.reproduce.reproduce_page import html_page, markdown_page
from tests.helpers.browsers import OVERFLOW, PATIENCE_MS, PageReader, chromium, requests
from tests.helpers.papers import outcomes

ABOUT = ("By `swarm-envs reproduce all` & <more>.",)


@pytest.fixture(autouse=True)
def paper(monkeypatch):
    monkeypatch.setitem(PAPERS, "paper", Paper("A <paper>", "", "tests.helpers.papers"))


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "index.html"
    path.write_text(html_page(outcomes(tmp_path), ABOUT, tmp_path), encoding="utf-8")
    return path


def test_the_page_is_well_formed_and_asks_for_nothing_outside(written):
    page = PageReader(written.read_text())
    addresses = [e[name] for e in page.elements for name in ("src", "href") if name in e]
    identities = [e["id"] for e in page.elements if "id" in e]
    assert not {e["tag"] for e in page.elements} & {"script", "iframe", "object"}
    assert all(a.startswith(("#", "data:")) for a in addresses), addresses
    assert {a[1:] for a in addresses if a.startswith("#")} <= set(identities)
    assert len(set(identities)) == len(identities)
    assert sum(a.startswith("data:image/png") for a in addresses) == 1


def test_everything_that_was_found_stands_on_the_page(written):
    (html,) = PageReader(written.read_text()).all("html")
    text = " ".join(html["text"].split())
    assert "no <script>alert(1)</script>" in text and "a <b>bold</b> thing & more" in text
    assert "differs, explained: calmer <air> & better models" in text
    assert "differs, unexplained" in text and "nothing to compare" in text
    assert "Not reproduced: a photograph <here>." in text and "Not run yet." in text
    assert "0.5 (0.4 to 0.6, quartiles)" in text


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


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1440])
def test_the_page_fits_a_telephone_and_a_screen(written, width):
    with chromium() as browser:
        shown = browser.new_page(viewport={"width": width, "height": 900})
        shown.set_default_timeout(PATIENCE_MS)
        asked = requests(shown)
        shown.goto(written.as_uri())
        assert shown.evaluate(OVERFLOW) <= 0
        assert asked == [written.as_uri()]
        assert shown.locator("section.item").count() == 4
        beside = "getComputedStyle(document.querySelector('td')).display"
        assert shown.evaluate(beside) == ("block" if width < 760 else "table-cell")
