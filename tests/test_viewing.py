"""Pictures: what they draw stands where geometry says; films, videos and plots are whole."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageSequence

from swarm_envs import swap_v1
from swarm_envs.agents import load, record_episode
from swarm_envs.physics import bullet_available
from swarm_envs.state import SwarmState, hover_state
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing import video as films
from swarm_envs.viewing.camera import Camera, Lens, aim
from swarm_envs.viewing.comparison import (
    COMPENSATED_COLOR,
    WITHOUT_COLOR,
    Comparison,
    plot_comparisons,
)
from swarm_envs.viewing.overlay import Overlay, draw_behind
from swarm_envs.viewing.record import FlightRecord, Solid
from swarm_envs.viewing.style import drone_colors, type_color
from swarm_envs.viewing.video import VideoError, write_video, write_video_or_gif

needs_bullet = pytest.mark.skipif(not bullet_available(), reason="pybullet draws")


LS = parse_team("LS")


def state_at(*position) -> SwarmState:
    return SwarmState(*(a[0] for a in hover_state(LS, np.array(position, dtype=float))))


APART = state_at((-0.4, 0.0, 1.2), (0.4, 0.0, 0.8))


@pytest.fixture
def camera():
    with_client = Camera(LS, 320, 200)
    yield with_client
    with_client.close()


def looking_along_y(distance: float = 1.0) -> Lens:
    """The middle of the picture at (0, 0, 1); half its height, 50 pixels, is 1 m at 1 m."""
    x, y, z = np.eye(3)
    return Lens(200, 100, 1.0, eye=np.array([0.0, -distance, 1.0]), right=x, up=z, forward=y)


def test_a_pinhole_projects_by_similar_triangles():
    # At 2 m half the picture's height, 50 pixels, is 2 m: 25 pixels a metre.
    lens = looking_along_y(2.0)
    points = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 2.0, 1.0]]
    np.testing.assert_allclose(
        lens.project(points), [[100.0, 50.0], [125.0, 50.0], [100.0, 25.0], [112.5, 50.0]]
    )
    behind, beside = [0.0, -3.0, 1.0], [9.0, 0.0, 1.0]
    assert lens.sees([points[0], behind, beside]).tolist() == [True, False, False]


def test_rays_lead_back_to_their_pixels():
    lens = looking_along_y(2.0)
    pixels = np.stack(np.meshgrid(np.arange(200) + 0.5, np.arange(100) + 0.5), axis=-1)
    np.testing.assert_allclose(lens.project(lens.eye + 3.0 * lens.rays()), pixels)


@given(
    st.floats(-180, 180), st.floats(0, 80), st.floats(10, 90), st.integers(0, 2**32), st.booleans()
)
def test_a_camera_that_aims_sees_every_point_and_the_margin(azimuth, elevation, opening, seed, one):
    points = np.random.default_rng(seed).uniform(-2, 2, (1 if one else 7, 3))
    lens = aim(points, 320, 200, azimuth, elevation, opening, 0.2)
    nudges = 0.19 * np.array([lens.right, -lens.right, lens.up, -lens.up])
    assert lens.sees(points[:, None] + nudges).all()


@needs_bullet
def test_drones_are_drawn_where_they_are(camera):
    picture = camera.picture(APART).astype(int)
    assert picture.shape == (200, 320, 3)
    red, blue = picture[..., 0], picture[..., 2]
    for drone, mask in enumerate([red - blue > 60, blue - red > 60]):  # L is orange, S is blue
        rows, columns = np.nonzero(mask)
        assert len(rows) > 20
        column, row = camera.lens.project(APART.position[drone])
        assert abs(columns.mean() - column) < 2.0
        assert abs(rows.mean() - row) < 3.0


@needs_bullet
def test_pictures_follow_the_state_alone(camera):
    first = camera.picture(APART)
    tilted = APART.copy()
    tilted.quaternion[0] = [0.0, np.sin(0.3), 0.0, np.cos(0.3)]
    for changed in (state_at((-0.3, 0.0, 1.2), (0.4, 0.0, 0.8)), tilted):
        assert (camera.picture(changed) != first).any(axis=2).sum() > 20
    np.testing.assert_array_equal(camera.picture(APART), first)


@needs_bullet
def test_the_camera_stands_still_until_a_drone_leaves_the_picture(camera):
    camera.picture(APART)
    eye = camera.lens.eye
    camera.picture(state_at((-0.35, 0.1, 1.2), (0.4, 0.0, 0.7)))
    assert camera.lens.eye is eye
    away = state_at((-3.0, 0.0, 1.2), (3.0, 0.0, 0.8))
    camera.picture(away)
    assert camera.lens.sees(away.position).all()


@needs_bullet
def test_the_camera_refuses_what_it_cannot_draw(camera):
    with pytest.raises(ValueError, match=r"\(1, 2, 3\).*without the leading axis"):
        camera.picture(hover_state(LS, APART.position))
    broken = APART.copy()
    broken.position[0, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        camera.picture(broken)
    camera.close()
    camera.close()
    with pytest.raises(RuntimeError, match="closed"):
        camera.picture(APART)
    with pytest.raises(ValueError, match=r"width is 0.*of at least 16 and at most 4,096"):
        Camera(LS, width=0)


def test_without_pybullet_the_camera_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    message = r"pip install pybullet.* look at the replay page, .* `swarm-envs fly --replay"
    with pytest.raises(ImportError, match=message):
        Camera(LS)


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


WHITE = np.full((100, 200, 3), 255, dtype=np.uint8)


def inked(**shown) -> tuple[float, float, float, float]:
    """First and last column, first and last row, that an overlay inks on a white picture."""
    overlay = Overlay(**{"colors": [], **shown})
    picture = draw_behind(WHITE, looking_along_y(), overlay)
    assert picture.shape == WHITE.shape
    assert (WHITE == 255).all()
    rows, columns = np.nonzero((picture < 250).any(axis=2))
    return columns.min(), columns.max(), rows.min(), rows.max()


@pytest.mark.parametrize("enlarged", [True, False])
def test_marks_stand_where_geometry_says(enlarged):
    point = np.array([[1.0, 0.0, 1.4]])  # 50 pixels right of the middle, 20 above
    left, right, top, bottom = inked(colors=["#1f5fbf"], goals=point, enlarged=enlarged)
    assert (left + right) / 2 == pytest.approx(150, abs=1.0)
    assert (top + bottom) / 2 == pytest.approx(30, abs=1.0)
    assert 8 <= right - left <= 30


def test_a_trail_runs_from_the_oldest_point_to_the_newest():
    trail = np.array([[[-1.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]], [[0.5, 0.0, 1.0]]])
    left, right, top, bottom = inked(colors=["#1f5fbf"], trails=trail)
    np.testing.assert_allclose([left, right], [50, 125], atol=1.5)
    assert bottom - top <= 3


@pytest.mark.parametrize("round_one", [True, False])
def test_an_obstacle_covers_its_shadow(round_one):
    left, right, *rows = inked(solids=[Solid(round_one, (-0.5, 0.0, 0.6), (0.5, 1.0, 1.4))])
    if not round_one:  # the near face of a box is in the plane of 50 pixels a metre
        np.testing.assert_allclose([left, right], [75, 125], atol=1.5)
    np.testing.assert_allclose(rows, [30, 70], atol=4)


def test_arrows_point_and_weak_ones_are_left_out():
    foot = np.array([0.0, 0.0, 1.0])
    arrows = np.array([[foot, foot - [0.0, 0.0, 0.6]], [foot, [0.02, 0.0, 1.0]]])
    left, right, top, bottom = inked(arrows=arrows)
    np.testing.assert_allclose([top, bottom], [50, 80], atol=1.5)
    assert (left + right) / 2 == pytest.approx(100, abs=1.0)


def test_colours_tell_types_and_drones_apart():
    colors = drone_colors(parse_team("SSLS*"))
    assert len(set(colors)) == 4
    assert colors[2] == type_color("L")  # alone of its type
    assert len({type_color(token) for token in ("S", "L", "S*", "other")}) == 4


@needs_bullet
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_environments_draw_goals_trails_and_obstacles(engine):
    env = swap_v1.parallel_env(num_drones=2, physics=engine, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first is not None
    assert first.shape == (480, 640, 3)
    np.testing.assert_array_equal(env.render(), first)
    for _ in range(10):
        env.step({agent: np.array([0.5, 0.5, 0.0], np.float32) for agent in env.agents})
        later = env.render()
    assert later is not None
    assert (later != first).any(axis=2).sum() > 100
    env.reset(seed=0)  # nothing of the last episode is left
    np.testing.assert_array_equal(env.render(), first)
    env.close()


@needs_bullet
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
