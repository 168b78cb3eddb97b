"""Drawings: the filled areas and lines of an SVG file as points with colours.

Elements `path`, `polygon`, `polyline`, `line`, `rect`, `circle` and `ellipse` are read, with the
transforms of their groups, `fill` and `stroke`. A file with a DOCTYPE is refused, so that no entity
is expanded and nothing outside is read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from swarm_envs.state import FloatArray

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_TOKEN = re.compile(r"([MmLlHhVvCcSsQqTtAaZz])|(" + _NUMBER.pattern + ")")
_LENGTH = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_CURVE = np.linspace(0.0, 1.0, 25)[1:]
_GRID, _LARGEST = 150, 10_000_000
Lines = list[FloatArray]  # Polygons or open lines, each (K, 2)


def read_drawing(path: Path) -> tuple[FloatArray, FloatArray]:
    """Points (M, 2), y up, and their colours (M, 3) of a drawing.

    Raises:
        ValueError: it is no SVG file, has a DOCTYPE or an entity, or draws nothing.
        OSError: it cannot be read.
    """
    if path.stat().st_size > _LARGEST:
        raise ValueError(f"{path} has more than {_LARGEST} bytes; simplify the drawing")
    text = path.read_text(encoding="utf-8", errors="replace")
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ValueError(f"{path} has a DOCTYPE or an entity; remove that line from the file")
    try:
        root = ElementTree.fromstring(text)
        parts = list(_elements(root, np.eye(3), {"fill": "black", "stroke": "none"}))
    except (ElementTree.ParseError, KeyError, IndexError, ValueError) as error:
        raise ValueError(f"{path} is no SVG file that can be read: {error}") from error
    found = _painted(parts) if parts else []
    if not found:
        raise ValueError(f"{path} draws nothing: it has no path, polygon, rect or circle in sight")
    points = np.concatenate([p for p, _ in found]) * [1.0, -1.0]
    colors = np.concatenate([np.broadcast_to(c, (len(p), 3)) for p, c in found])
    return points, colors


Style = dict[str, str]  # Properties of a shape by name, as its attributes and those around it say
_Paint = tuple[float, float, float]


def _elements(
    node: ElementTree.Element, frame: FloatArray, style: Style
) -> Iterator[tuple[Lines, Style]]:
    """Lines and style of each element below one, in the frame of the file."""
    tag = node.tag.rpartition("}")[2]
    if tag in ("defs", "clipPath", "mask", "symbol", "pattern", "marker"):
        return
    given = dict(re.findall(r"([\w-]+)\s*:\s*([^;]+)", node.get("style", "")))
    style = style | {k: given.get(k, node.get(k, style[k])).strip() for k in ("fill", "stroke")}
    frame = frame @ _transform(node.get("transform", ""))
    lines = _lines(tag, node)
    if lines:
        yield [line @ frame[:2, :2].T + frame[:2, 2] for line in lines], style
    for child in node:
        yield from _elements(child, frame, style)


def _transform(text: str) -> FloatArray:
    """The matrix (3, 3) of a `transform`."""
    whole = np.eye(3)
    for name, inside in re.findall(r"(\w+)\s*\(([^)]*)\)", text):
        v = [float(x) for x in _NUMBER.findall(inside)]
        m = np.eye(3)
        if name == "matrix":
            m[:2] = np.array(v).reshape(3, 2).T
        elif name == "translate":
            m[:2, 2] = v[0], v[1] if len(v) > 1 else 0.0
        elif name == "scale":
            m[0, 0], m[1, 1] = v[0], v[-1]
        elif name == "rotate":
            c, s = math.cos(math.radians(v[0])), math.sin(math.radians(v[0]))
            m[:2, :2] = [[c, -s], [s, c]]
            at = np.array(v[1:3] or [0.0, 0.0])
            m[:2, 2] = at - m[:2, :2] @ at
        else:
            raise ValueError(f"transform {name!r}; flatten it in the drawing program")
        whole = whole @ m
    return whole


def _lines(tag: str, node: ElementTree.Element) -> Lines:
    """The lines of an element; none if it draws nothing."""

    def value(name: str, otherwise: str = "0") -> float:
        return float(_NUMBER.findall(node.get(name, otherwise))[0])

    if tag == "path":
        return path_lines(node.get("d", ""))
    if tag in ("polygon", "polyline"):
        flat = [float(x) for x in _NUMBER.findall(node.get("points", ""))]
        points = np.array(flat).reshape(-1, 2)
        return [np.concatenate([points, points[:1]]) if tag == "polygon" else points]
    if tag == "line":
        return [np.array([[value("x1"), value("y1")], [value("x2"), value("y2")]])]
    if tag == "rect":
        x, y, w, h = (value(name) for name in ("x", "y", "width", "height"))
        return [np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h], [x, y]])]
    if tag in ("circle", "ellipse"):
        rx, ry = (value("r"),) * 2 if tag == "circle" else (value("rx"), value("ry"))
        turn = np.linspace(0.0, 2 * np.pi, 73)
        around = np.column_stack([rx * np.cos(turn), ry * np.sin(turn)])
        return [around + np.array([value("cx"), value("cy")])]
    return []


def path_lines(text: str) -> Lines:
    """The lines of a path's `d`: every command of SVG 1.1, curves in 24 pieces.

    Raises:
        ValueError: a command lacks numbers, or the path begins with none.
    """
    lines: Lines = []
    here, first = np.zeros(2), np.zeros(2)
    before, handle = "", np.zeros(2)
    for command, v in _commands(text):
        kind = command.upper()
        at = here if command.islower() else np.zeros(2)
        if kind == "M":
            here = first = at + v
            lines.append(here[None])
        else:
            smooth = 2 * here - handle if before in _FAMILY.get(kind, "") else here
            piece, handle = _piece(kind, here, first, at, v, smooth)
            lines[-1] = np.concatenate([lines[-1], piece])
            here = piece[-1]
        before = kind
    return [line for line in lines if len(line) > 1]


_FAMILY = {"S": "CS", "T": "QT"}


def _commands(text: str) -> Iterator[tuple[str, FloatArray]]:
    """Each command with its numbers, repeated commands spelled out."""
    tokens = [match.groups() for match in _TOKEN.finditer(text)]
    k = 0
    while k < len(tokens):
        command, number = tokens[k]
        if number is not None:
            raise ValueError(f"a path has the number {number} where a command must be")
        k, begun = k + 1, False
        size = _LENGTH[command.upper()]
        while not begun or (size and k < len(tokens) and tokens[k][0] is None):
            values = [number for _, number in tokens[k : k + size]]
            if len(values) < size or None in values:
                raise ValueError(f"command {command!r} of a path lacks numbers")
            yield command, np.array([float(x) for x in values])
            k, begun = k + size, True
            command = {"M": "L", "m": "l"}.get(command, command)


def _piece(
    kind: str,
    here: FloatArray,
    first: FloatArray,
    at: FloatArray,
    v: FloatArray,
    smooth: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Points (K, 2) that a command adds, and its last handle."""
    if kind == "Z":
        return first[None], first
    if kind == "H":
        return np.array([[at[0] + v[0], here[1]]]), here
    if kind == "V":
        return np.array([[here[0], at[1] + v[0]]]), here
    if kind == "L":
        return (at + v)[None], here
    if kind == "A":
        return _arc(here, v[0], v[1], math.radians(v[2]), v[3] > 0, v[4] > 0, at + v[5:]), here
    pairs = at + v.reshape(-1, 2)
    control = np.stack([here, *([smooth] if kind in _FAMILY else []), *pairs])
    weights = np.stack([_bernstein(len(control) - 1, k) for k in range(len(control))], axis=1)
    return weights @ control, control[-2]


