"""The live viewer: what the page is sent, who may ask for it, and the page in a browser."""

from __future__ import annotations

import base64
import json
import socket
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.tasks.obstacles import Column
from swarm_envs.viewing import live
from swarm_envs.viewing.live import ROW, LiveViewer
from tests.helpers.browsers import PATIENCE_MS, chromium, complaints


@pytest.fixture
def env():
    made = swap_v1.parallel_env(team="LS", physics="batch", obstacles=[Column((0.0, 0.0), 0.2)])
    made.reset(seed=0)
    yield made
    made.close()


def ask(url: str, data: dict[str, Any] | None = None, host: str | None = None) -> bytes:
    body = None if data is None else json.dumps(data).encode()
    request = urllib.request.Request(url, body, {} if host is None else {"Host": host})
    with urllib.request.urlopen(request, timeout=10) as answer:
        return bytes(answer.read())


def decoded(event: dict[str, Any]) -> dict[str, Any]:
    """An event; of a frame, each field of its rows as an array."""
    if "drones" not in event:
        return event
    numbers = np.frombuffer(base64.b64decode(event["drones"]), np.float32)
    rows = numbers.reshape(len(event["time"]), -1, sum(ROW.values()))
    parts = np.split(rows, np.cumsum([*ROW.values()])[:-1], axis=-1)
    return {**event, **dict(zip(ROW, parts, strict=True))}


def frames(viewer: LiveViewer, count: int, found: list[dict[str, Any]]) -> threading.Thread:
    """A browser that reads so many events: the teams, then frames."""

    def read() -> None:
        with urllib.request.urlopen(viewer.url.replace("/?", "/events?"), timeout=20) as events:
            while len(found) < count:
                line = events.readline()
                if line.startswith(b"data: "):
                    found.append(decoded(json.loads(line[6:])))

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    return thread


def test_a_frame_is_the_state_of_the_environment(env, capsys):
    viewer, found = LiveViewer(env.core), list[dict[str, Any]]()
    assert viewer.url in capsys.readouterr().err
    reader = frames(viewer, 2, found)
    viewer.show()
    reader.join(20)
    viewer.close()
    (large, small), frame = found[0]["teams"][0], found[1]
    np.testing.assert_allclose(frame["position"], env.core.physics.state.position, atol=1e-4)
    np.testing.assert_allclose(frame["quaternion"], env.core.physics.state.quaternion, atol=1e-4)
    np.testing.assert_allclose(frame["goal"], env.core.world.drones["goal"], atol=1e-3)
    np.testing.assert_allclose(frame["force"], env.core.physics.force, atol=1e-4)
    assert large[0] > small[0] and large[1] != small[1]
    assert not frame["hit"].any()


def test_teams_are_sent_again_when_they_change(env):
    viewer, found = LiveViewer(env.core), list[dict[str, Any]]()
    reader = frames(viewer, 4, found)
    viewer.show()
    while len(found) < 2:
        time.sleep(0.01)
    env.reset(options={"team": "SS"})
    viewer.show()
    reader.join(20)
    viewer.close()
    assert ["teams" in event for event in found] == [True, False, True, False]


def test_a_notebook_shows_the_page_in_its_output(env, monkeypatch, capsys):
    shown: list[tuple[Any, ...]] = []
    display = SimpleNamespace(IFrame=lambda *given: given, display=shown.append)
    shell = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=None), display=display)
    monkeypatch.setitem(sys.modules, "IPython", shell)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    viewer = LiveViewer(env.core, wait_s=0.0)
    viewer.close()
    assert shown == [(viewer.url, "100%", 480)] and not capsys.readouterr().err


def test_idle_connections_leave_room_and_are_closed(env, monkeypatch):
    monkeypatch.setattr(live._Handler, "timeout", 0.1)
    monkeypatch.setattr(live, "MOST_CONNECTIONS", 4)
    viewer = LiveViewer(env.core, wait_s=0.0)
    before = threading.active_count()
    address = urllib.parse.urlsplit(viewer.url)
    place, count = (address.hostname, address.port), 2 * live.MOST_CONNECTIONS
    idle = [socket.create_connection(place) for _ in range(count)]
    assert threading.active_count() - before <= live.MOST_CONNECTIONS
    assert all(connection.recv(1) == b"" for connection in idle)  # closed by the server
    assert "swap_v1" in ask(viewer.url).decode()
    viewer.close()
    for connection in idle:
        connection.close()


