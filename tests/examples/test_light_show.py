"""The example examples/light_show.py at tiny size."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from examples.light_show import Options, letters, main
from swarm_envs.viewing.trajectory import read_trajectory


def test_a_letter_is_written_and_its_files_too(tmp_path, capsys):
    options = Options(text="I", drones=5, stage_s=7.0, video=False, out=tmp_path)
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert "formation 1: the paths take" in printed
    assert "5 drones, 14.0 s: 0 contacts" in printed
    flight = read_trajectory(tmp_path / "flight.npz")
    stands = flight.position[int(np.searchsorted(flight.time, 7.0)) - 1]
    shape = letters("I", 5)[0]
    middle = stands - stands.mean(axis=0)
    apart = np.linalg.norm(middle[:, None] - (shape - shape.mean(axis=0)), axis=-1).min(axis=0)
    assert apart.max() < 0.05  # a drone at every place of the letter
    assert (tmp_path / "flight.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.zeros((2, 3)), r"shape \(2, 3\), but must contain"),
        (np.full((1, 2, 3), np.nan), "not finite"),
        (np.array([[["a", "b", "c"]]]), "array of <U1"),
        (np.array([[[0.0, 1e9, 0.0]]]), "coordinate 1e\\+09 m from the origin"),
    ],
)
def test_points_that_are_none_are_refused(points: np.ndarray, why: str, tmp_path: Path) -> None:
    np.save(tmp_path / "points.npy", points)
    with pytest.raises(ValueError, match=why):
        main(Options(points=tmp_path / "points.npy", out=tmp_path))


@pytest.mark.parametrize("content", [b"", b"0 0 1\n0 1 1\n", b"PK\x03\x04"])
def test_files_that_numpy_save_did_not_write_are_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "points.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"points\.npy is no file of numbers"):
        main(Options(points=tmp_path / "points.npy", out=tmp_path))


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"drones": 0}, "--drones is 0, but must be"),
        ({"stage_s": math.nan}, "--stage-s is nan, but must be positive"),
        ({"stage_s": -1.0}, "--stage-s is -1.0, but must be positive"),
        ({"text": "A", "drones": 3, "stage_s": 0.1}, "--stage-s is 0.1, but the paths to"),
        ({"points": Path("a.npy"), "text": "A"}, "--text is 'A', but --points names"),
        ({"points": Path("a.npy"), "drones": 3}, "--drones is 3, but --points names"),
        ({"out": Path(__file__)}, "but that is a file"),
        ({"text": " "}, "--text is ' '"),
        ({"text": "A?"}, "'?'; valid"),
    ],
)
def test_options_that_make_no_show_are_refused(wrong, why, tmp_path):
    with pytest.raises(ValueError, match=re.escape(why)):
        main(Options(**({"out": tmp_path} | wrong)))


def test_spaces_of_a_text_are_skipped() -> None:
    assert len(letters("A B", 3)) == 2


def test_points_of_a_file_are_formed(tmp_path: Path) -> None:
    points = np.zeros((2, 3, 3))
    points[0, :, 0], points[1, :, 1] = [-0.6, 0.0, 0.6], [-0.7, 0.0, 0.7]
    np.save(tmp_path / "points.npy", points)
    options = Options(points=tmp_path / "points.npy", stage_s=6.0, video=False, out=tmp_path)
    assert main(options) == 0
    flight = read_trajectory(tmp_path / "flight.npz")
    assert flight.goal.shape[1] == 3
    stands = flight.position[int(np.searchsorted(flight.time, 12.0)) - 1]
    assert np.sort(stands[:, 1]) == pytest.approx([-0.7, 0.0, 0.7], abs=0.05)
