"""The replay page: its numbers are the flight's, and it plays in a browser without a network."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from swarm_envs import swap_v0
from swarm_envs.agents import load, record_episode
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.record import Recording, Solid
from swarm_envs.viewing.replay import page_data, replay_page, write_replay
from swarm_envs.viewing.style import drone_colors
from swarm_envs.viewing.summary import events, near_misses
from tests.helpers.browsers import OVERFLOW, chromium, complaints, requests

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def crash() -> Recording:
    """Six drones straight to their goals, until two meet and two nearly; a column stands by."""
    agent = load("tracking")
    env = swap_v0.parallel_env(team="SLS" * 2, physics="batch", **agent.requires)
    for seed in range(20):
        recording = record_episode(env, agent, seed)
        if recording.about.metrics["collided_drones"] and near_misses(recording):
            break
    env.close()
    column = Solid(True, (-1.9, -1.9, 0.0), (-1.5, -1.5, 2.5))
    return replace(recording, about=replace(recording.about, solids=(column,)))


def test_the_page_s_numbers_are_the_flight_s(crash):
    data = page_data(crash, events(crash))
    shape = crash.position.shape
    for name, truth, grain in (
        ("position", crash.position, 1e-3),
        ("force", crash.force / GRAM_FORCE, 0.01),
    ):
        shown = np.array(data[name]).reshape(shape) * data["unit"][name]
        np.testing.assert_allclose(shown, truth, atol=0.5 * grain + 1e-9)
    np.testing.assert_allclose(data["time"], crash.time, atol=1e-5)
    apart = crash.position[:, :, None] - crash.position[:, None]
    distance = np.linalg.norm(apart, axis=-1) + 9.0 * np.eye(shape[1])
    np.testing.assert_allclose(data["separation"], distance.min(axis=(1, 2)), atol=1e-4)
    assert not data["moving"]
    assert len(data["goal"]) == len(data["reference"]) == 3 * shape[1]  # they never move
    event = data["events"][-1]
    assert event["frame"] == shape[0] - 1
    pair = events(crash)[-1].drones
    radii = sum(crash.team[i].radius for i in pair)
    assert data["touching"][-1] == pytest.approx(radii, abs=1e-4)
    assert data["separation"][-1] < radii


def test_long_flights_keep_what_matters(crash):
    last = len(crash.time) - 1
    index = np.concatenate([np.zeros(60_000, np.int64), np.arange(last + 1)])
    arrays = {k: v[index] for k, v in vars(crash).items() if isinstance(v, np.ndarray)}
    long = replace(crash, **{**arrays, "time": np.arange(len(index)) / 48})
    data = page_data(long, events(long))
    assert len(data["time"]) * 6 < 60_000
    assert data["time"][-1] == pytest.approx(long.time[-1], abs=1e-4)
    assert data["time"][data["events"][-1]["frame"]] == pytest.approx(long.time[-1], abs=1e-4)


def test_names_cannot_break_out_of_the_page(crash):
    evil = "</script><script>alert(1)</script>"
    page = replay_page(replace(crash, about=replace(crash.about, agent=evil)))
    assert evil not in page
    assert "&lt;/script&gt;" in page
    text = re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)
    assert text is not None
    assert json.loads(text[1])["moving"] is False


def test_pages_are_small_and_load_nothing(crash, tmp_path):
    write_replay(tmp_path / "a.html", crash, most_samples=600)
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert len(page) < 0.06 * MEGABYTE
    assert "<script src" not in page
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'unsafe-inline'; ")
    happened = events(crash)
    few = page_data(crash, happened, most_samples=300)["time"]
    assert 300 / 6 / 2 < len(few) <= 300 / 6 + len(happened) + 1
    with pytest.raises(ValueError, match=r"must end in \.html"):
        write_replay(tmp_path / "a.txt", crash)


@pytest.fixture
def browser():
    with chromium() as opened:
        yield opened


def count_color(picture: Image.Image, color: str) -> int:
    pixels = np.asarray(picture.convert("RGB")).astype(int)
    wanted = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)])
    return int((np.abs(pixels - wanted).max(axis=-1) < 40).sum())


FRAME = "Number(document.getElementById('scrub').value)"
EYE = "JSON.stringify([window.replay.view.camera.turn, window.replay.view.camera.tilt])"
FIRST = f"window.replay.at('position', {FRAME}, 0)"
SHOWN = f"window.replay.view.project({FIRST})"


def until(page: Any, condition: str) -> None:
    """Wait in Python: the page's policy forbids what Playwright would evaluate in it."""
    for _ in range(600):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(condition)


