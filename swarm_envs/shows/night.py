"""The film of a show: coloured lights over dark water, with a glow, short trails and reflections.

Each light is a small disk that fades behind it, and a glow that is blurred on a small image. All is
NumPy and SciPy: 500 lights take about as long as 100.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, gaussian_filter1d, maximum_filter1d

from swarm_envs.shows.choreography import between
from swarm_envs.state import FloatArray

__all__ = ["FPS", "count_show_frames", "film_lights"]

WIDTH, HEIGHT, FPS = 960, 540, 24
"""Size of a picture, pixels, and pictures per second."""
_FOCAL = WIDTH / 2 / math.tan(math.radians(20.0))
_HORIZON = round(0.68 * HEIGHT)
_FOLLOW_S = 3.0
_SWAY, _SWAY_S = math.radians(14.0), 24.0
_TRAIL_S = 0.22
_CORE, _WIDTH_PX, _REACH, _WHITE = 2.2, 1.15, 3, 0.35
"""Brightness, radius and reach of a light's disk, pixels, and how white it is in the middle."""
_HALO, _WATER, _SMALL = 2.4, 0.45, 4
_LEVELS, _BRIGHTEST = 4096, 8.0
_TONES = np.asarray(
    255.0 * (1.0 - np.exp(-1.3 * np.linspace(0.0, _BRIGHTEST, _LEVELS))) ** (1 / 1.35), np.uint8
)
_SKY = np.array([[0.012, 0.020, 0.055], [0.050, 0.065, 0.130]])
_STARS = 260


@dataclass(frozen=True)
class Audience:
    """A camera that sways slowly about the middle of a show, low over the water."""

    height: float  # What it looks at, above the origin, m
    distance: float  # From there, m
    angle: float  # By which it has swayed, rad

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2), x to the right and y down, and depths (N,), m, of points (N, 3)."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y, z = points.T
        depth = np.maximum(self.distance + c * y - s * x, 0.1)
        across, up = c * x + s * y, z - self.height
        pixels = [WIDTH / 2 + _FOCAL * across / depth, HEIGHT / 2 - _FOCAL * up / depth]
        return np.stack(pixels, axis=-1), depth


def _audiences(times: FloatArray, positions: FloatArray) -> FloatArray:
    """(T, 2) height, m, and distance, m, of a camera that follows the drones (T, N, 3) slowly."""
    reach = np.hypot(positions[..., 0], positions[..., 1]).max(axis=1)
    high = positions[..., 2].max(axis=1)
    size = max(round(_FOLLOW_S / float(times[1] - times[0])), 1)
    reach, high = (
        gaussian_filter1d(maximum_filter1d(x, 2 * size, mode="nearest"), size / 2, mode="nearest")
        for x in (reach, high)
    )
    wide = (2 * _FOCAL / WIDTH) * reach
    tall = (2 * _FOCAL / HEIGHT) * 0.62 * high
    return np.column_stack([0.44 * high, 1.06 * np.maximum(wide, tall) + 0.6 * reach])


def _background() -> npt.NDArray[np.float32]:
    """Sky with stars, and water, (H, W, 3)."""
    row = np.arange(HEIGHT)[:, None]
    share = np.clip(row / _HORIZON, 0.0, 1.0) ** 2
    image = (_SKY[0] + share * (_SKY[1] - _SKY[0]))[:, None] * np.ones((1, WIDTH, 1))
    rng = np.random.default_rng(7)
    at = rng.integers(0, int(0.85 * _HORIZON), _STARS), rng.integers(0, WIDTH, _STARS)
    image[at] += (rng.random(_STARS) ** 3 * 0.5)[:, None]
    depth = (row[_HORIZON:] - _HORIZON) / (HEIGHT - _HORIZON)
    image[_HORIZON:] = (_SKY[1] * 0.55 * (1.0 - 0.75 * depth))[:, None]
    return image.astype(np.float32)


