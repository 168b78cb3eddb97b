"""The camera: what it draws stands where geometry says, and what is nearer hides what is behind."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

from swarm_envs import swap_v1
from swarm_envs.state import SwarmState, hover_state
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing.camera import Camera
from swarm_envs.viewing.floor import Backdrop
from swarm_envs.viewing.lens import Lens, aim
from swarm_envs.viewing.painting import ZOOM, Overlay, Painter
from swarm_envs.viewing.record import Solid
from swarm_envs.viewing.style import drone_colors

LS = parse_team("LS")


def state_at(*position, team=LS) -> SwarmState:
    return SwarmState(*(a[0] for a in hover_state(team, np.array(position, dtype=float))))


APART = state_at((-0.4, 0.0, 1.2), (0.4, 0.0, 0.8))


@pytest.fixture
def camera():
    return Camera(LS, 320, 200)


def looking_along_y(distance: float = 1.0, zoom: int = 1) -> Lens:
    """The middle of the picture at (0, 0, 1); half its height, 50 pixels, is 1 m at 1 m."""
    x, y, z = np.eye(3)
    eye = np.array([0.0, -distance, 1.0])
    return Lens(200 * zoom, 100 * zoom, 1.0, eye=eye, right=x, up=z, forward=y)


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


@settings(max_examples=40)
@given(
    st.floats(-180, 180), st.floats(0, 80), st.floats(10, 90), st.integers(0, 2**32), st.booleans()
)
def test_a_camera_that_aims_sees_every_point_and_the_margin(azimuth, elevation, opening, seed, one):
    points = np.random.default_rng(seed).uniform(-2, 2, (1 if one else 7, 3))
    lens = aim(points, 320, 200, azimuth, elevation, opening, 0.2)
    nudges = 0.19 * np.array([lens.right, -lens.right, lens.up, -lens.up])
    assert lens.sees(points[:, None] + nudges).all()


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


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector of the body in the world, by Rodrigues' formula."""
    axis, w = quaternion[:3], quaternion[3]
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


def color_at(camera: Camera, picture: np.ndarray, point: np.ndarray) -> np.ndarray:
    column, row = np.floor(camera.lens.project(point)).astype(int)
    return picture[row, column].astype(int)


def rgb(color: str) -> np.ndarray:
    return np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])


def is_color_of(drone: int, found: np.ndarray, team=LS) -> bool:
    """Return whether it is the drone's colour, in the light or in the shade."""
    wanted = rgb(drone_colors(team)[drone])
    return any(np.abs(found - shade * wanted).max() < 5 for shade in np.linspace(0.8, 1.0, 21))


def rotors(state: SwarmState, drone: int, share: float = 1.0) -> np.ndarray:
    """The hubs of a drone (4, 3), or points on the bars to them."""
    vehicle = LS[drone]
    offset = share * vehicle.arm / np.sqrt(2.0)
    own = np.array([[x * offset, y * offset, 0.012] for x in (1, -1) for y in (1, -1)])
    return np.array([state.position[drone] + turned(state.quaternion[drone], v) for v in own])


@settings(max_examples=6)
@given(st.integers(0, 2**32))
def test_rotors_stand_where_the_attitude_says(seed):
    rng = np.random.default_rng(seed)
    state = APART.copy()
    for q in state.quaternion:  # any heading, tilted by at most 30 degrees
        yaw, tilt, way = rng.uniform(-np.pi, np.pi), rng.uniform(0, np.pi / 6), rng.uniform(0, 6.3)
        lean = np.sin(tilt / 2) * np.array([np.cos(way), np.sin(way)])
        c, s = np.cos(yaw / 2), np.sin(yaw / 2)
        q[:] = [
            *(c * lean + s * np.array([lean[1], -lean[0]])),
            *(np.cos(tilt / 2) * np.array([s, c])),
        ]
    camera = Camera(LS, 640, 480, elevation_deg=75.0)
    picture = camera.picture(state)
    for drone in (0, 1):
        for hub in rotors(state, drone):
            assert is_color_of(drone, color_at(camera, picture, hub))


