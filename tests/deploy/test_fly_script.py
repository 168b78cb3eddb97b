"""The example that flies real drones, against a stand-in for cflib that notes every command."""

from __future__ import annotations

import importlib
import json
import struct
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swarm_envs.deploy import Flight, export_flight, read_pieces
from swarm_envs.trajectories import rest_to_rest
from swarm_envs.vehicles import parse_team

FILE = Path(__file__).parents[2] / "examples" / "fly_crazyflie.py"
URIS = {"drone_0": "radio://0/80/2M/E7E7E7E701", "drone_1": "radio://0/80/2M/E7E7E7E702"}


class Poly4D:
    """As cflib has it: 32 coefficients and a duration, little-endian."""

    class Poly:
        def __init__(self, values: list[float]) -> None:
            self.values = values

    def __init__(self, duration: float, x: Any, y: Any, z: Any, yaw: Any) -> None:
        self.values = [*x.values, *y.values, *z.values, *yaw.values, duration]

    def pack(self) -> bytes:
        return struct.pack("<33f", *self.values)


class Drone:
    """Notes what it is told."""

    def __init__(self, uri: str, log: list[tuple[Any, ...]]) -> None:
        self.memory = SimpleNamespace(trajectory=[], write_data_sync=lambda: True)

        class Commander:
            def __getattr__(self, name: str) -> Any:
                return lambda *given: log.append((uri, name, *given))

        supervisor = SimpleNamespace(send_arming_request=lambda on: log.append((uri, "arm", on)))
        self.cf = SimpleNamespace(
            link_uri=uri,
            mem=SimpleNamespace(get_mems=lambda kind: [self.memory]),
            high_level_commander=Commander(),
            supervisor=supervisor,
        )


class Swarm:
    def __init__(self, uris: Any, positions: dict[str, Any]) -> None:
        self.log: list[tuple[Any, ...]] = []
        self._cfs = {uri: Drone(uri, self.log) for uri in uris}
        self._positions = positions

    def get_estimated_positions(self) -> dict[str, Any]:
        return self._positions

    def parallel_safe(self, function: Any, given: Any = None) -> None:
        for uri, scf in self._cfs.items():
            function(scf, *(given[uri] if given else []))


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The example as a module, with cflib's part that it packs with."""
    mem = ModuleType("cflib.crazyflie.mem")
    vars(mem).update(Poly4D=Poly4D, MemoryElement=SimpleNamespace(TYPE_TRAJ=0x12))
    for name in ("cflib", "cflib.crazyflie"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, mem.__name__, mem)
    monkeypatch.syspath_prepend(FILE.parent)
    monkeypatch.delitem(sys.modules, FILE.stem, raising=False)
    return importlib.import_module(FILE.stem)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drones that cross, one half a metre above the other."""
    out = tmp_path_factory.mktemp("crossing")
    time = np.linspace(0.0, 4.0, 201)
    starts = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.5]])
    found = [rest_to_rest(starts, starts * [-1.0, 1.0, 1.0], 4.0, t) for t in time]
    position, velocity = (np.array([reference[k] for reference in found]) for k in (0, 1))
    export_flight(Flight(parse_team("SS"), time, position, velocity), out)
    return out


@pytest.fixture
def trajectories(script: Any, folder: Path) -> Any:
    return script.load(folder, URIS)


def test_what_is_uploaded_are_the_file_s_bytes(script, folder, trajectories):
    swarm = Swarm(trajectories, {})
    swarm.parallel_safe(script.upload, {uri: [p] for uri, p in trajectories.items()})
    for name, uri in URIS.items():
        pieces = read_pieces(folder / f"{name}.csv")
        rows = [[*c.ravel(), d] for d, c in zip(pieces.duration, pieces.coefficients, strict=True)]
        sent = b"".join(piece.pack() for piece in swarm._cfs[uri].memory.trajectory)
        assert sent == np.array(rows, dtype="<f4").tobytes()
        assert len(sent) == 132 * len(pieces)
        assert (uri, "define_trajectory", 1, 0, len(pieces)) in swarm.log


def test_upper_drones_take_off_first_and_land_last(script: Any, trajectories: Any) -> None:
    swarm = Swarm(trajectories, {})
    waited: list[float] = []
    script.fly(swarm, trajectories, waited.append)
    low, high = URIS["drone_0"], URIS["drone_1"]
    order = [(entry[0], entry[1]) for entry in swarm.log]
    assert order.index((high, "takeoff")) < order.index((low, "takeoff"))
    assert order.index((low, "land")) < order.index((high, "land"))
    assert order.index((low, "go_to")) < order.index((low, "start_trajectory"))
    assert order[-2:] == [(low, "stop"), (high, "stop")]
    assert (low, "takeoff", pytest.approx(1.0), script.TAKE_OFF_S) in swarm.log
    assert max(waited) == pytest.approx(5.0, abs=1e-3)  # the trajectory's 4 s and a rest


def test_an_interruption_lands_everyone(script: Any, trajectories: Any) -> None:
    swarm = Swarm(trajectories, {})

    def sleep(seconds: float) -> None:
        if seconds > 4.0 and not any(entry[1] == "land" for entry in swarm.log):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        script.fly(swarm, trajectories, sleep)
    ends = [entry[1] for entry in swarm.log[-4:]]
    assert ends == ["land", "land", "stop", "stop"]


def test_drones_in_wrong_places_do_not_take_off(script: Any, trajectories: Any) -> None:
    right = {URIS["drone_0"]: (-1.0, 0.05, 0.0), URIS["drone_1"]: (1.0, 0.0, 0.0)}
    script.check(Swarm(trajectories, right), trajectories)
    changed = {URIS["drone_0"]: right[URIS["drone_1"]], URIS["drone_1"]: right[URIS["drone_0"]]}
    for wrong in (changed, right | {URIS["drone_0"]: (float("nan"), 0.0, 0.0)}):
        with pytest.raises(SystemExit, match="put it below"):
            script.check(Swarm(trajectories, wrong), trajectories)


def test_every_drone_needs_its_own_radio(script: Any, folder: Path) -> None:
    for uris in ({"drone_0": "radio://0"}, dict.fromkeys(URIS, "radio://0")):
        with pytest.raises(SystemExit, match="name one URI for each of drone_0, drone_1"):
            script.load(folder, uris)


def test_without_cflib_it_says_how_to_get_it(script, folder, tmp_path, monkeypatch):
    (tmp_path / "uris.json").write_text(json.dumps(URIS))
    monkeypatch.setitem(sys.modules, "cflib", None)
    with pytest.raises(SystemExit, match="pip install cflib"):
        script.main([str(folder), "--uris", str(tmp_path / "uris.json")])
