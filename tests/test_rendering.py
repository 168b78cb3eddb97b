"""Pictures of environments: what stands where, what the film shows, and the window."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import load, record_episode
from swarm_envs.physics import bullet_available
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing import film as films
from swarm_envs.viewing import frames
from swarm_envs.viewing.lens import Lens
from swarm_envs.viewing.overlay import Overlay, arena_edges, draw_behind, visible_parts
from swarm_envs.viewing.palette import drone_colors, type_color
from swarm_envs.viewing.solids import Solid

needs_bullet = pytest.mark.skipif(not bullet_available(), reason="pybullet draws")
WHITE = np.full((100, 200, 3), 255, dtype=np.uint8)


def looking_along_y() -> Lens:
    """50 pixels a metre in the plane y = 0, the middle of the picture at (0, 0, 1)."""
    x, y, z = np.eye(3)
    return Lens(200, 100, 1.0, eye=np.array([0.0, -1.0, 1.0]), right=x, up=z, forward=y)


def inked(picture: np.ndarray) -> tuple[float, float, float, float]:
    """First and last column, first and last row, of what is not white."""
    rows, columns = np.nonzero((picture < 250).any(axis=2))
    return columns.min(), columns.max(), rows.min(), rows.max()


@pytest.mark.parametrize("enlarged", [True, False])
def test_marks_stand_where_geometry_says(enlarged):
    point = np.array([[1.0, 0.0, 1.4]])  # 50 pixels right of the middle, 20 above
    overlay = Overlay(colors=["#1f5fbf"], goals=point, enlarged=enlarged)
    picture = draw_behind(WHITE, looking_along_y(), overlay)
    assert picture.shape == WHITE.shape
    assert (WHITE == 255).all()
    left, right, top, bottom = inked(picture)
    assert (left + right) / 2 == pytest.approx(150, abs=1.0)
    assert (top + bottom) / 2 == pytest.approx(30, abs=1.0)
    assert 8 <= right - left <= 30


def test_a_trail_runs_from_the_oldest_point_to_the_newest():
    trail = np.array([[[-1.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]], [[0.5, 0.0, 1.0]]])
    left, right, top, bottom = inked(
        draw_behind(WHITE, looking_along_y(), Overlay(colors=["#1f5fbf"], trails=trail))
    )
    assert left == pytest.approx(50, abs=1.5)
    assert right == pytest.approx(125, abs=1.5)
    assert bottom - top <= 3


@pytest.mark.parametrize("round_one", [True, False])
def test_an_obstacle_covers_its_shadow(round_one):
    solid = Solid(round_one, (-0.5, 0.0, 0.6), (0.5, 1.0, 1.4))
    picture = draw_behind(WHITE, looking_along_y(), Overlay(colors=[], solids=[solid]))
    left, right, top, bottom = inked(picture)
    if not round_one:  # the near face of a box is in the plane of 50 pixels a metre
        np.testing.assert_allclose([left, right], [75, 125], atol=1.5)
    np.testing.assert_allclose([top, bottom], [30, 70], atol=4)
    assert (picture[50, 100] < 200).all()


def test_arrows_point_and_weak_ones_are_left_out():
    foot = np.array([0.0, 0.0, 1.0])
    arrow = np.array([[foot, foot - [0.0, 0.0, 0.6]], [foot, [0.02, 0.0, 1.0]]])
    left, right, top, bottom = inked(
        draw_behind(WHITE, looking_along_y(), Overlay(colors=[], arrows=arrow))
    )
    np.testing.assert_allclose([top, bottom], [50, 80], atol=1.5)
    assert (left + right) / 2 == pytest.approx(100, abs=1.0)


def test_edges_of_a_box_and_what_of_them_lies_before_the_camera():
    edges = arena_edges(np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 2.5]]))
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    np.testing.assert_allclose(sorted(lengths), [2.5] * 4 + [4.0] * 8)
    lens = looking_along_y()
    (part,) = visible_parts(lens, np.array([[2.0, -2.0, 0.0], [2.0, 2.0, 0.0]]))
    np.testing.assert_allclose(part, [[2.0, -0.95, 0.0], [2.0, 2.0, 0.0]])
    assert not list(visible_parts(lens, np.array([[2.0, -2.0, 0.0], [2.0, -1.5, 0.0]])))


def test_colours_tell_types_and_drones_apart():
    colors = drone_colors(parse_team("SSLS*"))
    assert len(set(colors)) == 4
    assert colors[2] == type_color("L")  # alone of its type
    assert len({type_color(token) for token in ("S", "L", "S*", "other")}) == 4


@needs_bullet
def test_environments_draw_goals_trails_and_obstacles():
    env = swap_v0.parallel_env(num_drones=2, physics="batch", render_mode="rgb_array")
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
    env = swap_v0.parallel_env(
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


@needs_bullet
def test_without_a_display_human_says_what_to_do():
    env = swap_v0.parallel_env(num_drones=1, physics="batch", render_mode="human")
    with pytest.raises(RuntimeError, match=r"no display.*use render_mode='rgb_array'"):
        env.reset(seed=0)  # matplotlib's backend is Agg in tests
    env.close()


@needs_bullet
def test_human_shows_every_decision(monkeypatch):
    """With a backend that takes what a window would; a display is not at hand in tests."""
    monkeypatch.setattr(frames, "_FILES_ONLY", set())
    shown: list[np.ndarray] = []
    show = frames.Window.show

    def note(window: frames.Window, picture: np.ndarray) -> None:
        shown.append(picture)
        show(window, picture)

    monkeypatch.setattr(frames.Window, "show", note)
    env = swap_v0.parallel_env(num_drones=1, physics="batch", render_mode="human")
    env.reset(seed=0)
    for _ in range(3):
        env.step({"drone_0": np.ones(3, np.float32)})
    assert len(shown) == 4
    assert env.render() is None
    assert (shown[0] != shown[-1]).any()
    env.close()
    env.close()