@pytest.mark.slow
def test_the_page_plays_in_a_browser(browser, crash, tmp_path):
    write_replay(tmp_path / "a.html", crash)
    address = (tmp_path / "a.html").as_uri()
    page = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme="light")
    page.set_default_timeout(60_000)
    said, asked = complaints(page), requests(page)
    page.goto(address)
    page.wait_for_selector("body[data-ready=yes]")
    assert page.evaluate(OVERFLOW) <= 0
    last = len(crash.time) - 1

    # It shows the drones where they are: each one's color is near its place.
    first = np.array(page.evaluate(FIRST))
    np.testing.assert_allclose(first, crash.position[0, 0], atol=1e-3)
    scene = page.locator("#swarm")
    colors = drone_colors(crash.team)
    x, y, _, scale = page.evaluate(SHOWN)
    reach = scale * (crash.team[0].arm + crash.team[0].rotor_radius)
    around = Image.open(io.BytesIO(scene.screenshot())).crop(
        (int(x - reach), int(y - reach), int(x + reach), int(y + reach))
    )
    assert count_color(around, colors[0]) > 10

    # It plays, and the camera turns while it plays.
    eye = page.evaluate(EYE)
    page.select_option("#speed", "0.1")
    page.click("#play")
    until(page, f"{FRAME} > 1")
    assert page.get_attribute("#play", "aria-label") == "Pause"
    box = scene.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, 6):
        page.mouse.move(x + 25 * k, y + 5 * k)
    page.mouse.up()
    turned = page.evaluate(EYE)
    assert turned != eye
    page.focus("#scrub")
    page.keyboard.press("Home")
    assert page.evaluate(FRAME) == 0
    page.select_option("#speed", "4")
    page.click("#play")
    until(page, f"{FRAME} == {last}")
    until(page, "document.getElementById('play').getAttribute('aria-label') == 'Play'")
    assert page.evaluate(EYE) == turned
    assert (np.array(page.evaluate(FIRST)) != first).any()
    assert page.locator("#clock").inner_text().startswith(f"{crash.time[-1]:.2f} / ")
    assert "collide" in page.locator("#outcome").inner_text()
    assert (
        count_color(Image.open(io.BytesIO(scene.screenshot())), "#c62828") > 30
    )  # the cross of the collision
    happened = [*events(crash), *near_misses(crash)]
    assert page.locator("#marks i").count() == len(happened)
    near = page.locator("#events button.near")
    assert near.count() == len(near_misses(crash)) > 0
    assert "come within" in near.first.inner_text()

    # A plot is a handle on time: its middle is the middle of the flight.
    chart = page.locator("#height")
    chart.scroll_into_view_if_needed()
    size = chart.bounding_box()
    left, right = 46, 12  # margins of the plots
    middle = left + (size["width"] - left - right) / 2
    page.mouse.click(size["x"] + middle, size["y"] + 60)
    assert abs(page.evaluate(FRAME) - last / 2) <= 1.0
    page.locator("#events button").first.click()
    assert page.evaluate(FRAME) == min(event.frame for event in happened)

    # On a telephone, in the dark.
    page.click("#theme")
    page.set_viewport_size({"width": 390, "height": 844})
    until(page, f"{OVERFLOW} <= 0")  # a busy machine lays out late
    dark = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert max(map(int, re.findall(r"\d+", dark))) < 60
    assert said == []
    assert asked == [address]
