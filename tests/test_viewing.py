"""Films, videos and plots are whole, and colours tell drones apart."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from swarm_envs import swap_v1
from swarm_envs.agents import load, record_episode
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing import video as films
from swarm_envs.viewing.comparison import (
    COMPENSATED_COLOR,
    WITHOUT_COLOR,
    Comparison,
    plot_comparisons,
)
from swarm_envs.viewing.record import FlightRecord, Solid
from swarm_envs.viewing.style import drone_colors, type_color
from swarm_envs.viewing.video import VideoError, write_video, write_video_or_gif

LS = parse_team("LS")


def read_video(path: Path, height: int, width: int) -> tuple[np.ndarray, str]:
    """Frames of a video, and what ffmpeg says about it. (imageio's reader leaves pipes open.)"""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt"]
    done = subprocess.run([*command, "rgb24", "-"], capture_output=True, check=True)
    frames = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    return frames, done.stderr.decode()


def gray_frames(count, shape=(48, 64, 3)):
    return [np.full(shape, 20 * k, dtype=np.uint8) for k in range(count)]


def test_a_video_has_every_frame_in_order(tmp_path):
    write_video(tmp_path / "a.mp4", gray_frames(10), fps=24)
    read, said = read_video(tmp_path / "a.mp4", 48, 64)
    assert len(read) == 10
    np.testing.assert_allclose(read.mean(axis=(1, 2, 3)), 20 * np.arange(10), atol=4)
    assert re.search(r"h264 .*yuv420p.* 24 fps", said)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


def test_frames_that_make_no_video_leave_no_file(tmp_path):
    uneven, mixed = gray_frames(2, (47, 64, 3)), gray_frames(2) + gray_frames(1, (48, 66, 3))
    for wrong, why in (([], "at least one"), (uneven, "even sizes"), (mixed, r"\(48, 66, 3\)")):
        with pytest.raises(ValueError, match=why):
            write_video(tmp_path / "a.mp4", wrong, fps=24)
    assert not list(tmp_path.iterdir())


def test_a_broken_ffmpeg_gives_a_gif(tmp_path, monkeypatch):
    # A program that ends at once with an error, as a broken ffmpeg does.
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: "/bin/false")
    with pytest.raises(VideoError, match="ended with code 1"):
        write_video(tmp_path / "a.mp4", gray_frames(4), fps=24)
    path = write_video_or_gif(tmp_path / "a.mp4", lambda: gray_frames(9), fps=20)
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]
    with Image.open(path) as gif:
        assert len(list(ImageSequence.Iterator(gif))) == 5
        assert (gif.size, gif.info["duration"]) == ((32, 24), 100)


def drop(depth: float, steps: int = 41) -> FlightRecord:
    """Two drones that cross at 0.5 s, the lower of which dips by `depth`, m."""
    time = np.linspace(0.0, 1.0, steps)
    along, dip = 1.0 - 2.0 * time, np.sin(np.pi * time) ** 2
    reference, force = np.zeros((2, steps, 2, 3))
    reference[..., 0], reference[..., 2] = np.stack([along, -along], axis=1), (1.2, 0.8)
    position = reference.copy()
    position[:, 1, 2] -= depth * dip
    force[:, 1, 2] = -10.0 * GRAM_FORCE * dip
    level = np.tile([0.0, 0.0, 0.0, 1.0], (steps, 2, 1))
    return FlightRecord(LS, time, position, level, reference, force)


def test_a_record_measures_the_lowest_drone():
    flight = drop(0.17)
    assert flight.worst_height_error_cm() == pytest.approx(17.0)
    assert flight.height_error_cm().min() == pytest.approx(-17.0)
    assert flight.vertical_force_g().min() == pytest.approx(-10.0)
    assert flight.worst_height_error_cm(0) == 0.0


def has_color(picture: np.ndarray, color: str) -> bool:
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return bool((np.abs(picture[..., :3].astype(int) - rgb).max(axis=-1) < 8).sum() > 200)


def test_plots_show_both_sides_and_flights_that_ended_early(tmp_path):
    file = tmp_path / "a.png"
    comparison = Comparison("LS", [drop(0.17), drop(0.15, 25)], [drop(0.02), drop(0.03)])
    assert comparison.without_cm.max() == pytest.approx(17.0, abs=0.1)
    plot_comparisons(file, [comparison, comparison], "Headline")
    picture = iio.imread(file)
    assert has_color(picture, WITHOUT_COLOR)
    assert has_color(picture, COMPENSATED_COLOR)
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(ValueError, match="at least one"):
        plot_comparisons(Path("a.png"), [], "Headline")


def test_colours_tell_types_and_drones_apart():
    colors = drone_colors(parse_team("SSLS*"))
    assert len(set(colors)) == 4
    assert colors[2] == type_color("L")  # alone of its type
    assert len({type_color(token) for token in ("S", "L", "S*", "other")}) == 4


def test_a_film_shows_the_whole_flight(monkeypatch):
    monkeypatch.setattr(films, "FPS", 4)
    agent = load("tracking")
    env = swap_v1.parallel_env(
        team="LS", layout="stacked", physics="batch", horizon_s=1.0, **agent.requires
    )
    recording = record_episode(env, agent, seed=0)
    env.close()
    column = Solid(True, (-0.2, -0.2, 0.0), (0.2, 0.2, 2.0))
    recording = replace(recording, about=replace(recording.about, solids=(column,)))
    pictures = list(films.film(recording))
    assert len(pictures) == films.count_frames(recording) == 9
    assert {p.shape for p in pictures} == {(films.HEIGHT, films.WIDTH, 3)}
    moving = [(a != b).any() for a, b in pairwise(pictures)]
    assert moving == [True] * 4 + [False] * 4  # then the last one stands