def test_rotors_are_over_the_bars_or_under_them_as_they_are_turned():
    camera = Camera(LS, 640, 480, elevation_deg=75.0)
    upside_down = APART.copy()
    upside_down.quaternion[:] = [1.0, 0.0, 0.0, 0.0]
    for state, colored in ((APART, True), (upside_down, False)):
        picture = camera.picture(state)
        for point in rotors(state, 0, 0.95):
            found = color_at(camera, picture, point)
            assert is_color_of(0, found) is colored
            assert colored or found.max() < 60  # the bar


@pytest.mark.parametrize("front", [0, 1])
def test_a_nearer_drone_hides_one_behind_it(front):
    camera = Camera(LS, 640, 480, elevation_deg=60.0)
    camera.aim([[-0.5, -0.5, 0.5], [0.5, 0.5, 1.5]])
    back = 1 - front
    state = state_at((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    # The first rotors of both on one ray, that of the other drone a metre farther.
    near, far = rotors(state, front)[0], rotors(state, back)[0]
    ray = (near - camera.lens.eye) / np.linalg.norm(near - camera.lens.eye)
    state.position[back] += near + ray - far
    found = color_at(camera, camera.picture(state), near)
    assert is_color_of(front, found)
    assert not is_color_of(back, found)


def crossed(solid: Solid, a: np.ndarray, b: np.ndarray) -> tuple[bool, float]:
    """Return whether the straight way from a to b enters a solid, and by how much, m."""
    points = a + np.linspace(0.0, 1.0, 4001)[:, None] * (b - a)
    low, high = np.array(solid.low), np.array(solid.high)
    inside = np.minimum(points - low, high - points)
    if solid.round:
        center, radius = (low + high)[:2] / 2, (high - low)[0] / 2
        level = radius - np.linalg.norm(points[:, :2] - center, axis=1)
        inside = np.column_stack([level, inside[:, 2]])
    depth = inside.min(axis=1).max()
    return bool(depth > 0.0), abs(float(depth))


SOLIDS = (
    Solid(True, (-0.6, -0.1, 0.0), (-0.3, 0.2, 2.0)),
    Solid(False, (0.1, 0.2, 0.0), (0.9, 0.4, 1.3)),
    Solid(False, (0.2, -0.6, 0.9), (0.4, -0.3, 1.1)),
    Solid(True, (-0.2, 0.7, 0.0), (0.2, 1.1, 0.8)),
)


@settings(max_examples=12)
@given(st.integers(0, 2**32), st.floats(-180, 180), st.floats(0, 60))
def test_obstacles_tint_the_drones_behind_them_alone(seed, azimuth, elevation):
    place = np.random.default_rng(seed).uniform([-1, -1, 0.2], [1, 1, 1.9])
    angles: Any = {"azimuth_deg": azimuth, "elevation_deg": elevation}
    team = parse_team("S")
    plain = Camera(team, 320, 240, **angles)
    among = Camera(team, 320, 240, solids=SOLIDS, **angles)
    state = state_at(place, team=team)
    for camera in (plain, among):
        camera.aim([[-1, -1, 0.1], [1, 1, 2.0]])
    apart = [crossed(solid, place, place)[1] for solid in SOLIDS]
    ways = [crossed(solid, plain.lens.eye, place) for solid in SOLIDS]
    assume(min(apart) > 0.06)  # outside, or deep inside
    assume(not any(crossed(solid, place, place)[0] for solid in SOLIDS))
    assume(min(clear for _, clear in ways) > 0.02)
    before, after = (color_at(c, c.picture(state), place) for c in (plain, among))
    assert (np.abs(before - after).max() > 20) == any(hidden for hidden, _ in ways)


def test_a_long_wall_is_behind_what_stands_before_it_though_its_middle_is_nearer():
    eye, box = np.array([-5.0, -1.0, 1.0]), Solid(False, (3.9, 0.0, 0.0), (4.1, 0.3, 2.0))
    wall = Solid(False, (-5.0, 1.0, 0.0), (12.0, 1.1, 2.0))
    forward = np.array([9.0, 1.15, 0.0]) / np.hypot(9.0, 1.15)
    up = np.array([0.0, 0.0, 1.0])
    lens = Lens(200, 100, 0.03, eye, np.cross(forward, up), up, forward)
    place = eye + 12.0 * forward  # behind the box, before the wall
    assert place[1] < 0.6
    colors = []
    for solids in ((), (box,), (wall, box)):
        canvas = Image.new("RGB", (200, 100), "white")
        painter = Painter(lens, parse_team("S"), solids)
        painter.paint(canvas, place[None], np.array([[0.0, 0.0, 0.0, 1.0]]), Overlay())
        colors.append(canvas.getpixel((100, 50)))
    assert colors[0] != colors[1] == colors[2]


def test_the_floor_has_a_line_every_metre_and_paler_ones_between():
    lens = aim([[-1, -1, 0], [1, 1, 1]], 640, 480, -60.0, 30.0, 35.0, 0.1)
    picture = Backdrop(lens).draw(np.zeros((0, 3)), np.zeros(0))

    def brightness(*point: float) -> int:
        column, row = np.floor(lens.project([*point, 0.0])).astype(int)
        return int(picture[row, column].sum())

    between = brightness(0.37, -0.37)
    for metre in (0.0, 1.0):
        for x, y in ((0.25, -0.37), (0.37, -0.5)):
            assert brightness(metre, y) < brightness(x, y) < between
            assert brightness(x, metre) < brightness(x, y)


@pytest.mark.parametrize("height", [0.3, 1.0])
def test_a_shadow_lies_on_the_floor_right_below_its_drone(height):
    lens = aim([[-1, -1, 0], [1, 1, 1]], 640, 480, -60.0, 70.0, 35.0, 0.1)
    backdrop, foot = Backdrop(lens), np.array([0.3, -0.2, 0.0])
    bare = backdrop.draw(np.zeros((0, 3)), np.zeros(0)).astype(float).sum(axis=2)
    drone = (foot + np.array([0.0, 0.0, height]))[None]
    shaded = backdrop.draw(drone, np.array([0.1])).astype(float).sum(axis=2)
    dark = bare - shaded
    assert dark.min() >= 0.0
    rows, columns = np.nonzero(dark)
    center = np.array([(columns + 0.5) @ dark[rows, columns], (rows + 0.5) @ dark[rows, columns]])
    np.testing.assert_allclose(center / dark.sum(), lens.project(foot), atol=1.0)


def test_pictures_follow_the_state_alone(camera):
    first = camera.picture(APART)
    tilted = APART.copy()
    tilted.quaternion[0] = [0.0, np.sin(0.3), 0.0, np.cos(0.3)]
    for changed in (state_at((-0.3, 0.0, 1.2), (0.4, 0.0, 0.8)), tilted):
        assert (camera.picture(changed) != first).any(axis=2).sum() > 20
    np.testing.assert_array_equal(camera.picture(APART), first)
    np.testing.assert_array_equal(Camera(LS, 320, 200).picture(APART), first)


def test_the_camera_stands_still_until_a_drone_leaves_the_picture(camera):
    camera.picture(APART)
    eye = camera.lens.eye
    camera.picture(state_at((-0.35, 0.1, 1.2), (0.4, 0.0, 0.7)))
    assert camera.lens.eye is eye
    away = state_at((-3.0, 0.0, 1.2), (3.0, 0.0, 0.8))
    camera.picture(away)
    assert camera.lens.sees(away.position).all()


def test_the_camera_refuses_what_it_cannot_draw(camera):
    with pytest.raises(ValueError, match=r"\(1, 2, 3\).*without the leading axis"):
        camera.picture(hover_state(LS, APART.position))
    broken = APART.copy()
    broken.position[0, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        camera.picture(broken)
    with pytest.raises(ValueError, match=r"width is 0.*of at least 16 and at most 4,096"):
        Camera(LS, width=0)
    with pytest.raises(RuntimeError, match="has not aimed"):
        _ = camera.lens


FAR = np.array([[0.0, 5000.0, 1.0]])  # where a drone is less than a pixel


def painted(solids: tuple[Solid, ...] = (), **shown: np.ndarray) -> np.ndarray:
    """A white picture, 200 x 100, with what an overlay shows."""
    canvas = Image.new("RGB", (200 * ZOOM, 100 * ZOOM), "white")
    painter = Painter(looking_along_y(zoom=ZOOM), parse_team("S"), solids)
    painter.paint(canvas, FAR, np.array([[0.0, 0.0, 0.0, 1.0]]), Overlay(**shown))
    return np.asarray(canvas.reduce(ZOOM))


def inked(*solids: Solid, **shown: np.ndarray) -> tuple[float, float, float, float]:
    """First and last column, first and last row, of what was painted."""
    far = painted()
    rows, columns = np.nonzero((painted(solids, **shown) < np.minimum(far, 250)).any(axis=2))
    return columns.min(), columns.max(), rows.min(), rows.max()


def test_marks_stand_where_geometry_says_in_the_drones_colour():
    point = np.array([[1.0, 0.0, 1.4]])  # 50 pixels right of the middle, 20 above
    marks: tuple[dict[str, Any], ...] = ({"goals": point}, {"references": point})
    for mark in marks:
        left, right, top, bottom = inked(**mark)
        assert (left + right) / 2 == pytest.approx(150, abs=1.0)
        assert (top + bottom) / 2 == pytest.approx(30, abs=1.0)
        assert 8 <= right - left <= 30
        near = painted(**mark)[20:41, 140:161].reshape(-1, 3).astype(int)
        assert np.abs(near - rgb(drone_colors(parse_team("S"))[0])).max(axis=1).min() < 10


def test_a_trail_runs_from_the_oldest_point_to_the_newest():
    trail = np.array([[[-1.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]], [[0.5, 0.0, 1.0]]])
    left, right, top, bottom = inked(trails=trail)
    np.testing.assert_allclose([left, right], [50, 125], atol=1.5)
    assert bottom - top <= 3


@pytest.mark.parametrize("round_one", [True, False])
def test_an_obstacle_covers_its_outline(round_one):
    left, right, *rows = inked(Solid(round_one, (-0.5, 0.0, 0.6), (0.5, 1.0, 1.4)))
    if not round_one:  # the near face of a box is in the plane of 50 pixels a metre
        np.testing.assert_allclose([left, right], [75, 125], atol=1.5)
    np.testing.assert_allclose(rows, [30, 70], atol=4)


def test_arrows_point_and_weak_ones_are_left_out():
    foot = np.array([0.0, 0.0, 1.0])
    arrows = np.array([[foot, foot - [0.0, 0.0, 0.6]], [foot, [0.02, 0.0, 1.0]]])
    left, right, top, bottom = inked(arrows=arrows)
    np.testing.assert_allclose([top, bottom], [50, 80], atol=1.5)
    assert (left + right) / 2 == pytest.approx(100, abs=1.0)


def test_environments_draw_goals_and_trails(engine):
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


def test_every_interface_draws_the_same_picture_without_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    given: Any = {"num_drones": 2, "render_mode": "rgb_array"}
    parallel: Any = swap_v1.parallel_env(**given)
    assert parallel.physics_name == "batch"
    joint, solo = (
        gymnasium.make(f"swarm_envs/{name}-v1", **given) for name in ("Swap", "SwapSolo")
    )
    vector: Any = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=2, **given)
    rows: Any = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=2, per_agent=True, **given)
    solos: Any = gymnasium.make_vec("swarm_envs/SwapSolo-v1", num_envs=2, **given)
    pictures: dict[int, Any] = {}
    for seed in (5, 4):
        parallel.reset(seed=seed)
        pictures[seed] = parallel.render()
    assert (pictures[4] != pictures[5]).any()
    for single in (joint, solo):
        single.reset(seed=4)
        np.testing.assert_array_equal(single.render(), pictures[4])
    for envs, seeds in ((vector, [4, 5]), (rows, [4, 4, 5, 5]), (solos, [4, 5])):
        envs.reset(seed=4)
        found = envs.render()
        assert len(found) == envs.num_envs  # as Gymnasium's RecordVideo wants it
        np.testing.assert_array_equal(np.array(found), [pictures[seed] for seed in seeds])
        np.testing.assert_array_equal(found[-1:], [pictures[5]])
    for env in (parallel, joint, solo, vector, rows, solos):
        env.close()
