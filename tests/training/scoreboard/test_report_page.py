"""The scoreboard's page in a browser, on a desk and on a telephone."""

from __future__ import annotations

import pytest

from swarm_envs.training.scoreboard import replays, report
from tests.helpers.browsers import OVERFLOW, chromium, complaints, requests
from tests.helpers.scoreboards import EVIL, scores, write_scores

pytestmark = pytest.mark.slow

DESK, TELEPHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
NAMES = (
    "Array.from(document.querySelectorAll('#matrix tbody tr:not([hidden])'), r => r.dataset.agent)"
)
COLUMN = """(place) => Array.from(document.querySelectorAll('#matrix tbody tr'),
    r => 'v' in r.cells[place].dataset ? Number(r.cells[place].dataset.v) : null)"""


@pytest.fixture(scope="module")
def content():
    return scores()


@pytest.fixture(scope="module")
def folder(content, tmp_path_factory):
    """A scoreboard with one replay that was truly flown; the others are stand-ins."""
    made = write_scores(tmp_path_factory.mktemp("board"), content)
    for cell in content["cells"]:
        if cell["replay"]:
            (made / "replays").mkdir(exist_ok=True)
            (made / cell["replay"]["file"]).write_text("<!doctype html><title>stand-in</title>")
    report.write(made)
    return made


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.fixture
def open_page(browser, folder):
    """Opens the page in a window, and holds at the end that nothing went wrong in it."""
    opened = []

    def visit(size, scheme="light"):
        context = browser.new_context(viewport=size, color_scheme=scheme)
        page = context.new_page()
        page.set_default_timeout(60_000)
        opened.append((context, complaints(page), requests(page)))
        page.goto((folder / "report.html").as_uri())
        page.wait_for_selector("body[data-ready=yes]")
        return page

    yield visit
    for context, said, asked in opened:
        assert said == []
        assert asked == [(folder / "report.html").as_uri()]
        context.close()


def is_sorted(values, sign):
    known = [sign * v for v in values if v is not None]
    return known == sorted(known) and values[len(known) :] == [None] * (len(values) - len(known))


def test_it_sorts_by_click_and_by_keyboard(open_page):
    page = open_page(DESK)
    heads = page.locator("#matrix th[data-sort]")
    first = page.evaluate(NAMES)
    assert first[0] == "mlr-dmpc"
    place = 4
    heads.nth(place).locator("button").click()
    assert heads.nth(place).get_attribute("aria-sort") == "descending"  # success: more is better
    values = page.evaluate(COLUMN, place)
    assert is_sorted(values, -1)
    assert None in values
    page.keyboard.press("Enter")
    assert heads.nth(place).get_attribute("aria-sort") == "ascending"
    assert is_sorted(page.evaluate(COLUMN, place), 1)
    heads.nth(0).locator("button").focus()
    page.keyboard.press("Space")
    assert heads.nth(0).get_attribute("aria-sort") == "ascending"
    assert heads.nth(place).get_attribute("aria-sort") == "none"
    assert sorted(page.evaluate(NAMES)) == sorted(first)
    assert page.evaluate(NAMES)[1:3] == ["detour", "detour+compensated"]


def test_another_metric_takes_the_place_and_keeps_the_order(open_page, content):
    page = open_page(DESK)
    heads = page.locator("#matrix th[data-sort]")
    heads.nth(3).locator("button").click()
    page.select_option("#metric", "act_us_p50")
    assert is_sorted(page.evaluate(COLUMN, 3), -1)
    shown = dict(zip(page.evaluate(NAMES), page.evaluate(COLUMN, 3), strict=True))
    task = content["tasks"][2]["id"]
    for cell in content["cells"]:
        if cell["task"] == task and cell["status"] == "flown":
            truth = cell["values"]["act_us_p50"]["value"]
            assert shown[cell["agent"]] == pytest.approx(truth, rel=1e-4)
    heads.nth(5).locator("button").click()  # less is better: it begins with the least
    assert is_sorted(page.evaluate(COLUMN, 5), 1)


