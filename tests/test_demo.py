"""The demonstration: what it writes, and that compensation holds the drone."""

from __future__ import annotations

import json
import re
import subprocess

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm import demo as module
from swarm_envs.baselines.neural_swarm.demo import SCENARIOS, VIDEO_FPS, format_table, run_demo
from swarm_envs.physics import bullet_available

SIDES = ("without", "compensated")


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "out"
    return out, run_demo(out, seed=1, swaps=2, progress=False, video_s=0.1)


def test_everything_is_written(demo):
    out, summary = demo
    assert json.loads((out / "summary.json").read_text()) == summary
    names = {"summary.json", *filter(None, summary["files"].values())}
    assert {file.name for file in out.iterdir()} == names
    assert iio.imread(out / "demo.png").shape[1] > 1000
    assert summary["engine"] == ("bullet" if bullet_available() else "batch")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", out / summary["files"]["video"]]
    raw = ["-f", "rawvideo", "-pix_fmt", "gray", "-"]
    pixels = subprocess.run([*command, *raw], capture_output=True, check=True).stdout
    assert len(pixels) == (int(0.1 * VIDEO_FPS) + 1) * 1280 * 720


def test_both_sides_fly_the_same_swaps_with_another_belief(demo):
    _, summary = demo
    assert set(summary["scenarios"]) == set(SCENARIOS)
    for entry in summary["scenarios"].values():
        seeds = [[flight["seed"] for flight in entry[side]["flights"]] for side in SIDES]
        gaps = [[flight["gap_m"] for flight in entry[side]["flights"]] for side in SIDES]
        assert seeds[0] == seeds[1]
        assert len(set(seeds[0])) == summary["swaps"] == 2
        assert gaps[0] == gaps[1]
        assert all(0.2 <= gap <= 0.3 for gap in gaps[0])
    assert summary["belief"]["sha256"] != summary["interactions"]["sha256"]
    assert not re.search(r'"/|\\\\', json.dumps(summary)), "a path of this machine"


def test_statistics_follow_from_the_flights(demo):
    _, summary = demo
    for entry in summary["scenarios"].values():
        worst = {}
        for side in SIDES:
            flights = entry[side]["flights"]
            worst[side] = np.array([flight["worst_height_error_cm"] for flight in flights])
            metric = [f["metrics"]["worst_height_error_by_drone_m"][-1] for f in flights]
            np.testing.assert_allclose(worst[side], 100 * np.array(metric), rtol=1e-9)
            assert entry[side]["worst_height_error_cm"]["median"] == pytest.approx(
                worst[side].mean()  # of two
            )
        assert entry["made_worse"] == (worst["compensated"] > worst["without"]).sum()


def test_compensation_halves_the_drop_below_a_large_drone(demo):
    _, summary = demo
    entry = summary["scenarios"]["L2S"]
    without = entry["without"]["worst_height_error_cm"]["median"]
    assert without > 10.0  # the paper: 17 cm
    assert entry["compensated"]["worst_height_error_cm"]["median"] < 0.5 * without
    assert entry["made_worse"] == 0
    for side in SIDES:
        assert all(f["metrics"]["success"] for f in entry[side]["flights"])


def test_the_table_is_aligned_and_complete(demo):
    _, summary = demo
    head, line, *rows = format_table(summary).splitlines()[2:]
    assert len({len(text) for text in (head, line, *rows)}) == 1
    assert [row.split()[0] for row in rows] == list(SCENARIOS)
    median = summary["scenarios"]["L2S"]["without"]["worst_height_error_cm"]["median"]
    assert rows[1].split()[1] == f"{median:.1f}"


def test_without_pybullet_the_twin_flies_the_same_and_the_summary_says_so(
    demo, tmp_path, monkeypatch
):
    monkeypatch.setattr(module, "default_engine", lambda: "batch")
    summary = run_demo(tmp_path, seed=1, swaps=1, progress=False, video_s=0.1)
    assert summary["engine"] == "batch"
    assert summary["files"]["video"] == "demo.mp4"
    assert len(summary["notes"]) == 1
    assert "compiled engine" in summary["notes"][0]
    for team in SCENARIOS:  # fewer swaps are the first of more
        first, same = (
            s["scenarios"][team]["without"]["flights"][0]["worst_height_error_cm"]
            for s in (demo[1], summary)
        )
        assert same == pytest.approx(first, abs=1e-6)
