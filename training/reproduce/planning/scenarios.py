"""The scenarios of Fig. 7: who changes places with whom, drawn at random in the y-z plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tasks.placing import derangement
from swarm_envs.vehicles import parse_team

SCENARIOS = ("SS", "SL", "LL", "SSS", "SSL", "SLL", "LLL")
"""Teams of two and three. The paper's text names SL, LL and SSL; its picture is not extracted."""
TRIALS = 5
"""Trials of each scenario in the paper."""
SPACING_M = 1.0
"""Distance between neighbouring places in y, m."""
HEIGHT_M = 1.2
"""Mean height of the places, m."""
JITTER_M = 0.15
"""Each place lies at most so far from its mean in y and in z, m."""


class Swap(NamedTuple):
    """One trial: where robots start and end."""

    team: str
    """Who changes places."""
    starts: FloatArray
    """(N, 3) m, all at x = 0."""
    goals: FloatArray
    """(N, 3) m: each the start of another robot."""


def draw_swap(team: str, seed: int) -> Swap:
    """Draw one trial: places in a row, robots in random order, no one stays.

    The same seed gives the same trial, whoever plans it.

    Args:
        team: tokens, such as `"SSL"`; at least two.
        seed: of the trial.

    Raises:
        ValueError: a single robot, with no one to change places with.
    """
    count = len(parse_team(team))
    if count < 2:
        raise ValueError(f"team {team!r} has {count} robot, but a swap takes two; name more")
    rng = np.random.default_rng(seed)
    places = np.zeros((count, 3))
    places[:, 1] = SPACING_M * (np.arange(count) - 0.5 * (count - 1))
    places[:, 2] = HEIGHT_M
    places[:, 1:] += rng.uniform(-JITTER_M, JITTER_M, (count, 2))
    starts = places[rng.permutation(count)]
    return Swap(team, starts, starts[derangement(rng, count)])


def figure_6_swap() -> Swap:
    """The three-robot swap of Fig. 6: the large one starts between the small ones, and ends aside.

    The paper's coordinates are not published; these are the means of `draw_swap`.
    """
    y = SPACING_M * np.array([-1.0, 1.0, 0.0])
    starts = np.column_stack([np.zeros(3), y, np.full(3, HEIGHT_M)])
    return Swap("SSL", starts, starts[[1, 2, 0]])
