"""Forms that observation rows take: flat as they are, or as a dictionary for set encoders."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from swarm_envs.envs.observation import Float32Array, observation_layout

FORMS = ("flat", "dict")
"""Names of the forms."""

Observation = Any
"""One drone's: a float32 row, or a dictionary of float32 arrays; whoever asks knows which."""

_SETS = {"neighbors": ("neighbor_", "mask"), "obstacles": ("obstacle_", "obstacle_mask")}
"""Groups of fields that repeat: the name of theirs, and of what masks them."""


def observation_space(form: str, num_neighbors: int, num_obstacles: int = 0) -> spaces.Space[Any]:
    """The space of one drone's observation: a Box, or a Dict of Boxes.

    The dictionary has `self` (width), `neighbors` (K, width), nearest first, `mask` (K,), 1 where
    there is a neighbour, and `task` (width); with obstacles observed also `obstacles` (M, 3) and
    `obstacle_mask` (M,). See `observation_layout` for the fields.
    """
    row = np.zeros(observation_layout(num_neighbors, num_obstacles)[-1].where.stop, np.float32)
    if form == "flat":
        return _box(row)
    parts = shaper(form, num_neighbors, num_obstacles)(row)
    return spaces.Dict({name: _box(part, "mask" in name) for name, part in parts.items()})


def shaper(
    form: str, num_neighbors: int, num_obstacles: int = 0
) -> Callable[[Float32Array], Observation]:
    """A function that gives rows (..., width) the form; its parts are views of the rows."""
    if form == "flat":
        return lambda rows: rows
    own = _span("self.", num_neighbors, num_obstacles)
    task = _span("task.", num_neighbors, num_obstacles)
    counts = {"neighbors": num_neighbors, "obstacles": num_obstacles}
    places = {
        name: (_span(_SETS[name][0], num_neighbors, num_obstacles), _set_width(name))
        for name, count in counts.items()
        if count or name == "neighbors"
    }

    def shape(rows: Float32Array) -> Observation:
        parts = {"self": rows[..., own], "task": rows[..., task]}
        for name, (where, width) in places.items():
            group = rows[..., where].reshape(*rows.shape[:-1], counts[name], width + 1)
            parts[name], parts[_SETS[name][1]] = group[..., :width], group[..., width]
        return parts

    return shape


def _span(prefix: str, num_neighbors: int, num_obstacles: int) -> slice:
    """Where the fields of a prefix stand in a row; nowhere if there are none."""
    layout = observation_layout(num_neighbors, num_obstacles)
    places = [field.where for field in layout if field.name.startswith(prefix)]
    return slice(places[0].start, places[-1].stop) if places else slice(0, 0)


def _set_width(name: str) -> int:
    """Numbers of one member of a group, its mask aside, which stands last."""
    where = _span(_SETS[name][0], 1, 1)
    return where.stop - where.start - 1


def _box(part: Float32Array, mask: bool = False) -> spaces.Box:
    low, high = (0.0, 1.0) if mask else (-np.inf, np.inf)
    return spaces.Box(low, high, part.shape, np.float32)