def test_it_filters_agents_and_tasks(open_page):
    page = open_page(DESK)
    page.fill("#filter", "DAGGER")
    assert page.evaluate(NAMES) == ["crowd-dagger+filter", "swap-dagger", "crowd-dagger"]
    page.fill("#filter", "")
    page.uncheck("#privileged")
    assert len(page.evaluate(NAMES)) == 6
    page.select_option("#family", "ring")
    assert page.locator("#matrix th[data-task]:visible").count() == 3
    assert page.locator("#count").inner_text() == "6 of 16 agents, 3 of 14 tasks"
    page.keyboard.press("Enter")  # submits nothing
    assert len(page.evaluate(NAMES)) == 6


def test_a_number_leads_to_all_metrics_of_its_pair(open_page, folder):
    page = open_page(DESK)
    page.locator("#matrix tr[data-agent=rth3d] td:nth-child(4) a.n").click()
    dialog = page.locator("#detail")
    assert dialog.is_visible()
    assert page.locator("#detail-title").inner_text() == "rth3d, swap, circle, 8 drones"
    assert page.locator("#detail-values div").count() == 10
    assert "Episode 4 of 64, seed 17" in page.locator("#detail-replay").inner_text()
    link = page.locator("#detail-replay a").get_attribute("href")
    assert (folder / link).is_file()
    page.keyboard.press("Escape")
    assert not dialog.is_visible()
    word = page.locator("td.failed button").first
    word.focus()
    page.keyboard.press("Enter")
    assert "no plan" in page.locator("#detail-about").inner_text()


def test_an_agent_is_brought_out_of_all_plots(open_page):
    page = open_page(DESK)
    button = page.locator(".legend button", has_text="hover")
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    lit = page.evaluate("Array.from(document.querySelectorAll('.lit'), e => e.dataset.agent)")
    assert set(lit) == {"hover"}
    assert len(lit) > 6
    button.click()
    page.mouse.move(0, 0)
    assert page.locator(".lit, .dim").count() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESK, TELEPHONE, {"width": 360, "height": 640}])
def test_it_fits_and_can_be_read(open_page, size, scheme):
    page = open_page(size, scheme)
    assert page.evaluate(OVERFLOW) <= 0
    page.locator("details:not(#all) > summary").evaluate_all("all => all.forEach(s => s.click())")
    page.locator("#all > summary").click()
    assert page.evaluate(OVERFLOW) <= 0
    page.locator("#matrix a.n").first.click()
    box = page.locator("#detail").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= size["width"]
    ink, paper = page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.documentElement)"
        ".backgroundColor].map(c => Math.max(...c.match(/\\d+/g).slice(0, 3).map(Number)))"
    )
    assert (ink > 200 and paper < 60) if scheme == "dark" else (ink < 60 and paper > 200)
    assert page.evaluate("window.bitten") is None
    assert page.locator("#matrix th", has_text=EVIL).count() == 1


def test_every_replay_is_there_and_one_plays(browser, folder, content, tmp_path):
    options = {"num_drones": 2, "physics": "batch", "interactions": "none", "horizon_s": 0.5}
    file = content["cells"][0]["replay"]["file"]
    (folder / file).unlink()
    assert replays.record_one(str(folder / file), "swap_v1", options, "hover", 17, False) is None
    page = browser.new_page(viewport=DESK)
    page.set_default_timeout(120_000)
    said, asked = complaints(page), requests(page)
    page.goto((folder / "report.html").as_uri())
    links = page.locator("a.play").evaluate_all("all => all.map(a => a.getAttribute('href'))")
    assert all((folder / link).is_file() for link in links)
    page.locator(f"#matrix a.play[href='{file}']").click()
    page.wait_for_selector("body[data-ready=yes] #swarm", state="attached")
    assert "hover" in page.locator("h1").inner_text()
    assert said == []
    assert asked == [(folder / "report.html").as_uri(), (folder / file).as_uri()]
