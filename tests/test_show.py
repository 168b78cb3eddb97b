"""Shows: shapes, spacing at any time, limits, the flight in the hall, the film and the exports."""

from __future__ import annotations

import base64
import json
import math
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.shows.choreography import Choreography, least_distance
from swarm_envs.shows.drawing import path_lines, read_drawing
from swarm_envs.shows.flying import fly_show
from swarm_envs.shows.formations import NAMES, Formation, Room, formation_of, formations_of, spelled
from swarm_envs.shows.night import film_lights
from swarm_envs.shows.planning import Show, plan_show
from swarm_envs.shows.skybrush import TAKEOFF_S, light_program, trajectory_points, write_skyc
from swarm_envs.shows.transitions import Pace, assigned, labelled

ROOM, PACE = Room(), Pace()
SVG = '<svg xmlns="http://www.w3.org/2000/svg">{}</svg>'


def scaled_distances(points: np.ndarray, factor: float = ROOM.height_factor) -> np.ndarray:
    """Distances (..., N, N) with heights divided by a factor; infinite on the diagonal."""
    scaled = points / [1.0, 1.0, factor]
    apart = np.linalg.norm(scaled[..., :, None, :] - scaled[..., None, :, :], axis=-1)
    return np.asarray(apart + np.diag(np.full(points.shape[-2], np.inf)))


def densely(paths: Choreography, rate: float = 200.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions by the Bernstein polynomials, independent of the package's."""
    times = np.arange(0.0, paths.duration_s, 1.0 / rate)
    rows = []
    for t in times:
        k = next(i for i, (a, b) in enumerate(pairwise(paths.knots)) if a <= t < b)
        u = (t - paths.knots[k]) / (paths.knots[k + 1] - paths.knots[k])
        weights = [math.comb(3, j) * u**j * (1 - u) ** (3 - j) for j in range(4)]
        rows.append(sum(w * p for w, p in zip(weights, paths.points[k], strict=True)))
    return times, np.array(rows)


@pytest.fixture(scope="module")
def show() -> Show:
    formations = formations_of(("text:AB", "sphere"), 24, ("red:gold", "rainbow"), ROOM)
    return plan_show(formations, ROOM, PACE, hold_s=0.5)


@pytest.mark.parametrize("name", [*NAMES, "text:HI", "letter:A"])
def test_every_shape_has_places_as_far_apart_as_asked_and_no_farther(name: str) -> None:
    places = formation_of(name, 40, "gold", ROOM).places
    assert places.shape == (40, 3)
    assert scaled_distances(places).min() == pytest.approx(ROOM.apart)
    assert places[:, 2].min() == pytest.approx(ROOM.floor)


def test_letters_are_spelled_and_a_word_is_one_shape() -> None:
    assert spelled(("heart", "letters:ab")) == ("heart", "letter:A", "letter:B")
    one, two = (
        np.ptp(formation_of(f"text:{w}", 40, None, ROOM).places, axis=0) for w in ("I", "III")
    )
    assert two[0] / two[2] > 2 * one[0] / one[2]


def test_flat_shapes_lean_back() -> None:
    places = formation_of("star", 30, None, ROOM).places
    slope = np.polyfit(places[:, 2], places[:, 1], 1)[0]
    assert math.degrees(math.atan(slope)) == pytest.approx(ROOM.lean_deg)


def test_a_path_of_every_command_is_drawn_as_its_curves_are() -> None:
    lines = path_lines("M0,0 L1,0 h1 V1 l-1 1 C1,3 0,3 0,2 s-1-1 0 0 Q1 2 1 1 t0-1 z m5 5 h1")
    assert len(lines) == 2
    assert lines[0][-1].tolist() == [0.0, 0.0]
    assert lines[1].tolist() == [[5.0, 5.0], [6.0, 5.0]]
    cubic = lines[0][5:29]  # of (1, 2), (1, 3), (0, 3), (0, 2)
    assert cubic[11] == pytest.approx([0.5, 2.75])
    (half,) = path_lines("M0 0 A1 1 0 0 1 2 0")
    assert np.linalg.norm(half[1:] - [1.0, 0.0], axis=1) == pytest.approx(1.0)
    assert half[12] == pytest.approx([1.0, -1.0])  # y grows downwards: above


def test_a_drawing_has_points_where_it_is_painted_in_its_colours(tmp_path: Path) -> None:
    body = (
        '<g transform="translate(10 0) scale(2)"><circle r="1" fill="#ff0000"/></g>'
        '<polygon points="0,0 4,0 4,4 0,4" style="fill: rgb(0, 0, 255)"/>'
        '<path d="M0 8 L4 8" fill="none" stroke="lime"/>'
    )
    (tmp_path / "a.svg").write_text(SVG.format(body))
    points, colors = read_drawing(tmp_path / "a.svg")
    red, blue, green = (colors[:, k] == 1.0 for k in (0, 2, 1))
    assert np.linalg.norm(points[red] - [10.0, 0.0], axis=1).max() <= 2.0
    assert red.sum() / blue.sum() == pytest.approx(math.pi * 4 / 16, rel=0.1)
    assert points[green][:, 1] == pytest.approx(-8.0)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('<!DOCTYPE svg [<!ENTITY a "b">]>' + SVG.format("&a;"), "DOCTYPE"),
        (SVG.format("<text>no</text>"), "draws nothing"),
        ("<svg", "no SVG"),
        (SVG.format('<path d="M 0 0 L 1"/>'), "lacks numbers"),
    ],
)
def test_drawings_that_cannot_be_shown_are_refused(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "a.svg").write_text(text)
    with pytest.raises(ValueError, match=why):
        read_drawing(tmp_path / "a.svg")


