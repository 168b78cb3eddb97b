"""Shapes of formations: number of points, distances, and forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from swarm_envs.tasks.shapes import (
    CHARACTERS,
    LETTER,
    SHAPES,
    block_of,
    shape_points,
    strokes,
    written,
)

NUMBERS = [1, 2, 3, 4, 5, 8, 9, 10, 16, 27, 40, 100]


@pytest.mark.parametrize("name", [*SHAPES, "letter:A", "letter:R", "letter:8", "letter:I"])
@pytest.mark.parametrize("spacing", [0.3, 0.5])
def test_points_keep_their_distance_but_are_not_needlessly_far_apart(name, spacing):
    """Every point has another within three spacings: no shape falls apart."""
    for n in NUMBERS:
        points = shape_points(name, n, spacing)
        assert points.shape == (n, 3)
        assert np.isfinite(points).all()
        np.testing.assert_allclose(points.min(axis=0), -points.max(axis=0), atol=1e-12)
        np.testing.assert_array_equal(points, shape_points(name, n, spacing))
        if n > 1:
            apart = squareform(pdist(points)) + 9.0 * np.eye(n)
            assert apart.min() >= spacing * (1 - 1e-9)
            assert apart.min(axis=1).max() < 3 * spacing, n
            half = shape_points(name, n, spacing / 2)  # shapes only scale
            np.testing.assert_allclose(2 * half, points, atol=1e-9)


def test_plane_is_level_and_square():
    for n in NUMBERS:
        points = shape_points("plane", n, 0.5)
        assert not points[:, 2].any()
        side = np.ceil(np.sqrt(n)) - 1
        assert np.ptp(points[:, 0]) == pytest.approx(0.5 * side)


def test_pyramid_has_square_layers():
    points = shape_points("pyramid", 14, 1.0)
    heights, counts = np.unique(points[:, 2].round(9), return_counts=True)
    assert counts.tolist() == [9, 4, 1]
    np.testing.assert_allclose(heights, [-1.0, 0.0, 1.0])
    np.testing.assert_allclose(points[0], [0.0, 0.0, 1.0], atol=1e-12)


def test_cube_has_corners_first():
    points = shape_points("cube", 20, 1.0)  # of 27: all eight corners and all twelve edges
    on_faces = (np.abs(points) > 0.9).sum(axis=1)
    assert sorted(on_faces.tolist()) == [2] * 12 + [3] * 8


def test_sphere_is_round():
    points = shape_points("sphere", 40, 0.5)
    middle = np.linalg.lstsq(
        np.column_stack([2 * points, np.ones(40)]), np.square(points).sum(axis=1), rcond=None
    )[0][:3]
    radius = np.linalg.norm(points - middle, axis=1)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-9)


def test_rings_are_square_and_concentric():
    points = shape_points("rings", 64, 1.0)  # two planes of a ring of 8 and one of 24
    half = np.abs(points[:, :2]).max(axis=1).round(9)
    assert set(half.tolist()) == {1.0, 3.0}
    assert np.unique(points[:, 2]).tolist() == [-0.5, 0.5]


def test_blocks_are_apart_and_none_stands_above_another():
    points, owner = shape_points("blocks", 36, 1.0), block_of(36)
    assert np.bincount(owner).tolist() == [4] * 9
    middles = np.array([points[owner == k].mean(axis=0) for k in range(9)])
    assert len(np.unique(middles[:, :2].round(6), axis=0)) == 9
    for k in range(9):
        inside = np.linalg.norm(points[owner == k] - middles[k], axis=1).max()
        outside = np.linalg.norm(points[owner != k] - middles[k], axis=1).min()
        assert inside < outside


def distance_to_strokes(character: str, points: np.ndarray) -> np.ndarray:
    dense = [a + s * (b - a) for a, b in strokes(character) for s in np.linspace(0, 1, 200)]
    return np.linalg.norm(points[:, None] - np.array(dense)[None], axis=-1).min(axis=1)


@pytest.mark.parametrize("character", CHARACTERS)
def test_letters_cover_their_strokes(character):
    for n, off, gap in ((10, 0.02, 2.0), (20, 0.02, 1.3), (60, 0.52, 0.9)):
        points = written(character, n)
        assert len(np.unique(points, axis=0)) == n
        assert distance_to_strokes(character, points).max() < off
        on = np.array([a + s * (b - a) for a, b in strokes(character) for s in (0.0, 0.5, 1.0)])
        assert np.linalg.norm(on[:, None] - points[None], axis=-1).min(axis=1).max() < gap


def test_characters_differ():
    patterns = {np.sort(written(c, 16), axis=0).tobytes() for c in CHARACTERS}
    assert len(patterns) == len(CHARACTERS) == 36


def test_letters_lean_back_and_read_from_the_front():
    points = shape_points(LETTER + "L", 12, 0.5)
    np.testing.assert_allclose(points[:, 2], np.tan(np.pi / 6) * points[:, 1], atol=1e-12)
    foot = points[points[:, 2] < points[:, 2].min() + 1e-6]
    assert foot[:, 0].max() == pytest.approx(points[:, 0].max())  # the bar of L is below, right


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("plain", r"unknown shape 'plain'; did you mean 'plane'"),
        ("letter:!", r"unknown shape 'letter:!'"),
        ("A", r"unknown shape 'A'"),
    ],
)
def test_unknown_shapes(name, message):
    with pytest.raises(ValueError, match=message):
        shape_points(name, 4, 0.5)
