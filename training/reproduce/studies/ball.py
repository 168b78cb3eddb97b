"""Theorem 5 flown: do position errors end in the ball of eq. (23), and do the quadrotor's?

A model error with known bounds is planted. On the plant that the theorem assumes, a point mass that
feels f_d at once, the bound must hold, and the worst error must come close to it. The quadrotor,
with attitude, rotor lag and limits, is outside of the theorem: its ball is reported beside, with
the controller's clamp on the integral and without.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import fly, swap_test
from swarm_envs.baselines.neural_swarm.theorem import (
    clamped_radius,
    error_ball,
    error_envelope,
    fly_point_mass,
    integral_force,
    without_clamp,
)
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.files import write_json, write_table
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.runs import Cell, draw_seeds, run_cells
from swarm_envs.training.reproduce.studies.ball_plot import plot_ball
from swarm_envs.training.reproduce.studies.lag import TEAM, TRUTH
from swarm_envs.training.reproduce.studies.planted import (
    fly_quadrotors,
    growing_error,
    random_errors,
)
from swarm_envs.vehicles import GRAM_FORCE, SMALL

RATE_G = 0.5
"""d_f: how fast the planted error changes, gram-force a second."""
SIZE_G = 5.0
"""Bound of the random errors, gram-force. The growing one reaches RATE_G times DURATION_S."""
DURATION_S = 20.0
"""Length of a flight, s."""
START = (0.3, 0.0, 0.1)
"""Position error at the start of the random errors' flights, m."""
SHOWN = 24
"""Keep every so-manieth sample of a curve."""


def reproduce_ball(
    out: Path, seed: int = 0, episodes: int = 8, progress: bool = True
) -> dict[str, Any]:
    """Plant errors on point mass and quadrotor; write `ball.json`, `ball.csv` and `ball.png`.

    Args:
        out: folder, made if missing; `ball_cells.json` there keeps what was flown.
        seed: random errors are drawn from it.
        episodes: random errors of each set of gains.
        progress: show a progress bar.

    Returns:
        The numbers, ready for JSON.

    Raises:
        ValueError: the folder holds the study with other settings.
    """
    draw_seeds(seed, episodes)
    settings = {
        "seed": seed, "episodes": episodes, "vehicle": SMALL.token, "error_rate_g_per_s": RATE_G,
        "random_error_g": SIZE_G, "duration_s": DURATION_S,
    }  # fmt: skip
    jobs: dict[str, Callable[[], Cell]] = {
        name: partial(measure, name, seed, episodes) for name in GAINS
    }
    jobs["shipped belief"] = partial(measure_belief, seed, episodes)
    cells = run_cells(out / "ball_cells.json", settings, jobs, progress)
    belief = cells.pop("shipped belief")
    rows = [{"gains": name, **cell["row"]} for name, cell in cells.items()]
    write_table(out / "ball.csv", rows)
    plot_ball(out / "ball.png", rows, cells["mid"]["curves"])
    summary = {**settings, "rows": rows, "shipped_belief": belief}
    write_json(out / "ball.json", summary)
    return summary


