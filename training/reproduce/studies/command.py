"""`swarm-envs reproduce neural-swarm2 --study NAME`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from swarm_envs.baselines.neural_swarm.flights import default_engine

Study = Literal["lag", "ball", "limits"]
"""Every study by name."""


def run_study(
    name: Study, out: Path, seed: int, episodes: int | None, engine: str | None
) -> tuple[dict[str, Any], str]:
    """Do a study, and return the numbers and what to print.

    Args:
        name: which.
        out: folder, made if missing.
        seed: of swaps and random errors.
        episodes: flights of each kind; None for the study's own number.
        engine: `bullet`, `batch`, or None for Bullet where it can be imported; `lag` alone asks.
    """
    given: dict[str, Any] = {} if episodes is None else {"episodes": episodes}
    if name == "lag":
        from swarm_envs.training.reproduce.studies.lag import format_lag, reproduce_lag

        summary = reproduce_lag(out, seed, engine=engine or default_engine(), **given)
        text = format_lag(summary)
    elif name == "ball":
        from swarm_envs.training.reproduce.studies.ball import format_ball, reproduce_ball

        summary = reproduce_ball(out, seed, **given)
        text = format_ball(summary)
    else:
        from swarm_envs.training.reproduce.studies.limits import format_limits, reproduce_limits

        summary = reproduce_limits(out, seed, **given)
        text = format_limits(summary)
    return summary, text
