"""Exported flights: checked against what is known; and flown by the example, with a stand-in."""

from __future__ import annotations

import csv
import importlib
import json
import struct
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import fly_episode, load
from swarm_envs.baselines.neural_swarm import plan_swarm
from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import straight_lines
from swarm_envs.cli import main
from swarm_envs.deploy import (
    Flight,
    evaluate,
    export_flight,
    flight_of,
    read_pieces,
    report,
    settled,
)
from swarm_envs.deploy.export import fit_flight, separation
from swarm_envs.interactions import load as load_model
from swarm_envs.trajectories import rest_to_rest
from swarm_envs.vehicles import GRAVITY, SMALL, parse_team
from swarm_envs.viewing.record import Recorder, Recording
from swarm_envs.viewing.trajectory import write_trajectory

TIME = np.linspace(0.0, 3.0, 151)


def crossing(gap: float = 0.5, team: str = "SS", **change: Any) -> Flight:
    """Two drones that pass each other, one so far above the other."""
    starts = np.array([[-0.7, 0.0, 1.0], [0.7, 0.0, 1.0 + gap]])
    found = [rest_to_rest(starts, starts * [-1.0, 1.0, 1.0], 3.0, t) for t in TIME]
    position, velocity = (np.array([reference[k] for reference in found]) for k in (0, 1))
    return replace(Flight(parse_team(team), TIME, position, velocity), **change)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A trained policy swaps four drones, ten decisions a second."""
    agent = load("swap-ppo")
    env = swap_v0.parallel_env(num_drones=4, physics="batch", **dict(agent.requires))
    recorder = Recorder("swap-ppo", 1)
    fly_episode(env, agent, 1, watch=recorder)
    env.close()
    return recorder.record()


def test_a_report_says_what_is_known_of_a_crossing() -> None:
    flight = crossing()
    found = report(flight, fit_flight(flight, 0.001), 0.001)
    assert not found.problems
    assert found.duration_s == pytest.approx(3.0, abs=1e-6)
    # Minimum-snap motion over d in T: speed 35/16 d/T, acceleration about 7.5132 d/T^2.
    for drone in found.drones:
        assert drone.pieces == 1
        assert drone.memory_bytes == 132
        assert drone.max_deviation_m < 1e-5
        assert drone.max_speed_m_s == pytest.approx(35.0 / 16.0 * 1.4 / 3.0, rel=1e-3)
        acceleration = 7.5132 * 1.4 / 9.0
        assert drone.max_acceleration_m_s2 == pytest.approx(acceleration, rel=1e-3)
        thrust = SMALL.mass * np.hypot(GRAVITY, acceleration)
        assert drone.max_thrust_share == pytest.approx(thrust / SMALL.max_thrust, rel=1e-3)
        tilt = np.degrees(np.arctan2(acceleration, GRAVITY))
        assert drone.max_tilt_deg == pytest.approx(tilt, rel=1e-3)
    assert found.flown.distance_m == pytest.approx(0.5, abs=1e-4)
    assert found.fitted.distance_m == pytest.approx(0.5, abs=1e-4)
    assert found.fitted.clearance_m == pytest.approx(0.5 - SMALL.diameter, abs=1e-4)
    assert found.fitted.time_s == pytest.approx(1.5, abs=0.01)


def test_thrust_carries_the_downwash_too() -> None:
    push = np.zeros((len(TIME), 2, 3))
    push[:, 0, 2] = -0.1
    flight = crossing(force=push)
    alone, pushed = report(flight, fit_flight(flight), 0.01).drones[1::-1]
    more = (pushed.max_thrust_share - alone.max_thrust_share) * SMALL.max_thrust
    assert more == pytest.approx(0.1, rel=0.02)
    assert pushed.max_force_g == pytest.approx(10.2, abs=0.1)


def test_closest_pairs_are_judged_by_their_sizes() -> None:
    """A small pair is closer, but a large one has less room between hulls."""
    place = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [3.0, 0.0, 1.0], [3.21, 0.0, 1.0]])
    found = separation(place[None], np.zeros(1), parse_team("SSLL"))
    assert found.pair == (2, 3)
    assert found.clearance_m == pytest.approx(0.21 - 0.19)
    assert found.distance_m == pytest.approx(0.2)


def test_a_flown_episode_is_exported(recording: Recording, tmp_path: Path) -> None:
    found = export_flight(settled(flight_of(recording), 1.0), tmp_path, 0.01)
    assert json.loads((tmp_path / "report.json").read_text())["problems"] == []
    for i, drone in enumerate(found.drones):
        pieces = read_pieces(tmp_path / f"drone_{i}.csv")
        gap = evaluate(pieces, recording.time)[:, :3] - recording.position[:, i]
        assert np.linalg.norm(gap, axis=1).max() <= 0.01 + 1e-6
        assert drone.max_deviation_m <= 0.01
        assert drone.pieces <= 10
        assert np.abs(evaluate(pieces, [0.0, pieces.total_s], 1)).max() < 1e-3
        assert pieces.total_s == pytest.approx(recording.time[-1] + 1.0, abs=1e-5)
    assert abs(found.fitted.distance_m - found.flown.distance_m) <= 0.02


def test_samples_are_those_of_the_pieces(recording: Recording, tmp_path: Path) -> None:
    export_flight(settled(flight_of(recording, "setpoint"), 1.0), tmp_path, rate=50.0)
    pieces = read_pieces(tmp_path / "drone_2.csv")
    with (tmp_path / "drone_2_samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    time = np.array([float(row["time"]) for row in rows])
    np.testing.assert_allclose(np.diff(time)[:-1], 0.02, atol=1e-6)
    assert time[-1] == pytest.approx(pieces.total_s, abs=1e-4)
    for order, names in enumerate((("x", "y", "z"), ("vx", "vy", "vz"), ("ax", "ay", "az"))):
        told = np.array([[float(row[name]) for name in names] for row in rows])
        np.testing.assert_allclose(told, evaluate(pieces, time, order)[:, :3], atol=2e-3)


def test_yaw_is_held_or_flown(recording: Recording) -> None:
    half = np.pi / 4.0 + np.zeros_like(recording.quaternion[..., 0])
    turned = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=-1)
    spun = replace(recording, quaternion=turned)
    yaw = fit_flight(flight_of(spun))[0].coefficients[0, 3, 0]
    assert yaw == pytest.approx(np.pi / 2, rel=1e-5)
    assert np.ptp(flight_of(recording).rows(2)[:, 3]) == 0.0
    assert np.ptp(flight_of(recording, yaw="flown").rows(2)[:, 3]) > 0.0


def test_ends_in_motion_get_ramps() -> None:
    """A straight flight at constant speed becomes one from rest to rest, along the same line."""
    line = np.column_stack([0.8 * TIME, 0.0 * TIME, 1.0 + 0.0 * TIME])[:, None]
    flight = Flight(parse_team("S"), TIME, line)
    assert any("starts at 0.80 m/s" in p for p in report(flight, fit_flight(flight), 0.01).problems)
    longer = settled(flight, 1.0)
    assert longer.duration_s == pytest.approx(5.0)
    pieces = fit_flight(longer)[0]
    assert not report(longer, (pieces,), 0.01).problems
    place = evaluate(pieces, [0.0, 2.5, 5.0])[:, :3]
    np.testing.assert_allclose(place, [[-0.4, 0, 1], [1.2, 0, 1], [2.8, 0, 1]], atol=0.01)


def test_a_part_of_a_flight_is_what_was_flown_then() -> None:
    whole = crossing(yaw=np.outer(TIME, [0.1, 0.2]))
    part = whole.part(1.0, 2.0)
    assert part.duration_s == pytest.approx(1.0)
    for t in np.linspace(0.0, 1.0, 9):
        np.testing.assert_allclose(part.curve(t), whole.curve(1.0 + t), atol=1e-9)
    assert part.rows(1)[0, 3] == pytest.approx(0.2)
    for begin, end in ((2.0, 1.0), (5.0, 9.0), (1.0, 1.3)):
        with pytest.raises(ValueError, match=r"must have at least 4 over 0\.5 s"):
            whole.part(begin, end)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time": TIME[::-1]}, "time does not increase: sample 0 is at 3 s, the next at 2.98 s"),
        ({"time": np.where(TIME > 1.0, TIME + 0.5, TIME)}, "gap of 0.52 s after 1 s"),
        ({"time": TIME / 10.0}, r"over 0.3 s, but must have at least 4 over 0.5 s"),
        ({"time": np.where(TIME == 0.0, np.nan, TIME)}, "time is nan at sample 0"),
        ({"position": np.full((len(TIME), 2, 3), np.nan)}, "position of drone_0 is .* at sample 0"),
        ({"velocity": np.full((len(TIME), 2, 3), np.inf)}, "velocity of drone_0"),
        ({"yaw": np.zeros(len(TIME))}, r"yaw has shape \(151,\), but must have \(151, 2\)"),
    ],
)
def test_what_is_no_flight_is_refused(change: Mapping[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        crossing(**change)


# The largest acceleration of 1.4 m in 0.5 s, 42 m/s^2, and gravity take 2.3 times the thrust.
@pytest.mark.parametrize(
    ("flight", "said"),
    [
        (crossing(0.1), r"drone_0 and drone_1 collide in the flight itself: .* overlap by 20 mm"),
        (crossing(0.15, "LL"), "collide on the fitted paths"),
        (crossing(position=crossing().position - [0, 0, 0.97]), "0 comes within 0.030 m of the"),
        (crossing(time=TIME / 6.0, velocity=None), "drone_0 needs 230% of the thrust of 'S'"),
    ],
    ids=["collision", "large", "floor", "thrust"],
)
def test_what_must_not_be_flown_is_not_written(flight: Flight, said: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"this must not be flown: .*{said}"):
        export_flight(flight, tmp_path / "out", 0.005)
    assert not (tmp_path / "out").exists()


def test_pieces_that_come_closer_than_the_flight_are_found() -> None:
    found = report(crossing(0.3), fit_flight(crossing(0.2)), 0.01)
    assert any("100 mm closer than in the flight" in problem for problem in found.problems)


def test_the_command(recording: Recording, tmp_path: Path, capsys: Any) -> None:
    write_trajectory(tmp_path / "flight.npz", recording)
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    call = ["export", "trajectory", str(tmp_path / "flight.npz"), "--out", str(out)]
    assert main([*call, "--json", str(copy), "--tolerance", "0.02"]) == 0
    shown = capsys.readouterr().out
    assert "wrote 4 trajectories" in shown
    assert "closest: " in shown
    told = json.loads(copy.read_text())
    assert told == json.loads((out / "report.json").read_text())
    assert told["source"]["agent"] == "swap-ppo"
    assert told["tolerance_m"] == 0.02
    assert len(list(out.glob("drone_*.csv"))) == 8
    assert (out / "paths.png").read_bytes()[:4] == b"\x89PNG"
    assert main([*call, "--begin-s", "1", "--end-s", "2.5", "--tolerance", "0.02"]) == 0
    told = json.loads((out / "report.json").read_text())  # 1.5 s and two ramps
    assert told["duration_s"] == pytest.approx(3.5, abs=1e-4)
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    for given, code, said in (
        (["--begin-s", "3", "--end-s", "1"], 2, "--begin-s is 3, but must lie before the end, 1"),
        (["--settle-s", "0"], 1, "add ramps (--settle-s 1)"),
        (["--tolerance", "0"], 1, "tolerance is 0.0, but must be positive"),
        (["no.npz"], 2, "there is no file"),
        (["bad.npz"], 1, "is not an npz file"),
    ):
        file = tmp_path / (given.pop() if given[0].endswith(".npz") else "flight.npz")
        assert main(["export", "trajectory", str(file), "--out", str(out), *given]) == code
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", ["plan.npz", "plan.json"])
def test_a_saved_plan_is_exported(name: str, tmp_path: Path) -> None:
    """The pieces pass through the plan's own positions at its own times."""
    starts = np.array([[0.0, -0.6, 1.0], [0.0, 0.6, 1.0]])
    goals, air = starts[::-1], load_model("none")
    problem = PlanningProblem(starts, goals, parse_team("SS"), air, max_duration=3.0, plane="yz")
    guess = straight_lines(problem, bend=[[0.0, 0.0, 0.3], [0.0, 0.0, -0.3]])
    given = {"plane": "yz", "max_duration": 3.0, "initial": guess}
    plan = plan_swarm(starts, goals, "SS", air, **given)  # type: ignore[arg-type]
    plan.save(tmp_path / name)
    call = ["export", "trajectory", str(tmp_path / name), "--out", str(tmp_path / "out")]
    assert main(call) == 0
    told = json.loads((tmp_path / "out" / "report.json").read_text())
    assert told["source"] == {"file": name, "plan": "converged", "seed": plan.seed}
    times = np.linspace(0.0, plan.duration, len(plan.states))
    for drone in range(2):
        pieces = read_pieces(tmp_path / "out" / f"drone_{drone}.csv")
        gap = evaluate(pieces, times)[:, :3] - plan.states[:, drone, :3]
        assert np.linalg.norm(gap, axis=1).max() < 0.011


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
    """Logs the commands that it receives."""

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
    export_flight(crossing(), out)
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
    assert max(waited) == pytest.approx(4.0, abs=1e-3)  # the trajectory's 3 s and a rest


def test_an_interruption_lands_everyone(script: Any, trajectories: Any) -> None:
    swarm = Swarm(trajectories, {})

    def sleep(seconds: float) -> None:
        if seconds > 3.5 and not any(entry[1] == "land" for entry in swarm.log):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        script.fly(swarm, trajectories, sleep)
    ends = [entry[1] for entry in swarm.log[-4:]]
    assert ends == ["land", "land", "stop", "stop"]


def test_drones_in_wrong_places_do_not_take_off(script: Any, trajectories: Any) -> None:
    right = {URIS["drone_0"]: (-0.7, 0.05, 0.0), URIS["drone_1"]: (0.7, 0.0, 0.0)}
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
