"""Files of the MAPF benchmarks: flat grids (`.map`) and starts and goals on them (`.scen`).

The formats of movingai.com (Sturtevant 2012; Stern et al. 2019). Column x and row y of a map are
vertex (x, y, 0) of a grid (width, height, 1).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance, check_shape
from swarm_envs.files import written_whole
from swarm_envs.state import BoolArray

__all__ = ["read_benchmark"]

_FREE, _BLOCKED = ".GS", "@OTW"
_COLUMNS = ("bucket", "map", "width", "height", "start x", "start y", "goal x", "goal y", "length")
_HEADER = ("type", "height", "width", "map")


def read_benchmark(
    map_file: str | Path, scen_file: str | Path, robots: int | None = None
) -> GridInstance:
    """The instance of the first robots of a `.scen` on a `.map`; of all, if no number is given.

    Raises:
        ValueError: a file is malformed, of another map, or has fewer robots; it names the line.
        OSError: a file cannot be read.
    """
    map_file, scen_file = Path(map_file), Path(scen_file)
    walls = _read_map(map_file)
    lines = _lines(scen_file)
    if not lines or not lines[0].lower().startswith("version"):
        raise ValueError(f"{scen_file}, line 1: must be 'version 1', as .scen files begin")
    rows = [(k, line) for k, line in enumerate(lines[1:], 2) if line.strip()]
    wanted = len(rows) if robots is None else robots
    if not 1 <= wanted <= len(rows):
        rule = f"it must be from 1 to the {len(rows)} of {scen_file}"
        raise ValueError(f"the number of robots is {wanted}, but {rule}")
    ends = np.array([_ends(scen_file, k, line, walls.shape) for k, line in rows[:wanted]])
    try:
        return check_instance(ends[:, :2], ends[:, 2:], walls.shape, walls)
    except ValueError as error:
        raise ValueError(f"{scen_file} on {map_file}: {error}") from error


def write_benchmark(map_file: str | Path, scen_file: str | Path, instance: GridInstance) -> None:
    """Write a flat instance as a `.map` and a `.scen`.

    The last column is the length of the shortest way along edges, without diagonals.

    Raises:
        ValueError: the grid is higher than one vertex.
        NoPlanExists: obstacles cut a robot off from its goal.
        OSError: a file cannot be written.
    """
    map_file, scen_file = Path(map_file), Path(scen_file)
    width, height, depth = instance.shape
    if depth != 1:
        raise ValueError(f"the grid has shape {instance.shape}, but a .map is one vertex high")
    rows = ["".join(row) for row in np.where(instance.obstacles[:, :, 0].T, "@", ".")]
    head = ["type octile", f"height {height}", f"width {width}", "map"]
    ways = zip(instance.starts, instance.goals, instance.lengths.tolist(), strict=True)
    robots = [
        "\t".join(map(str, (n // 4, map_file.name, width, height, *a[:2], *b[:2], f"{n}.0")))
        for a, b, n in ways
    ]
    for file, lines in ((map_file, [*head, *rows]), (scen_file, ["version 1", *robots])):
        with written_whole(file) as partial:
            partial.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _lines(file: Path) -> list[str]:
    # What is no UTF-8 is reported where it stands, as any other wrong character.
    return file.read_text(encoding="utf-8-sig", errors="replace").splitlines()


def _whole(file: Path, number: int, name: str, text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise ValueError(f"{file}, line {number}: {name} is {text!r}, but must be a whole number")
    return int(text)


def _read_map(file: Path) -> BoolArray:
    lines = _lines(file)
    words = [line.split() or [""] for line in lines[:4]]
    for number, name in enumerate(_HEADER, 1):
        if len(words) < number or words[number - 1][0] != name:
            raise ValueError(f"{file}, line {number}: must begin with {name!r}, as .map files do")
    height, width = (_whole(file, k + 1, words[k][0], " ".join(words[k][1:])) for k in (1, 2))
    check_shape((width, height))
    rows = lines[4 : 4 + height]
    if len(rows) < height or any(line.strip() for line in lines[4 + height :]):
        raise ValueError(f"{file} has {len(lines) - 4} rows, but its height is {height}")
    return np.stack([_row(file, k, row, width) for k, row in enumerate(rows, 5)], 1)[:, :, None]


def _row(file: Path, number: int, row: str, width: int) -> npt.NDArray[np.bool_]:
    if len(row) != width:
        raise ValueError(f"{file}, line {number}: has {len(row)} characters, but width is {width}")
    unknown = set(row) - set(_FREE + _BLOCKED)
    if unknown:
        rule = f"{_FREE!r} are free and {_BLOCKED!r} are not"
        raise ValueError(f"{file}, line {number}: no terrain is {min(unknown)!r}; {rule}")
    return np.array([c in _BLOCKED for c in row])


def _ends(file: Path, number: int, line: str, shape: tuple[int, ...]) -> list[int]:
    """Start x and y, goal x and y of a line."""
    fields = line.split("\t") if "\t" in line else line.split()
    if len(fields) < len(_COLUMNS):
        rule = f"has {len(fields)} columns, but must have {len(_COLUMNS)}: {', '.join(_COLUMNS)}"
        raise ValueError(f"{file}, line {number}: {rule}")
    given = zip(_COLUMNS[2:8], fields[2:8], strict=True)
    width, height, *ends = (_whole(file, number, name, text.strip()) for name, text in given)
    if (width, height) != shape[:2]:
        sides = f"{width} x {height}, but the map is {shape[0]} x {shape[1]}"
        raise ValueError(f"{file}, line {number}: is of a map of {sides}")
    for k, (name, place) in enumerate(zip(_COLUMNS[4:8], ends, strict=True)):
        if place >= shape[k % 2]:
            raise ValueError(f"{file}, line {number}: {name} is {place}, outside the map")
    return ends
