"""Public functions refuse bad values with a message that names the argument or the value.

Settings are given bad values in tests/test_options.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import agents, make, task_family
from swarm_envs.baselines import mlr_dmpc, neural_swarm, rth3d
from swarm_envs.interactions import load
from swarm_envs.training.flight_logs import read_table
from swarm_envs.training.interaction_rows import read_rows
from swarm_envs.trajectories import ramped_line, rest_to_rest
from swarm_envs.vehicles import parse_team, team_string
from swarm_envs.viewing.trajectory import read_trajectory

STARTS, GOALS = np.array([[0.0, 0, 1], [1.0, 0, 1]]), np.array([[0.0, 1, 1], [1.0, 1, 1]])
CORNERS = [[0, 0, 0], [3, 3, 3]]
VALID: Mapping[Callable[..., Any], Mapping[str, Any]] = {
    make: {"task": "swap_v1"},
    parse_team: {"team": "SSL"},
    team_string: {"team": parse_team("SSL")},
    task_family: {"task": "swap_v1"},
    load: {"name": "learned"},
    agents.load: {"name": "hover"},
    rest_to_rest: {"start": STARTS, "goal": GOALS, "duration": 1.0, "t": 0.5},
    ramped_line: {"start": STARTS, "goal": GOALS, "duration": 1.0, "t": 0.5, "ramp": 0.2},
    rth3d.plan: {"starts": CORNERS, "goals": CORNERS[::-1], "shape": (6, 6, 6), "seed": 0},
    rth3d.max_density: {"shape": (6, 6, 6), "obstacles": None},
    rth3d.building_columns: {"shape": (6, 6, 6)},
    mlr_dmpc.MlrDmpcSwarm: {"starts": STARTS, "targets": GOALS, "compute_units": 1},
    neural_swarm.TrackingAgent: {"controller": None, "decision_rate": 48},
    read_trajectory: {"path": Path("no.npz")},
    read_table: {"path": Path("no.csv")},
    read_rows: {"path": Path("no.npz")},
}
"""Public functions, and arguments that each takes."""
BAD: list[Any] = [
    *(math.nan, math.inf, -1, 0.5, 10**30, None, "", "no such thing", "a\0b", [], {}),
    *([[1.0], [1.0, 2.0]], np.full((2, 3), math.nan), np.zeros((1, 2, 3, 4, 5))),
    Path("nowhere", "file.npz"),
]


@pytest.mark.parametrize("function", VALID, ids=lambda function: function.__qualname__)
def test_a_bad_value_is_taken_or_refused_by_name(function):
    for name in VALID[function]:
        for bad in BAD:
            try:
                function(**{**VALID[function], name: bad})
            except (ValueError, TypeError, OSError) as error:
                told = str(error).lower()
                named = {name, name.rstrip("s"), name.replace("_", " ")}
                quoted = {f"{bad!r:.20}".strip("'"), f"{bad}"[:20]}
                assert any(word.lower() in told for word in named | quoted), (name, bad, told)
