"""Random instances for the tests of RTH3D, and the checker beside the checkout."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy.ndimage import label

from swarm_envs.baselines.rth3d import FAMILIES, GridInstance, make_instance, max_density
from swarm_envs.baselines.rth3d.grid import building_columns, check_instance, numbers
from swarm_envs.state import BoolArray


def load_checker(shared: Path) -> Callable[[GridInstance, np.ndarray], dict]:
    """A report on paths (T + 1, n, 3), by ../shared/tools/mapf, not written by us."""
    validate = load_tool(shared / "tools" / "mapf" / "validate.py").validate

    def check(instance: GridInstance, paths: np.ndarray) -> dict:
        given = (instance.shape, instance.starts, instance.goals, instance.obstacles)
        return validate(numbers(paths, instance.shape), *given)

    return check


def load_tool(file: Path) -> ModuleType:
    name = f"mapf_{file.stem}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None and spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        source = file.read_text(encoding="utf-8").replace("cache=True", "cache=False")
        exec(compile(source, str(file), "exec"), sys.modules[name].__dict__)
    return sys.modules[name]


def random_instance(seed: int) -> GridInstance:
    """Any family that fits, sides of 3 to 24, density up to what RTH3D supports."""
    generator = np.random.default_rng(seed)
    while True:
        shape = tuple(int(m) for m in generator.integers(3, 25, size=3))
        family = str(generator.choice(list(FAMILIES)))
        sides = FAMILIES[family].sides
        m1, m2, m3 = (max(m // sides, 1) * sides for m in shape)
        shape = (m1, m2, m3)
        if max(shape) > 24:
            continue
        if not FAMILIES[family].free_count:
            found = make_instance(family, shape, seed=seed)
            if found.density > max_density(shape, found.obstacles) + 1e-9:
                continue  # rings on sides that are no multiples of 3
            return found
        walls = building_columns(shape) if FAMILIES[family].buildings else None
        most = round(max_density(shape, walls) * float(np.prod(shape)))
        most = min(most, int(np.prod(shape)) // 3)
        if most < 1:
            continue
        count = most if generator.random() < 0.3 else int(generator.integers(1, most + 1))
        return make_instance(family, shape, count, seed)


def maze(side: int, generator: np.random.Generator) -> BoolArray:
    """(side, side, 1) walls, one vertex thick, of a maze with one way between any two places."""
    walls = np.ones((side, side, 1), dtype=bool)
    walls[1, 1] = False
    stack = [np.array([1, 1])]
    while stack:
        here = stack[-1]
        steps = 2 * generator.permutation([(1, 0), (-1, 0), (0, 1), (0, -1)])
        for there in here + steps:
            if there.min() > 0 and there.max() < side and walls[tuple(there)]:
                walls[tuple(there)] = walls[tuple((here + there) // 2)] = False
                stack.append(there)
                break
        else:
            stack.pop()
    return walls


def between(walls: BoolArray, count: int, generator: np.random.Generator) -> GridInstance:
    """Random starts and goals in the largest connected part of the free vertices."""
    names = label(~walls)[0]
    largest = 1 + int(np.argmax(np.bincount(names.ravel())[1:]))
    free = np.argwhere(names == largest)
    starts, goals = (generator.permutation(free)[:count] for _ in range(2))
    return check_instance(starts, goals, walls.shape, walls)