def _bernstein(degree: int, k: int) -> FloatArray:
    return np.asarray(math.comb(degree, k) * _CURVE**k * (1.0 - _CURVE) ** (degree - k))


def _arc(
    a: FloatArray, rx: float, ry: float, turn: float, large: bool, sweep: bool, b: FloatArray
) -> FloatArray:
    """Points of an elliptic arc from a to b (SVG 1.1, F.6.5)."""
    if rx == 0.0 or ry == 0.0 or np.allclose(a, b):
        return b[None]
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    radii = np.abs([rx, ry])
    half = rotation.T @ (a - b) / 2 / radii
    size = float(half @ half)
    radii = radii * max(1.0, math.sqrt(size))
    middle = math.sqrt(max(1.0 / size - 1.0, 0.0)) * np.array([half[1], -half[0]])
    half = half / max(1.0, math.sqrt(size))
    middle = middle * (-1.0 if large == sweep else 1.0)
    begin, end = (math.atan2(*(side - middle)[::-1]) for side in (half, -half))
    way = (end - begin) % (2 * math.pi) if sweep else -((begin - end) % (2 * math.pi))
    angle = begin + way * _CURVE
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    points = (unit + middle) * radii @ rotation.T + (a + b) / 2
    points[-1] = b
    return points


def _color(text: str) -> _Paint | None:
    """Red, green and blue of a paint; None for none, white for what is no plain colour."""
    from matplotlib.colors import to_rgb

    if text in ("none", "transparent"):
        return None
    try:
        numbers = [float(x) / 255.0 for x in _NUMBER.findall(text)[:3]]
        red, green, blue = numbers if text.startswith("rgb") else to_rgb(text)
        return red, green, blue
    except ValueError:
        return 1.0, 1.0, 1.0


def _painted(
    parts: list[tuple[Lines, Style]],
) -> list[tuple[FloatArray, _Paint]]:
    """Points on what is filled or stroked, with colours; what is painted later covers."""
    from matplotlib.path import Path as Polygon

    every = np.concatenate([line for lines, _ in parts for line in lines])
    low, high = every.min(axis=0), every.max(axis=0)
    step = max(float((high - low).max()), 1e-9) / _GRID
    axes = [np.arange(low[k], high[k] + step, step) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    owner = np.full(len(grid), -1)
    found = []
    for k, (lines, style) in enumerate(parts):
        fill, stroke = _color(style["fill"]), _color(style["stroke"])
        if fill is not None:
            inside = [Polygon(line).contains_points(grid) for line in lines if len(line) > 2]
            owner[np.sum(inside, axis=0) % 2 == 1] = k  # even-odd
        if stroke is not None and sum(stroke) > 0.1:
            found += [(_along(line, step), stroke) for line in lines]
    for k, (_, style) in enumerate(parts):
        fill = _color(style["fill"]) if (owner == k).any() else None
        if fill is not None:  # a black light is none: what is black is shown white
            found.append((grid[owner == k], fill if sum(fill) > 0.1 else (1.0, 1.0, 1.0)))
    return found


def _along(line: FloatArray, step: float) -> FloatArray:
    """Points every `step` along a line (K, 2)."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, way[-1] + step, step)
    return np.column_stack([np.interp(at, way, line[:, k]) for k in range(2)])
