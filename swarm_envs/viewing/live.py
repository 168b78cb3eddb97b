"""Live viewer in a web browser, for `render_mode="human"`, locally or over ssh.

A small server on 127.0.0.1 serves one page (`page/live.html`) and sends it a frame after every
decision as a server-sent event. The page sends pause, single steps and speed as requests. Every URL
has a random token, so that other users of the machine and other pages have no access.
"""

from __future__ import annotations

import base64
import hmac
import importlib
import json
import os
import secrets
import sys
import threading
import time
import webbrowser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from swarm_envs.viewing.record import solids
from swarm_envs.viewing.replay import asset
from swarm_envs.viewing.style import drone_colors

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.vehicles import Team

__all__ = ["LiveViewer"]

MOST_SHOWN = 16  # Largest number of environments that are shown side by side
ROW = {"position": 3, "quaternion": 4, "goal": 3, "force": 3, "hit": 1}
"""Fields of each drone in a frame and their lengths; units m, 1, m, N, and 0 or 1."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)  # Multiples of real time
_WAIT_S = 10.0  # Longest wait for the first browser before the first frame
_IDLE_S = 5.0  # Interval of comments that keep a connection open
_SILENT_S = 5.0  # Time after which a connection without a request is closed
MOST_CONNECTIONS = 32  # Largest number of connections; others are closed


class LiveViewer:
    """Viewer that shows environments in a browser and paces them to real time.

    Args:
        core: the environments; the first 16 of them are shown.
        wait_s: the longest wait of the first frame for a browser, s; None for 10.
    """

    def __init__(self, core: SwarmCore, wait_s: float | None = None) -> None:
        self._core, self._wait_s = core, _WAIT_S if wait_s is None else wait_s
        self._server = _Server(("127.0.0.1", 0), _Handler)
        self._server.scene = self._scene()
        self.url = f"http://127.0.0.1:{self._server.server_port}/?token={self._server.token}"
        """The URL of the page."""
        self._due = 0.0
        self._between_s = 1.0 / core.config.decision_rate
        self._shown = slice(0, min(core.num_envs, MOST_SHOWN))
        self._teams: list[Team] = []
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        _announce(self.url)

    def show(self) -> None:
        """Send the environments, and wait for real time and while the page is paused."""
        server = self._server
        if self._wait_s and not server.joined.is_set():
            sys.stderr.write(f"swarm_envs: waiting up to {self._wait_s:g} s for a browser\n")
            server.joined.wait(self._wait_s)
            self._wait_s = 0.0
        self.send()
        server.wait_while_paused()
        time.sleep(max(0.0, self._due - time.perf_counter()))
        self._due = time.perf_counter() + self._between_s / server.speed

    def send(self) -> None:
        """Send the current state of the environments, and sizes and colors of changed teams."""
        teams = [task.team for task in self._core.tasks[self._shown]]
        if teams != self._teams:
            looks = [_look(team) for team in teams]
            self._teams, self._server.teams = teams, _message(teams=looks)
        self._server.send(self._frame())

    def close(self) -> None:
        """Stop the server. It may be called more than once."""
        self._server.send(_message(closed=True))
        self._server.ending = True
        self._server.shutdown()
        self._server.server_close()

    def _scene(self) -> dict[str, Any]:
        """Return the constants of the environments."""
        core, arena = self._core, self._core.task.arena
        return {
            "task": core.task.name,
            "arena": arena.tolist(),
            "row": ROW,
            "speeds": SPEEDS,
            "solids": [
                np.round(solid.rings(), 3).tolist()
                for solid in solids(core.task.obstacles, float(arena[1, 2]))
            ],
        }

    def _frame(self) -> bytes:
        """Return the current state: for each drone a row of float32 in order of `ROW`, base64."""
        core, drones = self._core, self._core.world.drones[self._shown]
        columns = (drones["position"], drones["quaternion"], drones["goal"])
        hit = (drones["crashed"] > 0.0)[..., None]
        rows = np.concatenate([*columns, core.physics.force[self._shown], hit], axis=-1)
        coded = base64.b64encode(rows.astype("<f4").tobytes()).decode()
        return _message(time=np.round(core.time[self._shown], 3).tolist(), drones=coded)


def _look(team: Team) -> list[tuple[float, str]]:
    """Return radius, m, and color of each drone."""
    sizes = [vehicle.diameter / 2.0 for vehicle in team]
    return [*zip(sizes, drone_colors(team), strict=True)]


def _message(**content: Any) -> bytes:
    """Return a server-sent event."""
    return b"data: " + json.dumps(content).encode() + b"\n\n"


def _announce(url: str) -> None:
    """Show the page in the output of a notebook, or in a browser if there is a display."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if hasattr(shell, "kernel"):
        display = importlib.import_module("IPython.display")
        display.display(display.IFrame(url, "100%", 480))
        return
    sys.stderr.write(f"swarm_envs: watch the flight at {url}\n")
    if os.environ.get("DISPLAY") or sys.platform in ("darwin", "win32"):
        webbrowser.open(url)


