"""`swarm-envs reproduce neural-swarm2 --figure 6|7`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swarm_envs.baselines.neural_swarm.flights import default_engine


def run_figure(
    figure: int,
    out: Path,
    seed: int,
    truth: str | None,
    engine: str | None,
    scenarios: Sequence[str],
    trials: int,
) -> tuple[dict[str, Any], str]:
    """Remake Fig. 6 or 7, and return the numbers and what to print.

    Args:
        figure: 6 or 7.
        out: folder, made if missing.
        seed: of planner and scenarios.
        truth: the force that blows where quadrotors fly; None for `learned`.
        engine: who computes these flights; None for Bullet where it can be imported.
        scenarios: of Fig. 7.
        trials: of each; of Fig. 6: seeds with which it is planned.
    """
    air, flown_by = truth or "learned", engine or default_engine()
    if figure == 6:
        from swarm_envs.training.reproduce.planning.figure_6 import (
            format_figure_6,
            reproduce_figure_6,
        )

        summary = reproduce_figure_6(out, seed, trials, air, flown_by)
        return summary, format_figure_6(summary)
    from swarm_envs.training.reproduce.planning.figure_7 import format_figure_7, reproduce_figure_7

    summary = reproduce_figure_7(out, seed, scenarios, trials, air, flown_by)
    return summary, format_figure_7(summary)