def measure(name: str, seed: int, flights: int) -> Cell:
    """Fly one set of gains: the bound, and the largest errors that were found."""
    gains, mass, steps = GAINS[name], SMALL.mass, round(DURATION_S / TIME_STEP)
    clamped, rate = ControllerConfig(gains), RATE_G * GRAM_FORCE
    free, ball = without_clamp(clamped), error_ball(gains, mass, rate)
    worst = growing_error(steps, rate)
    rng = np.random.default_rng(seed)
    drawn = random_errors(rng, flights, steps, SIZE_G * GRAM_FORCE, rate)
    point = _norms([fly_point_mass(SMALL, free, e, TIME_STEP, START) for e in drawn])
    point_worst = _norms([fly_point_mass(SMALL, free, worst, TIME_STEP)])[0]
    time = np.arange(steps + 1) * TIME_STEP
    envelope = error_envelope(gains, mass, rate, time, START)
    quadrotor = {
        key: (_norms(fly_quadrotors(SMALL, config, worst[None]))[0],
              _norms(fly_quadrotors(SMALL, config, drawn, START)))
        for key, config in (("free", free), ("clamped", clamped))
    }  # fmt: skip
    late = time >= 0.5 * DURATION_S
    row = {
        "ball_cm": 100.0 * ball.radius,
        "rate_per_s": ball.rate,
        "point_growing_cm": 100.0 * point_worst.max(),
        "point_random_cm": 100.0 * point[:, late].max(),
        "point_over_envelope": float((point / envelope).max()),
        "quadrotor_growing_cm": 100.0 * quadrotor["free"][0].max(),
        "quadrotor_random_cm": 100.0 * quadrotor["free"][1][:, late].max(),
        "quadrotor_over_envelope": float((quadrotor["free"][1] / envelope).max()),
        "clamp_holds_g": integral_force(clamped, mass) / GRAM_FORCE,
        "clamped_growing_cm": 100.0 * quadrotor["clamped"][0].max(),
        "clamped_random_cm": 100.0 * quadrotor["clamped"][1][:, late].max(),
        "clamped_bound_cm": 100.0 * clamped_radius(clamped, mass, -worst[-1, 2]),
    }
    curves = {
        "time_s": time,
        "envelope_m": envelope,
        "point_random_m": point,
        "point_growing_m": point_worst,
        "quadrotor_growing_m": quadrotor["free"][0],
        "clamped_growing_m": quadrotor["clamped"][0],
    }
    return {
        "row": {key: round(float(value), 4) for key, value in row.items()},
        "curves": {key: np.round(c[..., ::SHOWN], 6).tolist() for key, c in curves.items()},
    }


def measure_belief(seed: int, flights: int) -> Cell:
    """What the bounds say of the belief that ships, and what is flown: L2S, default gains."""
    controller = ControllerConfig(feedforward=load_belief())
    test = replace(swap_test(TEAM, truth=TRUTH), decision_rate=PHYSICS_RATE)
    flown = fly(test, controller, draw_seeds(seed, flights))
    error = (flown.force - flown.believed)[:, 1:, -1]
    size = float(np.linalg.norm(error, axis=-1).max())
    rate = float(np.linalg.norm(np.diff(error, axis=1), axis=-1).max() / TIME_STEP)
    return {
        "error_g": round(size / GRAM_FORCE, 3),
        "error_rate_g_per_s": round(rate / GRAM_FORCE, 2),
        "ball_cm": round(100.0 * error_ball(controller.gains, SMALL.mass, rate).radius, 2),
        "clamped_bound_cm": round(100.0 * clamped_radius(controller, SMALL.mass, size), 2),
        "flown_cm": round(100.0 * float(flown.worst_height_error[:, -1].max()), 2),
    }


def _norms(errors: list[FloatArray] | FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.asarray(errors), axis=-1))


def format_ball(summary: dict[str, Any]) -> str:
    """The bound and what was found, as text."""
    lines = [
        f"Position error (cm), model error changing by {RATE_G:g} g/s, growing to "
        f"{RATE_G * DURATION_S:g} g or random within {SIZE_G:g} g",
        f"{'':8}{'eq. (23)':>10}{'point mass':>20}{'quadrotor':>20}{'quadrotor, clamp':>20}",
        f"{'gains':8}{'ball':>10}" + 3 * f"{'growing':>11}{'random':>9}",
    ]
    for row in summary["rows"]:
        pairs = [(f"{plant}_growing_cm", f"{plant}_random_cm")
                 for plant in ("point", "quadrotor", "clamped")]  # fmt: skip
        found = "".join(f"{row[a]:11.2f}{row[b]:9.2f}" for a, b in pairs)
        lines.append(f"{row['gains']:8}{row['ball_cm']:10.2f}{found}")
    found = summary["shipped_belief"]
    error = f"{found['error_g']:.2f} g and {found['error_rate_g_per_s']:.1f} g/s"
    lines.append(
        f"belief that ships, L2S: error up to {error}; eq. (23) allows {found['ball_cm']:.0f} cm, "
        f"its size {found['clamped_bound_cm']:.1f} cm; flown {found['flown_cm']:.1f} cm"
    )
    return "\n".join(lines)
