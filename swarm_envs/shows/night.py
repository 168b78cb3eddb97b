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
from scipy.ndimage import gaussian_filter

from swarm_envs.state import FloatArray

WIDTH, HEIGHT, FPS = 960, 540, 24
"""Size of a picture, pixels, and pictures per second."""
_FIELD = math.radians(40.0)
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

    middle: FloatArray
    """(3,) what it looks at, m."""
    distance: float
    """From it, m."""

    @classmethod
    def of(cls, points: FloatArray) -> Audience:
        """A camera that sees all points (M, 3), m, from wherever it sways to."""
        low, high = points.min(axis=0), points.max(axis=0)
        middle = (low + high) / 2
        reach = float(np.hypot(*np.abs(points[:, :2] - middle[:2]).T).max())
        half = math.tan(_FIELD / 2)
        wide = reach / half
        tall = 0.5 * float(high[2]) * 1.35 * WIDTH / HEIGHT / half
        return cls(np.array([*middle[:2], 0.46 * high[2]]), max(wide, tall) * 1.08 + 0.5 * reach)

    def project(self, points: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2), x to the right and y down, and depths (N,), m, of points (N, 3)."""
        angle = _SWAY * math.sin(2 * math.pi * time / _SWAY_S)
        c, s = math.cos(angle), math.sin(angle)
        x, y, z = (points - self.middle).T
        depth = np.maximum(self.distance + c * y - s * x, 0.1)
        focal = WIDTH / 2 / math.tan(_FIELD / 2)
        across, up = c * x + s * y, z
        pixels = [WIDTH / 2 + focal * across / depth, HEIGHT / 2 - focal * up / depth]
        return np.stack(pixels, axis=-1), depth

    @property
    def horizon(self) -> float:
        """Row of pixels where the water begins."""
        focal = WIDTH / 2 / math.tan(_FIELD / 2)
        return HEIGHT / 2 + focal * float(self.middle[2]) / (1.6 * self.distance)


def _background(audience: Audience) -> npt.NDArray[np.float32]:
    """Sky with stars, and water, (H, W, 3)."""
    row = np.arange(HEIGHT)[:, None]
    share = np.clip(row / audience.horizon, 0.0, 1.0) ** 2
    image = (_SKY[0] + share * (_SKY[1] - _SKY[0]))[:, None] * np.ones((1, WIDTH, 1))
    rng = np.random.default_rng(7)
    top = int(0.85 * min(max(audience.horizon, 8), HEIGHT))
    at = rng.integers(0, top, _STARS), rng.integers(0, WIDTH, _STARS)
    image[at] += (rng.random(_STARS) ** 3 * 0.5)[:, None]
    water = row[:, 0] > audience.horizon
    depth = (row[water, 0] - audience.horizon) / max(HEIGHT - audience.horizon, 1.0)
    image[water] = (_SKY[1] * 0.55 * (1.0 - 0.75 * depth[:, None]))[:, None]
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
    audience = Audience.of(positions.reshape(-1, 3))
    sky = _background(audience)
    faded = np.zeros_like(sky)
    for k in range(count_show_frames(float(times[-1]))):
        now = k / FPS
        place, light = (_between(times, array, now) for array in (positions, colors))
        pixels, depth = audience.project(place, now)
        light = light * np.clip(audience.distance / depth, 0.3, 2.0)[:, None] ** 1.5
        faded *= math.exp(-1.0 / (FPS * _TRAIL_S))
        _stamp(faded, pixels, light)
        mirrored, _ = audience.project(place * [1.0, 1.0, -1.0], now)
        soft = _HALO * _glow(pixels, light, (2.5, 2.5))
        soft += _WATER * _HALO * _glow(mirrored, light, (3.5, 0.9))
        yield _developed(sky + faded + _enlarged(soft))


def _between(times: FloatArray, array: FloatArray, now: float) -> FloatArray:
    """An array (T, ...) at a time, linear between samples."""
    k = int(np.clip(np.searchsorted(times, now, side="right") - 1, 0, len(times) - 2))
    share = min(max((now - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)
    return np.asarray((1.0 - share) * array[k] + share * array[k + 1])


def _developed(image: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Bytes of an image of light, by a table."""
    step = np.minimum(image * (_LEVELS / _BRIGHTEST), _LEVELS - 1).astype(np.uint16)
    return _TONES[step]
