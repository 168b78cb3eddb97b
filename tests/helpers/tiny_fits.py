"""A fit small enough for a test: its options, its network, and rows with a law in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.network import EVERYWHERE, DeepSetSpec, InputRange
from swarm_envs.training.interaction_rows import InteractionRows

PLAIN = FitConfig(data=Path(), out=Path(), steps=40, batch_size=64, progress=False)
SPEC = DeepSetSpec(("S", "L"), EVERYWHERE, None, None)
RANGE = InputRange(
    ((-0.35, -0.35, -1.0, -1.0, -1.0, -1.2), (0.35, 0.35, 1.0, 1.0, 1.0, 1.2)),
    ((-1.6, -0.6, -0.6, -1.0), (-0.07, 0.6, 0.6, 1.0)),
)
"""Limits of the inputs as narrow as those of a measured fit."""


def make_rows(count: int, **arrays: Any) -> InteractionRows:
    """Rows of one small drone of one flight that hovers; `arrays` are given in their place."""
    zeros, alike = np.zeros((count, 3)), np.zeros(count, dtype=np.int64)
    usual = {
        "types": ("S", "L"),
        "ego_type": alike,
        "position": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "velocity": zeros,
        "force_g": zeros,
        "flight": alike,
        "step": np.arange(count),
        "vehicle": alike + 50,
        "scenario": alike,
        "validation": np.arange(count) // 100 % 5 == 0,
        "scenario_names": ("pairs",),
    }
    return InteractionRows(**usual | arrays)


def rows_of(
    count: int = 1200, flights: int = 2, noise: float = 0.0, seed: int = 0
) -> InteractionRows:
    """Rows in which a neighbour's height decides the force; three steps of the log a row."""
    rng = np.random.default_rng(seed)
    kind = rng.integers(2, size=(2, count))
    neighbor = rng.uniform(-0.4, 0.4, (count, 1, 6))
    force = np.zeros((count, 3))
    force[:, 2] = -8.0 * np.maximum(neighbor[:, 0, 2], 0.0) + noise * rng.normal(size=count)
    step = 3 * (np.arange(count) // flights)
    return make_rows(
        count,
        ego_type=kind[0],
        position=rng.uniform(0.5, 1.0, (count, 3)),
        velocity=rng.uniform(-0.3, 0.3, (count, 3)),
        neighbor=neighbor,
        neighbor_type=kind[1][:, None],
        force_g=force,
        flight=np.arange(count) % flights,
        step=step,
        vehicle=np.where(kind[0], 101, 50),
        scenario=kind[0],
        validation=step // 300 % 5 == 4,
        scenario_names=("S", "L"),
    )