@pytest.mark.parametrize("length", ["-1", "many"])
def test_a_length_that_is_none_is_refused_at_once(env, length):
    viewer = LiveViewer(env.core, wait_s=0.0)
    address = urllib.parse.urlsplit(viewer.url)
    with socket.create_connection((address.hostname, address.port), timeout=4) as connection:
        head = f"POST /control?{address.query} HTTP/1.1\r\nHost: {address.netloc}\r\n"
        connection.sendall(f"{head}Content-Length: {length}\r\n\r\n".encode())
        assert b" 400 " in connection.recv(100)
    viewer.close()


def test_only_who_knows_the_token_sees_anything(env):
    viewer = LiveViewer(env.core, wait_s=0.0)
    page = ask(viewer.url).decode()
    assert "swap_v1" in page and "/*" not in page.split("<body>")[1].split("<script>")[0]
    bare = viewer.url.split("?")[0]
    for bad in (bare, bare + "?token=x", bare + "events", bare + "control"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            ask(bad, {} if bad.endswith("control") else None)
    with pytest.raises(urllib.error.HTTPError, match="403"):
        ask(viewer.url, host="example.org:80")  # a page of another name that points here
    with pytest.raises(urllib.error.HTTPError, match="404"):
        ask(viewer.url.replace("/?", "/nothing?"))
    viewer.close()


def test_nobody_looks_and_the_flight_goes_on(env):
    viewer = LiveViewer(env.core, wait_s=0.0)
    ask(viewer.url.replace("/?", "/control?"), {"paused": True, "speed": 4.0})
    viewer.show()  # paused, but no page is open that could go on
    ask(viewer.url.replace("/?", "/control?"), {"speed": 1e9})
    ask(viewer.url.replace("/?", "/control?"), {"speed": "fast", "step": "yes"})
    viewer.show()
    viewer.close()


def test_a_paused_flight_goes_on_by_steps(env):
    viewer, found = LiveViewer(env.core), list[dict[str, Any]]()
    reader = frames(viewer, 3, found)
    viewer.show()
    control = viewer.url.replace("/?", "/control?")
    ask(control, {"paused": True})
    thread = threading.Thread(target=viewer.show, daemon=True)
    thread.start()
    thread.join(0.5)
    assert thread.is_alive()
    ask(control, {"step": True})
    thread.join(10)
    assert not thread.is_alive()
    ask(control, {"paused": False})
    reader.join(20)
    viewer.close()


def test_many_environments_are_shown_side_by_side(monkeypatch):
    monkeypatch.setattr("swarm_envs.viewing.live._WAIT_S", 0.0)
    given: Any = {"num_envs": 20, "num_drones": 2, "render_mode": "human"}
    envs: Any = gymnasium.make_vec("swarm_envs/Swap-v1", **given)
    envs.reset(seed=0)
    viewer, found = envs.unwrapped._live, list[dict[str, Any]]()
    reader = frames(viewer, 2, found)
    reader.join(20)
    envs.close()
    np.testing.assert_allclose(
        found[1]["position"], envs.unwrapped.core.physics.state.position[:16], atol=1e-4
    )


def test_the_page_draws_the_swarm_in_a_browser(monkeypatch):
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.set_default_timeout(PATIENCE_MS)
        said = complaints(page)
        env = swap_v1.parallel_env(num_drones=3, physics="batch", render_mode="human")
        monkeypatch.setattr("swarm_envs.viewing.live._WAIT_S", 0.0)
        monkeypatch.delenv("DISPLAY", raising=False)
        env.reset(seed=0)
        page.goto(env._live.url)
        page.wait_for_function("window.live !== undefined")
        for _ in range(5):
            env.step({agent: np.ones(3, np.float32) for agent in env.agents})
        page.wait_for_function("window.live.frame && window.live.frame.time[0] > 0.1")
        shown = page.evaluate("window.live.frame.position[0]")
        np.testing.assert_allclose(shown, env.view.state.position, atol=1e-4)
        before = page.screenshot()
        page.mouse.move(400, 300)
        page.mouse.down()
        page.mouse.move(500, 320)
        page.mouse.up()
        deadline = time.monotonic() + 60
        while page.screenshot() == before:  # a busy machine draws late
            assert time.monotonic() < deadline
        assert not said
        env.close()
        page.wait_for_function("document.getElementById('status').textContent.includes('closed')")
