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


def group_slices(num_neighbors: int) -> dict[str, slice]:
    """Where the groups `self`, `neighbors` and `task` stand in a row."""
    layout = observation_layout(num_neighbors)

    def span(prefix: str) -> slice:
        places = [field.where for field in layout if field.name.startswith(prefix)]
        start = places[0].start if places else 0
        return slice(start, places[-1].stop if places else 0)

    return {"self": span("self."), "neighbors": span("neighbor_"), "task": span("task.")}


def observation_space(form: str, num_neighbors: int) -> spaces.Space[Any]:
    """The space of one drone's observation: a Box, or a Dict of Boxes.

    The dictionary has `self` (width), `neighbors` (K, width), nearest first, `mask` (K,), 1 where
    there is a neighbour, and `task` (width); see `observation_layout` for the fields.
    """
    groups = group_slices(num_neighbors)
    if form == "flat":
        return _box((groups["task"].stop,))
    width = _neighbor_width()
    parts: dict[str, spaces.Space[Any]] = {
        "self": _box((groups["self"].stop,)),
        "neighbors": _box((num_neighbors, width)),
        "mask": spaces.Box(0.0, 1.0, (num_neighbors,), np.float32),
        "task": _box((groups["task"].stop - groups["task"].start,)),
    }
    return spaces.Dict(parts)


def shaper(form: str, num_neighbors: int) -> Callable[[Float32Array], Observation]:
    """A function that gives rows (..., width) the form; its parts are views of the rows."""
    if form == "flat":
        return lambda rows: rows
    groups, width = group_slices(num_neighbors), _neighbor_width()

    def shape(rows: Float32Array) -> Observation:
        lead = rows.shape[:-1]
        neighbors = rows[..., groups["neighbors"]].reshape(*lead, num_neighbors, width + 1)
        return {
            "self": rows[..., groups["self"]],
            "neighbors": neighbors[..., :width],
            "mask": neighbors[..., width],
            "task": rows[..., groups["task"]],
        }

    return shape


def _neighbor_width() -> int:
    """Numbers a neighbour, its mask aside, which stands last."""
    groups = group_slices(1)
    return groups["neighbors"].stop - groups["neighbors"].start - 1


def _box(shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)