def test_a_cloud_keeps_its_order_and_colours_and_nothing_is_unpickled(tmp_path: Path) -> None:
    cloud = np.array([[0, 0, 0, 255, 0, 0], [1, 0, 0, 0, 255, 0], [0, 2, 0, 0, 0, 255.0]])
    np.savetxt(tmp_path / "c.csv", cloud, delimiter=",", header="x,y,z,r,g,b", comments="")
    found = formation_of(str(tmp_path / "c.csv"), 3, None, ROOM)
    assert (found.places - found.places[0])[1:, :2] / ROOM.apart == pytest.approx(cloud[1:, :2])
    assert found.colors.tolist() == np.eye(3).tolist()
    np.save(tmp_path / "p.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="no table of numbers"):
        formation_of(str(tmp_path / "p.npy"), 1, None, ROOM)


def test_the_checked_distance_is_a_tight_bound_of_the_true_one() -> None:
    rng = np.random.default_rng(0)
    paths = Choreography(np.array([0.0, 0.7, 2.0]), rng.uniform(-1, 1, (2, 4, 6, 3)))
    true = scaled_distances(densely(paths, 2000.0)[1]).min()
    found = least_distance(paths, ROOM.scaling)
    assert true - 2e-3 <= found <= true


@pytest.mark.parametrize("drones", [2, 30, 60])
def test_assigned_paths_keep_spacing_and_limits_and_are_hardly_slower_than_one_drone(
    drones: int,
) -> None:
    names = ("cube", "heart", "helix")
    formations = [formation_of(name, drones, None, ROOM) for name in names]
    for first, second in pairwise(formations):
        way = assigned(first.places, second.places, ROOM, PACE)
        times, places = densely(way.paths)
        assert scaled_distances(places).min() >= ROOM.spacing
        step = times[1] - times[0]
        assert np.linalg.norm(np.diff(places, axis=0), axis=-1).max() <= PACE.speed * step * 1.001
        pull = np.linalg.norm(np.diff(places, n=2, axis=0), axis=-1).max() / step**2
        assert pull <= PACE.acceleration * 1.01
        reached = np.sort(way.paths.points[-1, -1], axis=0)
        assert reached == pytest.approx(np.sort(second.places, axis=0))
        longest = np.linalg.norm(places[-1] - places[0], axis=1).max()
        assert way.paths.duration_s <= 1.2 * PACE.alone_s(longest)


def test_labelled_paths_take_each_drone_to_its_own_place() -> None:
    places, heart = (formation_of(name, 30, None, ROOM).places for name in ("sphere", "heart"))
    goal = heart[np.random.default_rng(1).permutation(30)]
    way = labelled(places, goal, ROOM, PACE, seed=0)
    assert way.paths.points[0, 0].tolist() == places.tolist()
    assert way.paths.points[-1, -1].tolist() == goal.tolist()
    assert scaled_distances(densely(way.paths)[1]).min() >= ROOM.spacing
    assert way.paths.duration_s <= 1.6 * way.alone_s


def test_a_labelled_show_brings_every_drone_home() -> None:
    formations = formations_of(("letter:C",), 9, None, ROOM)
    found = plan_show(formations, ROOM, PACE, labels=True)
    first, last = found.paths.reference(0.0), found.paths.reference(found.paths.duration_s)
    assert last.position == pytest.approx(first.position, abs=1e-12)
    middle = found.paths.reference(found.cues[0][1]).position
    assert middle == pytest.approx(formations[1].places)


def test_a_show_flies_in_the_hall_without_a_contact(show: Show) -> None:
    flight, facts = fly_show(show.paths, "hall", seed=3)
    assert facts["contacts"] == 0
    assert facts["clearance_m"] >= 0.05
    diameter = flight.team[0].diameter
    apart = scaled_distances(flight.position, 1.0).min() - diameter
    assert facts["clearance_m"] <= apart
    assert flight.time[-1] == pytest.approx(show.paths.duration_s, abs=0.05)


def test_lights_shine_where_drones_are_and_have_the_colours_of_the_shape(show: Show) -> None:
    times = np.linspace(0.0, show.paths.duration_s, 400)
    colors = show.colors(times)
    shown = next(film_lights(times, show.paths.positions(times), colors))
    assert shown.shape == (540, 960, 3)
    dark = next(film_lights(times, show.paths.positions(times), 0.0 * colors))
    lit = np.argwhere(shown.max(axis=-1) > dark.max(axis=-1) + 60)
    assert 24 <= len(lit) < 4000
    assert lit[:, 0].min() > 540 / 2  # all are near the ground at first
    there = show.colors(np.array([show.cues[0][1]]))[0]
    assert (there[:, 0] == 1.0).all()
    assert (there[:, 2] == 0.0).all()


def test_a_skybrush_show_says_the_same_paths_and_lights(show: Show, tmp_path: Path) -> None:
    write_skyc(tmp_path / "a.skyc", show, "test")
    with zipfile.ZipFile(tmp_path / "a.skyc") as archive:
        content = json.loads(archive.read("show.json"))
    assert content["version"] == 1
    drone = content["swarm"]["drones"][5]["settings"]
    points = drone["trajectory"]["points"]
    assert points == trajectory_points(show, 5)
    assert points[0][1][2] == points[-1][1][2] == 0.0
    times = [row[0] for row in points]
    assert min(np.diff(times)) > 0.0
    assert all(len(row[2]) in (0, 2) for row in points)
    for t in np.linspace(0.0, show.paths.duration_s - 0.01, 50):
        k = int(np.searchsorted(times, t + TAKEOFF_S, side="right"))
        u = (t + TAKEOFF_S - times[k - 1]) / (times[k] - times[k - 1])
        control = [points[k - 1][1], *(points[k][2] or [points[k - 1][1]] * 2), points[k][1]]
        weights = [math.comb(3, j) * u**j * (1 - u) ** (3 - j) for j in range(4)]
        there = sum(w * np.array(p) for w, p in zip(weights, control, strict=True))
        assert there == pytest.approx(show.paths.reference(float(t)).position[5], abs=3e-3)
    assert base64.b64decode(drone["lights"]["data"]) == light_program(show, 5)


def test_a_light_program_fades_to_each_colour_in_time(show: Show) -> None:
    code, now, seen, k = light_program(show, 2), 0, [], 0
    while code[k]:
        assert code[k] in (4, 8)
        color, k, shift, ticks = list(code[k + 1 : k + 4]), k + 4, 0, 0
        while True:
            ticks |= (code[k] & 127) << shift
            shift, k = shift + 7, k + 1
            if code[k - 1] < 128:
                break
        now += ticks
        seen.append((now / 50.0, color))
    assert k == len(code) - 1
    for (time, color), at, lit in zip(
        seen[1:], show.light_times, show.light_colors[:, 2], strict=True
    ):
        assert time == pytest.approx(at + TAKEOFF_S, abs=0.011)
        assert color == np.rint(255 * lit).tolist()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--shapes", "hart"], "did you mean 'heart'"),
        (["--shapes", "none.svg"], "there is no file 'none.svg'"),
        (["--shapes", "heart", "--largest-m", "3"], "a spacing of at most"),
        (["--shapes", "heart", "--colors", "glod"], "glod"),
        (["--shapes", "text:#"], "character"),
        (["--no-fly", "--trajectory", "a.npz"], "leave out --no-fly"),
    ],
)
def test_shows_that_cannot_be_are_refused_with_a_fix(
    arguments: list[str], why: str, refused: Callable[..., str]
) -> None:
    assert why in refused("show", *arguments)


