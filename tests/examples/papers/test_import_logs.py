"""Neural-Swarm2's importer: logs written by the rules of their format, a small clone, the real."""

from __future__ import annotations

import os
import struct
import subprocess
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from examples.papers.neural_swarm2 import import_logs as logs
from examples.papers.neural_swarm2.__main__ import main
from swarm_envs.training.flight_logs.read import data_sha256

STATE = [f"stateEstimateZ.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az")]
FORMAT = {"tick": "I"} | dict.fromkeys(STATE, "h") | {"stateEstimateZ.quat": "I"}
FORMAT |= {f"pwm.m{k}_pwm": "I" for k in (1, 2, 3, 4)} | {"pm.vbatMV": "H"}
LEVEL = 3 << 30  # the quaternion (0, 0, 0, 1): its largest component is the last, others are zero


def write_log(path: Path, records: list[dict[str, int]]) -> None:
    """Write a micro SD log with two records a block, checksums zero."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = bytes([len(FORMAT)]) + "".join(f"{n}({c})," for n, c in FORMAT.items()).encode()
    blocks = [records[k : k + 2] for k in range(0, len(records), 2)]
    layout, content = struct.Struct("<" + "".join(FORMAT.values())), header + bytes(4)
    for block in blocks:
        packed = [layout.pack(*(record[name] for name in FORMAT)) for record in block]
        content += bytes([len(block)]) + b"".join(packed) + bytes(4)
    path.write_bytes(content)


def hovering(steps: int, height_mm: int, signal: int) -> list[dict[str, int]]:
    """A drone at rest that logs its weight as acceleration."""
    still = dict.fromkeys(FORMAT, 0) | {"stateEstimateZ.z": height_mm, "stateEstimateZ.az": 9810}
    still |= {"stateEstimateZ.quat": LEVEL, "pm.vbatMV": 3780}
    still |= {f"pwm.m{k}_pwm": signal for k in (1, 2, 3, 4)}
    return [still | {"tick": 1_000_000 + 10_000 * k} for k in range(steps)]


def pack(quaternion: np.ndarray) -> int:
    """Compress as the firmware does: the largest component is left out, and made positive."""
    largest = int(np.argmax(np.abs(quaternion)))
    sign, bits = np.sign(quaternion[largest]), largest
    for k in range(4):
        if k != largest:
            value = sign * quaternion[k]
            bits = bits << 10 | int(value < 0) << 9 | round(abs(value) * np.sqrt(2.0) * 511)
    return bits


def test_a_log_is_read_back(tmp_path):
    written = hovering(5, 700, 40_000)
    write_log(tmp_path / "cf50_00", written)
    read = logs.read_log(tmp_path / "cf50_00")
    assert [dict(zip(FORMAT, record, strict=True)) for record in read.tolist()] == written


def test_quaternions_are_those_that_were_packed():
    turns = np.random.default_rng(0).standard_normal((200, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    found = logs.unpack_quaternions([pack(turn) for turn in turns])
    assert np.abs(np.sum(found * turns, axis=1)) == pytest.approx(1.0, abs=2e-5)


def small_clone(folder: Path, monkeypatch) -> Path:
    """A repository with one flight of a small drone below a large one, and another beside it."""
    monkeypatch.setattr(logs, "GROUPS", (("1/swap", "00 01", (50, 101)),))
    monkeypatch.setattr(logs, "SPLIT", "0001----")
    clone, digest = folder / "clone", sha256()
    for name, height in (("cf50_00", 500), ("cf101_00", 800), ("cf50_01", 500), ("cf101_01", 800)):
        path = clone / "data" / "training" / "datacollection1" / "swap" / name
        write_log(path, hovering(13, height, 38_000 if "50" in name else 41_000))
        digest.update(path.read_bytes())
    monkeypatch.setattr(logs, "LOGS_SHA256", digest.hexdigest())
    git = ["git", "-C", str(clone), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "logs"], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    monkeypatch.setattr(logs, "COMMIT", head.stdout.strip())
    return clone


def test_rows_are_the_weight_less_the_thrust(tmp_path, monkeypatch):
    clone = small_clone(tmp_path, monkeypatch)
    main(["import", str(clone), "--out", str(tmp_path / "out")])
    with np.load(tmp_path / "out" / logs.FILE) as rows:
        assert [str(rows["names"][k]) for k in rows["scenario"]] == ["L2S"] * 4 + ["S2L"] * 4
        assert rows["step"].tolist() == [0, 3, 6, 9] * 2 and rows["val"].all()
        assert rows["x"][0, :9] == pytest.approx([0, 0, -0.5, 0, 0, 0, 0, 0, 0.3])
        # Table I at p = 38,000 / 65,536 and v = 0.9, for four rotors of a drone of 32 g.
        p, v = 38_000 / 65_536, 0.9
        thrust = 4 * (11.09 - 39.08 * p - 9.53 * v + 20.57 * p * p + 38.43 * p * v)
        assert rows["fa"][:4, 2] == pytest.approx(np.full(4, 32.0 - thrust), abs=0.04)
        assert rows["fa"][:4, :2] == pytest.approx(np.zeros((4, 2)), abs=1e-6)
    assert len(data_sha256(tmp_path / "out" / logs.FILE)) == 64


def test_other_commits_and_logs_are_refused(tmp_path, monkeypatch, capsys):
    clone = small_clone(tmp_path, monkeypatch)
    for name, digits, said in (("LOGS_SHA256", 64, "changed"), ("COMMIT", 40, "check out 0000")):
        monkeypatch.setattr(logs, name, digits * "0")
        with pytest.raises(SystemExit):
            main(["import", str(clone), "--out", str(tmp_path / "out")])
        assert said in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif("NEURAL_SWARM_CLONE" not in os.environ, reason="needs a clone of the logs")
def test_the_rows_are_those_that_the_models_were_fitted_to(shared_data, tmp_path):
    main(["import", os.environ["NEURAL_SWARM_CLONE"], "--out", str(tmp_path)])
    with np.load(tmp_path / logs.FILE) as found, np.load(shared_data / logs.FILE) as expected:
        assert sorted(found) == sorted(expected)
        for name in expected:
            assert np.array_equal(found[name], expected[name]), name
