"""Recorded episodes are what happened; the replay page shows their numbers in a browser."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from swarm_envs import swap_v1
from swarm_envs.agents import load, record_episode
from swarm_envs.tasks.obstacles import Box, Column
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing.record import About, Recorder, Recording, Solid, solids
from swarm_envs.viewing.replay import page_data, replay_page, write_replay
from swarm_envs.viewing.style import drone_colors
from swarm_envs.viewing.summary import events, metric_rows, near_misses, outcome, team_label
from swarm_envs.viewing.trajectory import COLUMNS, GROUPS, read_trajectory, write_trajectory
from tests.helpers.browsers import OVERFLOW, chromium, complaints, requests


@pytest.fixture(scope="module")
def flight() -> Recording:
    """Three drones that act at random until one of them hits something."""
    env = swap_v1.parallel_env(team="SLS", physics="batch")
    recording = record_episode(env, load("random"), seed=3)
    env.close()
    return recording


def test_a_recording_is_what_a_loop_of_env_step_sees(flight):
    env = swap_v1.parallel_env(team="SLS", physics="batch")
    agent = load("random")
    observations, _ = env.reset(seed=3)
    agent.reset(env, 3)
    k, infos = 0, dict[str, Any]()
    while env.agents:
        np.testing.assert_array_equal(flight.position[k], env.view.state.position)
        observations, rewards, *_, infos = env.step(agent.act(observations, None))
        k += 1
        assert flight.time[k] == env.view.time
        assert flight.reward[k].tolist() == list(rewards.values())
        for i, info in enumerate(infos.values()):
            kept = {name: term[k, i] for name, term in flight.reward_terms.items()}
            assert kept == info["reward_terms"]
            contact = info.get("contact", {})
            assert flight.contact_floor[k, i] == ("floor" in contact)
            assert flight.contact_wall[k, i] == ("wall" in contact)
    assert k == len(flight.time) - 1
    total = pytest.approx(flight.reward[1:].sum(axis=0).mean())
    assert flight.about.metrics == infos["drone_0"]["episode_metrics"] | {"mean_return": total}
    np.testing.assert_array_equal(flight.goal[0], env.view.goals)
    env.close()


def test_recordings_that_are_cut_short_say_so():
    env = swap_v1.parallel_env(team="S", physics="batch")
    recorder = Recorder()
    with pytest.raises(RuntimeError, match="nothing was recorded"):
        recorder.record()
    env.reset(seed=0)
    recorder(env)
    env.step({"drone_0": np.zeros(3, np.float32)})
    recorder(env)
    cut = recorder.record()
    assert np.isnan(cut.reward).all()
    assert outcome(cut) == "Recorded for 0.02 s; the episode had not ended."
    env.close()


@pytest.mark.parametrize("suffix", [".parquet", ".npz"])
def test_a_file_gives_back_what_it_was_given(flight, tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    walls = (Solid(True, (0.0, 0.0, 0.0), (0.2, 0.2, 2.5)),)
    given = replace(flight, about=replace(flight.about, solids=walls))
    path = tmp_path / f"a{suffix}"
    write_trajectory(path, given)
    again = read_trajectory(path)
    assert (again.team, again.about) == (given.team, given.about)
    assert list(again.reward_terms) == list(given.reward_terms)
    for name in ("time", *GROUPS):
        found, wanted = getattr(again, name), getattr(given, name)
        assert found.dtype == wanted.dtype
        np.testing.assert_array_equal(found, wanted)
    for name, term in given.reward_terms.items():
        np.testing.assert_array_equal(again.reward_terms[name], term)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode there")
def test_a_folder_whose_name_is_no_unicode_is_written_and_read(flight, tmp_path):
    """As one that was named in Latin-1."""
    pytest.importorskip("pyarrow")
    folder = tmp_path / os.fsdecode(b"\xdcbung")
    folder.mkdir()
    for name in ("a.parquet", "a.npz"):
        write_trajectory(folder / name, flight)
        np.testing.assert_array_equal(read_trajectory(folder / name).time, flight.time)
    assert sorted(file.name for file in folder.iterdir()) == ["a.npz", "a.parquet"]


def test_the_table_has_a_row_for_each_drone_at_each_time(flight, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    write_trajectory(path, flight)
    table = parquet.read_table(path)
    terms = [f"reward_{name}" for name in flight.reward_terms]
    assert table.column_names == [*COLUMNS, *terms]
    rows = table.to_pylist()
    assert len(rows) == 3 * len(flight.time)
    row = rows[3 * 5 + 1]  # the sixth time, the second drone
    assert (row["drone"], row["type"], row["time"]) == ("drone_1", "L", 5 / 48)
    assert [row["x"], row["y"], row["z"]] == flight.position[5, 1].tolist()
    assert row["z_goal"] == flight.goal[5, 1, 2]
    assert row["thrust3"] == flight.rotor_thrust[5, 1, 2]
    assert row["contact_drone"] == -1


def test_files_that_hold_no_episode_are_refused(flight, tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros(3))
    np.savez(tmp_path / "b.npz", x=np.array([{}], dtype=object))
    lacking = r"a\.npz has no episode: it lacks about, time, pos"
    for name, why in (("a", lacking), ("b", "not an npz file")):
        with pytest.raises(ValueError, match=why):
            read_trajectory(tmp_path / f"{name}.npz")
    with pytest.raises(FileNotFoundError):
        read_trajectory(tmp_path / "none.npz")
    with pytest.raises(ValueError, match=r"unknown suffix '\.csv'.*'\.npz', '\.parquet'"):
        write_trajectory(tmp_path / "a.csv", flight)


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
def test_a_damaged_file_is_refused_or_gives_a_flight(flight, tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    path, rng, refused = tmp_path / f"a{suffix}", np.random.default_rng(0), 0
    write_trajectory(path, flight)
    sound = path.read_bytes()
    for _ in range(60):
        damaged = bytearray(
            sound[: rng.integers(1, len(sound) + 1)] if rng.random() < 0.3 else sound
        )
        for place in rng.integers(len(damaged), size=rng.integers(1, 20)):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            assert read_trajectory(path).position.shape == flight.position.shape
        except ValueError:
            refused += 1
    assert refused > 30


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a | {"time": a["time"][::-1]}, "time in .* must increase"),
        (lambda a: a | {"goal": a["goal"][:-1]}, r"goal in .* but must be numbers of shape"),
        (lambda a: a | {"quaternion": 0 * a["quaternion"]}, "quaternion in .* has length 0"),
        (lambda a: a | {"position": a["position"] * np.nan}, "position in .* not finite"),
        (lambda a: a | {"about": np.array("[]")}, "not a JSON object"),
        (lambda a: a | {"about": np.array('{"team": 3, "reward_terms": []}')}, "has no episode"),
    ],
)
def test_an_episode_that_cannot_be_is_refused(flight, tmp_path, change, said):
    path = tmp_path / "a.npz"
    write_trajectory(path, flight)
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **change(arrays))
    with pytest.raises(ValueError, match=said):
        read_trajectory(path)


def test_tables_of_other_things_are_refused(flight, tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    write_trajectory(path, flight)
    table = parquet.read_table(path)
    for wrong, why in (
        (arrow.table({"x": [1.0]}), "has no episode"),
        (table.drop_columns(["z"]), "lacks z"),
        (table.slice(0, 4), "4 rows, but must have a positive multiple of 3"),
    ):
        parquet.write_table(wrong, path)
        with pytest.raises(ValueError, match=why):
            read_trajectory(path)
    path.write_text("text")
    with pytest.raises(ValueError, match="not a Parquet file"):
        read_trajectory(path)


def test_rows_of_a_table_may_be_in_any_order(flight, tmp_path):
    """Sorted by name, drone_10 comes before drone_2; and capitals in the suffix are no other."""
    parquet = pytest.importorskip("pyarrow.parquet")
    fields = {name: np.repeat(getattr(flight, name), 4, axis=1) for name in GROUPS}
    fields = {name: np.concatenate([v[:, 1:2], v[:, :11]], axis=1) for name, v in fields.items()}
    terms = {name: np.zeros((len(flight.time), 12)) for name in flight.reward_terms}
    many = replace(flight, team=flight.team * 4, reward_terms=terms, **fields)
    write_trajectory(tmp_path / "a.parquet", many)
    table = parquet.read_table(tmp_path / "a.parquet")
    table = table.sort_by([("time", "ascending"), ("drone", "ascending")])
    assert table["drone"][2].as_py() == "drone_10"
    parquet.write_table(table, tmp_path / "b.PARQUET")
    assert np.array_equal(read_trajectory(tmp_path / "b.PARQUET").position, many.position)
    twice = table.set_column(1, "drone", [["drone_0"] * len(table)])
    parquet.write_table(twice, tmp_path / "d.parquet")
    with pytest.raises(ValueError, match="must have one row for each of drone_0 to drone_11"):
        read_trajectory(tmp_path / "d.parquet")


def test_without_pyarrow_the_message_says_how_to_get_it(flight, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"swarm-envs\[parquet\].*\.npz"):
        write_trajectory(tmp_path / "a.parquet", flight)


def test_obstacles_become_solids_below_the_ceiling():
    given = Box((0.0, 0.1, 0.2), (1.0, 1.1, 9.0)), Column((1.0, -1.0), 0.25, 1.5)
    block, post = solids(given, ceiling=2.5)
    assert block == Solid(False, (0.0, 0.1, 0.2), (1.0, 1.1, 2.5))
    assert post == Solid(True, (0.75, -1.25, 0.0), (1.25, -0.75, 1.5))
    assert block.rings().shape == (2, 4, 3)
    ring = post.rings()[1]
    np.testing.assert_allclose(np.linalg.norm(ring[:, :2] - [1.0, -1.0], axis=1), 0.25)
    assert (ring[:, 2] == 1.5).all()


def still(steps: int, drones: int = 2) -> Recording:
    """Small drones that hang half a metre apart for `steps` samples."""
    place = np.tile([0.0, 0.0, 1.0], (steps, drones, 1))
    place[..., 0] += 0.5 * np.arange(drones)
    off, nobody = np.zeros((steps, drones), dtype=bool), np.full((steps, drones), -1)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (steps, drones, 1))
    return Recording(
        team=parse_team("S" * drones),
        time=np.arange(steps) / 48,
        quaternion=level,
        rotor_thrust=0.0 * level,
        position=place,
        reference=place,
        goal=place,
        setpoint=place,
        velocity=0.0 * place,
        force=0.0 * place,
        contact_drone=nobody,
        contact_obstacle=nobody,
        contact_floor=off,
        contact_wall=off,
        tumbling=off,
        reward=0.0 * level[..., 0],
        reward_terms={},
        about=About("swap_v1", "me", 1, "batch", 48, ((-2, -2, 0), (2, 2, 2.5)), (), {}),
    )


KINDS = ("drone", "floor", "obstacle")


def test_events_are_named_once_when_they_begin():
    quiet = still(6, drones=3)
    contacts = {f"contact_{kind}": getattr(quiet, f"contact_{kind}").copy() for kind in KINDS}
    contacts["contact_drone"][2:4, :2] = 1, 0
    contacts["contact_floor"][3:, 2] = True
    contacts["contact_obstacle"][5, 1] = 0
    assert events(quiet) == []
    found = events(replace(quiet, **contacts))
    assert [(e.frame, e.kind, e.drones) for e in found] == [
        (2, "drone", (0, 1)),
        (3, "floor", (2,)),
        (5, "obstacle", (1,)),
    ]
    assert found[0].position.tolist() == [0.25, 0.0, 1.0]
    assert found[0].text == "0.04 s: drone_0 and drone_1 collide"


LATE = "the time limit was reached after 0.10 s."


@pytest.mark.parametrize(
    ("success", "contacts", "said"),
    [
        (True, [], "Success, after 0.10 s."),
        (False, [5], "Ended in flight, at 0.10 s: drone_1 hits the floor."),
        (False, [], f"No success: {LATE}"),
        (False, [2], f"No success: 1 of 2 drones collided or tumbled; {LATE}"),
    ],
)
def test_the_outcome_in_a_sentence(success, contacts, said):
    quiet = still(6)
    floor = quiet.contact_floor.copy()
    floor[contacts, 1] = True
    about = replace(quiet.about, metrics={"success": success})
    assert outcome(replace(quiet, contact_floor=floor, about=about)) == said


def test_metrics_have_labels_and_units():
    metrics = {
        "success": True,
        "worst_force_g": 12.3456,
        "near_misses": 2,
        "rms_tracking_error_m": 0.5,
    }
    rows = metric_rows(metrics | {"by_drone_m": [1.0], "energy_j": None})
    assert rows == [
        ("Success", "yes"),
        ("Worst force", "12.35 g"),
        ("Near misses", "2"),
        ("RMS tracking error", "0.5 m"),
    ]


def test_long_teams_are_counted():
    assert team_label(parse_team("LS")) == "LS"
    assert team_label(parse_team("S*" * 10 + "SSSSLL")) == "10 S* + 4 S + 2 L"


def passing(closest: float, contact: bool = False) -> Recording:
    """Three drones; the first two pass each other at a distance, m, in sample 2 of 6."""
    flown = still(6, drones=3)
    place = flown.position.copy()
    place[:, 1, 0] = closest + 0.06 * np.array([2, 1, 0, 1, 2, 3])
    touched = flown.contact_drone.copy()
    if contact:
        touched[3, 0], touched[3, 1] = 1, 0
    return replace(flown, position=place, contact_drone=touched)


def test_near_misses_are_marked_where_drones_are_closest():
    """Small ones touch at 0.12 m; up to 0.18 m apart they had a near miss."""
    (event,) = near_misses(passing(0.13))
    assert (event.frame, event.kind, event.drones) == (2, "near miss", (0, 1))
    assert event.position.tolist() == pytest.approx([0.065, 0.0, 1.0])
    assert event.text == "0.04 s: drone_0 and drone_1 come within 0.13 m"
    assert near_misses(passing(0.181)) == []
    assert near_misses(passing(0.119)) == []  # that is a collision
    assert near_misses(passing(0.13, contact=True)) == []  # it became one
    twice = np.concatenate([passing(0.13).position, passing(0.15).position])
    again = still(12, drones=3)
    assert [e.frame for e in near_misses(replace(again, position=twice))] == [2, 8]


def test_near_misses_agree_with_the_metric():
    """Where every physics step is a decision, both see the same."""
    agent = load("tracking")
    seen = 0
    requires = dict(agent.requires) | {"decision_rate": 240}
    env = swap_v1.parallel_env(num_drones=6, physics="batch", horizon_s=2.0, **requires)
    agent.requires = requires
    for seed in range(6):
        flown = record_episode(env, agent, seed)
        drones = {i for event in near_misses(flown) for i in event.drones}
        assert (
            len(drones - {*np.flatnonzero(flown.contact_drone[-1] >= 0)})
            == (flown.about.metrics["near_misses"])
        )
        seen += len(drones)
    assert seen > 0


MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def crash() -> Recording:
    """Six drones straight to their goals, until two meet and two nearly; a column stands by."""
    agent = load("tracking")
    env = swap_v1.parallel_env(team="SLS" * 2, physics="batch", **agent.requires)
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
    index = np.concatenate([np.zeros(20_000, np.int64), np.arange(last + 1)])
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
    shown = float(page.locator("#clock").inner_text().split(" / ")[0])
    assert abs(shown - crash.time[-1]) <= 0.00501  # 1.125 is 1.13 in JavaScript, 1.12 in Python
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