def test_a_cloud_with_too_few_points_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "c.npy", np.eye(3))
    with pytest.raises(ValueError, match="use at most 3 drones"):
        formation_of(str(tmp_path / "c.npy"), 4, None, ROOM)
    np.save(tmp_path / "d.npy", np.zeros((3, 3)))
    with pytest.raises(ValueError, match="two points in one place"):
        formation_of(str(tmp_path / "d.npy"), 3, None, ROOM)


def test_starts_that_are_too_close_are_refused() -> None:
    near = Formation("near", np.array([[0, 0, 1.0], [0.2, 0, 1.0]]), np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"within 0\.2"):
        plan_show([near, formation_of("star", 2, None, ROOM)], ROOM, PACE)


def test_the_command_writes_everything(tmp_path: Path) -> None:
    out = ["--out", str(tmp_path / "s"), "--video", str(tmp_path / "s" / "a.gif")]
    shapes = ["--shapes", "star", "--drones", "6", "--hold-s", "0.2", "--no-fly"]
    assert main(["show", *shapes, *out]) == 0
    facts = json.loads((tmp_path / "s" / "show.json").read_text())
    assert facts["least_distance_m"] >= facts["spacing_m"]
    assert {"show.json", "show.skyc", "a.gif"} <= {p.name for p in (tmp_path / "s").iterdir()}
