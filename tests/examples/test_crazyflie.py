"""The example examples/crazyflie.py: its files follow the recorded flight."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from examples.crazyflie import Options, curve, fit, main
from swarm_envs import swap_v1
from swarm_envs.agents import load, record_episode
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.trajectory import write_trajectory


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    """A stacked swap and the file that it is recorded in."""
    agent = load("tracking")
    env = swap_v1.parallel_env(team="L2S", layout="stacked", physics="batch", **agent.requires)
    recording = record_episode(env, agent, 1)
    env.close()
    path = tmp_path_factory.mktemp("flight") / "flight.npz"
    write_trajectory(path, recording)
    return path, recording


def read(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


def test_pieces_follow_the_flight(flight, tmp_path, capsys):
    path, recording = flight
    assert main(Options(path, out=tmp_path)) > 0.0
    printed = capsys.readouterr().out
    for part in ("drone_0 (L):", "drone_1 (S):", "bodies stay at least"):
        assert part in printed
    for drone in range(2):
        header, rows = read(tmp_path / f"drone_{drone}.csv")
        assert header[:2] == ["duration", "x^0"]
        assert len(header) == 33
        assert len(rows) <= 31
        ends = np.cumsum(rows[:, 0])
        assert ends[-1] == pytest.approx(recording.time[-1], abs=1e-4)
        gaps = []
        for now, place in zip(recording.time, recording.position[:, drone], strict=True):
            k = min(int(np.searchsorted(ends, now)), len(rows) - 1)
            axes = rows[k, 1:25].reshape(3, 8)
            begun = ends[k] - rows[k, 0]
            gaps.append(np.abs([Polynomial(axis)(now - begun) for axis in axes] - place).max())
        assert max(gaps) < 0.0101


def test_setpoints_are_the_flight_at_a_rate(flight, tmp_path):
    path, recording = flight
    main(Options(path, out=tmp_path, rate=float(recording.about.decision_rate)))
    header, rows = read(tmp_path / "drone_1_setpoints.csv")
    assert header == ["t", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "yaw"]
    count = len(recording.time)
    assert rows[:count, 0] == pytest.approx(recording.time, abs=1e-9)
    assert rows[:count, 1:4] == pytest.approx(recording.position[:, 1], abs=1e-9)
    assert rows[:count, 4:7] == pytest.approx(recording.velocity[:, 1], abs=1e-9)


def test_a_tolerance_that_31_pieces_miss_is_refused_before_anything_is_written(flight, tmp_path):
    with pytest.raises(ValueError, match="31 pieces come within") as missed:
        main(Options(flight[0], out=tmp_path, tolerance_m=1e-7))
    assert not [*tmp_path.iterdir()]
    reached = float(str(missed.value).split("within ")[1].split()[0])
    fit(curve(flight[1], 0), reached)  # with all the digits that the message has


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rate": math.nan}, "--rate is nan, but must be"),
        ({"rate": math.inf}, "--rate is inf, but must be"),
        ({"rate": 1e12}, "--rate is 1000000000000.0, but must be"),
        ({"tolerance_m": math.nan}, "--tolerance-m is nan, but must be"),
        ({"out": Path(__file__)}, "but that is a file"),
    ],
)
def test_options_that_cannot_be_are_refused(wrong, said, flight):
    with pytest.raises(ValueError, match=said):
        main(Options(flight[0], **wrong))