class _Server(ThreadingHTTPServer):
    """Server that stores the latest frame, and the pages' requests."""

    daemon_threads = True

    def __init__(self, *address: Any) -> None:
        super().__init__(*address)
        self.token = secrets.token_urlsafe(16)
        self.scene: dict[str, Any] = {}
        self.teams = b""
        self.joined = threading.Event()
        self.ending = False
        self.watching = 0
        self.speed = 1.0
        self._paused, self._steps = False, 0
        self._changed = threading.Condition()
        self._frame = b""
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread, or close the connection if there are too many."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a connection until it ends."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def send(self, frame: bytes) -> None:
        with self._changed:
            self._frame = frame
            self._changed.notify_all()

    def next_frame(self, seen: bytes) -> bytes:
        """Wait for a frame other than `seen` and return it, or `seen` after `_IDLE_S`."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not seen, _IDLE_S)
            return self._frame

    def control(self, asked: dict[str, Any]) -> None:
        with self._changed:
            if "paused" in asked:
                self._paused = bool(asked["paused"])
            if asked.get("speed") in SPEEDS:
                self.speed = float(asked["speed"])
            self._steps += bool(asked.get("step"))
            self._changed.notify_all()

    def wait_while_paused(self) -> None:
        """Wait while a page is paused, until it resumes or steps, or all pages are closed."""
        with self._changed:
            while self._paused and not self._steps and self.watching:
                self._changed.wait(0.2)
            self._steps = max(self._steps - 1, 0)


class _Handler(BaseHTTPRequestHandler):
    """Handler of requests with the token."""

    server: _Server
    timeout = _SILENT_S

    def do_GET(self) -> None:
        path = self._path()
        if path == "/":
            self._answer("text/html; charset=utf-8", self._page())
        elif path == "/events":
            self._send_events()
        elif path is not None:
            self.send_error(404)

    def do_POST(self) -> None:
        if self._path() != "/control":
            return
        length = self.headers.get("Content-Length") or "0"
        if not length.isdecimal():
            self.send_error(400)
            return
        try:
            asked = json.loads(self.rfile.read(min(int(length), 1000)))
        except ValueError:
            asked = None
        if isinstance(asked, dict):
            self.server.control(asked)
        self._answer("application/json", b"{}")

    def log_message(self, *_: object) -> None:
        """Write nothing to the terminal."""

    def _path(self) -> str | None:
        """Return the path of a request with the token to this machine's address; else refuse it."""
        parts = urlsplit(self.path)
        token = parse_qs(parts.query).get("token", [""])[0]
        host = (self.headers.get("Host") or "").rpartition(":")[0]
        known = hmac.compare_digest(token.encode(), self.server.token.encode())
        if known and host in ("127.0.0.1", "localhost"):
            return parts.path
        self.send_error(403)
        return None

    def _page(self) -> bytes:
        scene = json.dumps(self.server.scene).replace("<", "\\u003c")
        page = asset("live.html").replace("/*scene*/", scene)
        page = page.replace("/*view*/", asset("scene.js")).replace("/*script*/", asset("live.js"))
        return page.encode()

    def _answer(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(body)

    def _send_events(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        server, seen, teams = self.server, b"", b""
        server.watching += 1
        server.joined.set()
        try:
            while not server.ending:
                frame = server.next_frame(seen)
                if teams is not server.teams:
                    teams = server.teams
                    self.wfile.write(teams)
                self.wfile.write(b": still here\n\n" if frame is seen else frame)
                self.wfile.flush()
                seen = frame
        except OSError:  # the page was closed
            pass
        finally:
            server.watching -= 1