def _stamp(image: npt.NDArray[np.float32], pixels: FloatArray, light: FloatArray) -> None:
    """Draw a small bright disk for each light (N, 3) at pixels (N, 2); what is brighter stays."""
    height, width = image.shape[:2]
    edge = _REACH + 1
    inside = ((pixels >= edge) & (pixels < [width - edge, height - edge])).all(axis=1)
    middle = np.rint(pixels[inside]).astype(np.int64)
    offset = np.stack(np.meshgrid(*[np.arange(-_REACH, _REACH + 1)] * 2), axis=-1).reshape(-1, 2)
    away = np.square(middle[:, None] + offset - pixels[inside][:, None]).sum(axis=-1)
    core = _CORE * np.exp(-away / (2 * _WIDTH_PX**2))[..., None]
    lit = core * (light[inside][:, None] + _WHITE * light[inside].max(axis=1)[:, None, None])
    place = (middle[:, None, 1] + offset[:, 1]) * width + middle[:, None, 0] + offset[:, 0]
    index = (3 * place[..., None] + np.arange(3)).ravel()
    np.maximum.at(image.reshape(-1), index, lit.astype(np.float32).ravel())


def _glow(pixels: FloatArray, light: FloatArray, sigma: tuple[float, float]) -> FloatArray:
    """Light (N, 3) at pixels (N, 2), blurred, on a quarter of the pixels each way (h, w, 3)."""
    width, height = WIDTH // _SMALL, HEIGHT // _SMALL
    at = np.rint(pixels / _SMALL).astype(np.int64)
    inside = ((at >= 0) & (at < [width, height])).all(axis=1)
    place, size = at[inside, 1] * width + at[inside, 0], width * height
    image = [np.bincount(place, light[inside, k], minlength=size) for k in range(3)]
    spread = [gaussian_filter(part.reshape(height, width), sigma, truncate=3) for part in image]
    return np.stack(spread, axis=-1)


def _enlarged(image: FloatArray) -> npt.NDArray[np.float32]:
    """An image (h, w, 3) over all pixels (H, W, 3), linear between."""
    from PIL import Image

    parts = [Image.fromarray(image[..., k].astype(np.float32)) for k in range(3)]
    large = [part.resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR) for part in parts]
    return np.dstack([np.asarray(part) for part in large])


def count_show_frames(seconds: float) -> int:
    """How many frames the film of a show has."""
    return math.ceil(seconds * FPS) + 1


def film_lights(
    times: FloatArray, positions: FloatArray, colors: FloatArray
) -> Iterator[npt.NDArray[np.uint8]]:
    """Frames (540, 960, 3), 24 a second.

    Args:
        times: (T,) s, from 0.
        positions: (T, N, 3) where the lights are, m.
        colors: (T, N, 3) red, green and blue in [0, 1].
    """
    sky, views = _background(), _audiences(times, positions)
    faded = np.zeros_like(sky)
    for k in range(count_show_frames(float(times[-1]))):
        now = k / FPS
        place, light = (between(times, array, now) for array in (positions, colors))
        sway = _SWAY * math.sin(2 * math.pi * now / _SWAY_S)
        height, distance = between(times, views, now)
        audience = Audience(float(height), float(distance), sway)
        pixels, depth = audience.project(place)
        light = light * np.clip(audience.distance / depth, 0.3, 2.0)[:, None] ** 1.5
        faded *= math.exp(-1.0 / (FPS * _TRAIL_S))
        _stamp(faded, pixels, light)
        mirrored, _ = audience.project(place * [1.0, 1.0, -1.0])
        soft = _HALO * _glow(pixels, light, (2.5, 2.5))
        soft += _WATER * _HALO * _glow(mirrored, light, (3.5, 0.9))
        yield _developed(sky + faded + _enlarged(soft))


def _developed(image: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Bytes of an image of light, by a table."""
    step = np.minimum(image * (_LEVELS / _BRIGHTEST), _LEVELS - 1).astype(np.uint16)
    return _TONES[step]
