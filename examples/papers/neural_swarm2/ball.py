"""Test of Theorem 5: position errors of a point mass and of a quadrotor against eq. (23).

A model error with known bounds is added. For the plant of the theorem, a point mass with the force
f_d without lag, the bound must hold, and the worst error must come close to it. The theorem does
not cover a quadrotor, with attitude, rotor lag and limits: its errors are reported too, with and
without the clamp of the controller on the integral.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from examples.papers.common import markdown, write_json
from examples.papers.neural_swarm2 import theorem
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.flights import run_flights, swap_test
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.vehicles import GRAM_FORCE, SMALL, Vehicle
from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATE_G = 0.5  # d_f: how fast the model error changes, gram-force a second
SIZE_G = 5.0  # bound of the random errors, gram-force; the growing one reaches RATE_G * DURATION_S
DURATION_S = 20.0  # length of a flight, s
START = (0.3, 0.0, 0.1)  # position error at the start of the flights with random errors, m
TURN_S = 0.7  # mean time for which a random error goes in one direction, s
KINDS = ("growing", "random")  # model errors: the worst one, and others
SHOWN = 24  # every 24th sample of a curve is kept
PLANTS: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    ("point_growing", "#0072B2", "point mass", {"linewidth": 3.0}),
    ("quadrotor_growing", "#009E73", "quadrotor, integral free", {"linestyle": "--"}),
    ("clamped_growing", "#D55E00", "quadrotor, integral clamped", {}),
)
"""Curves of the picture: key, color, label and line; they lie on each other."""


def ball(out: Path = Path("neural_swarm2"), episodes: int = 8, seed: int = 0) -> None:
    """Fly with a known model error, and compare position errors with Theorem 5 (docs/limits.md).

    Writes `ball.json` (`rows`: the ball of eq. (23) and the largest errors of point mass and
    quadrotor by gains; `shipped_belief`: what the bounds say of the force model that ships) and
    `ball.png`.

    Args:
        out: folder, made if missing.
        episodes: random errors of each set of gains.
        seed: of these.
    """
    found = {name: measure_gains(name, seed, episodes) for name in tqdm(GAINS, "Theorem 5")}
    rows = [{"gains": name, **row} for name, (row, _) in found.items()]
    summary: dict[str, Any] = {
        "seed": seed,
        "episodes": episodes,
        "vehicle": SMALL.token,
        "error_rate_g_per_s": RATE_G,
        "random_error_g": SIZE_G,
        "duration_s": DURATION_S,
        "rows": rows,
        "shipped_belief": measure_belief(seed, episodes),
    }
    write_json(out / "ball.json", summary)
    plot_ball(out / "ball.png", rows, found["mid"][1])
    errors = [f"{p}_{kind}_cm" for p in ("point", "quadrotor", "clamped") for kind in KINDS]
    print(f"Position errors; the model error changes by {RATE_G:g} g/s")
    print(markdown(rows, ("gains", "ball_cm", *errors)))
    print(markdown([summary["shipped_belief"]], list(summary["shipped_belief"])))


def growing_error(steps: int, rate: float) -> FloatArray:
    """Return an error (steps, 3), N, that grows downward by a rate, N/s: the theorem's worst."""
    return np.asarray(rate * TIME_STEP * np.arange(steps)[:, None] * [0.0, 0.0, -1.0])


def random_errors(
    rng: np.random.Generator, flights: int, steps: int, size: float, rate: float
) -> FloatArray:
    """Draw errors (E, T, 3), N, that change by `rate`, N/s, at random, within a ball of `size`."""
    errors = np.zeros((flights, steps, 3))
    heading = _directions(rng, flights)
    for k in range(1, steps):
        turns = rng.random(flights) < TIME_STEP / TURN_S
        heading[turns] = _directions(rng, int(turns.sum()))
        last = errors[:, k - 1]
        outside = np.linalg.norm(last + rate * TIME_STEP * heading, axis=1) > size
        heading[outside] = -last[outside] / np.linalg.norm(last[outside], axis=1, keepdims=True)
        errors[:, k] = last + rate * TIME_STEP * heading
    return errors


def _directions(rng: np.random.Generator, count: int) -> FloatArray:
    """Draw unit vectors (count, 3), uniform on the sphere."""
    vectors = rng.standard_normal((count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def fly_quadrotors(
    vehicle: Vehicle,
    config: ControllerConfig,
    force_errors: FloatArray,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Return position errors (E, T + 1, 3), m, of quadrotors that hold a place.

    They compensate -eps_f, the model errors `force_errors` (E, T, 3), N; attitude, rotor lag and
    limits of the thrust are those of the package's engine, at 240 Hz. `position_error` (3,) is that
    of the start, m.
    """
    flights, steps, _ = force_errors.shape
    place = np.tile([0.0, 0.0, 100.0], (flights, 1, 1))  # far above the ground
    physics = BatchPhysics((vehicle,), flights, "none")
    controller = TrackingController((vehicle,), flights, config)
    setpoint = Setpoint.hold(place)
    state = physics.reset(hover_state((vehicle,), place + np.asarray(position_error)))
    found = np.empty((flights, steps + 1, 3))
    found[:, 0] = position_error
    for k in range(steps):
        commands = controller.commands(state, setpoint, -force_errors[:, None, k])
        state = physics.step(commands)
        found[:, k + 1] = (state.position - place)[:, 0]
    return found


def measure_gains(
    name: str, seed: int, flights: int
) -> tuple[dict[str, float], dict[str, FloatArray]]:
    """Fly one set of gains: the bound and the largest errors, and curves over time."""
    gains, mass, steps = GAINS[name], SMALL.mass, round(DURATION_S / TIME_STEP)
    clamped, rate = ControllerConfig(gains), RATE_G * GRAM_FORCE
    free, limit = theorem.without_clamp(clamped), theorem.error_ball(gains, mass, rate)
    worst = growing_error(steps, rate)
    rng = np.random.default_rng(seed)
    drawn = random_errors(rng, flights, steps, SIZE_G * GRAM_FORCE, rate)
    point = _norms([theorem.fly_point_mass(SMALL, free, e, TIME_STEP, START) for e in drawn])
    point_worst = _norms(theorem.fly_point_mass(SMALL, free, worst, TIME_STEP))
    time = np.arange(steps + 1) * TIME_STEP
    envelope = theorem.error_envelope(gains, mass, rate, time, START)
    free_worst, clamped_worst = (
        _norms(fly_quadrotors(SMALL, config, worst[None]))[0] for config in (free, clamped)
    )
    free_drawn, clamped_drawn = (
        _norms(fly_quadrotors(SMALL, config, drawn, START)) for config in (free, clamped)
    )
    late = time >= 0.5 * DURATION_S
    row = {
        "ball_cm": 100.0 * limit.radius,
        "rate_per_s": limit.rate,
        "point_growing_cm": 100.0 * point_worst.max(),
        "point_random_cm": 100.0 * point[:, late].max(),
        "point_over_envelope": float((point / envelope).max()),
        "quadrotor_growing_cm": 100.0 * free_worst.max(),
        "quadrotor_random_cm": 100.0 * free_drawn[:, late].max(),
        "quadrotor_over_envelope": float((free_drawn / envelope).max()),
        "clamp_holds_g": theorem.integral_force(clamped, mass) / GRAM_FORCE,
        "clamped_growing_cm": 100.0 * clamped_worst.max(),
        "clamped_random_cm": 100.0 * clamped_drawn[:, late].max(),
        "clamped_bound_cm": 100.0 * theorem.clamped_radius(clamped, mass, -worst[-1, 2]),
    }
    curves = {
        "time_s": time,
        "envelope_m": envelope,
        "point_random_m": point,
        "point_growing_m": point_worst,
        "quadrotor_growing_m": free_worst,
        "clamped_growing_m": clamped_worst,
    }
    rounded = {key: round(float(value), 4) for key, value in row.items()}
    return rounded, {key: curve[..., ::SHOWN] for key, curve in curves.items()}


def measure_belief(seed: int, flights: int) -> dict[str, float]:
    """Return what the bounds say of the force model that ships, and errors of L2S, mid gains."""
    controller = ControllerConfig(feedforward=load_belief())
    test = replace(swap_test("L2S", truth="learned"), decision_rate=PHYSICS_RATE)
    flown = run_flights(test, controller, frozen_seeds(seed, flights))
    error = (flown.force - flown.feedforward_force)[:, 1:, -1]
    size = float(_norms(error).max())
    rate = float(_norms(np.diff(error, axis=1)).max() / TIME_STEP)
    radius = theorem.error_ball(controller.gains, SMALL.mass, rate).radius
    return {
        "error_g": round(size / GRAM_FORCE, 3),
        "error_rate_g_per_s": round(rate / GRAM_FORCE, 2),
        "ball_cm": round(100.0 * radius, 2),
        "clamped_bound_cm": round(100.0 * theorem.clamped_radius(controller, SMALL.mass, size), 2),
        "flown_cm": round(100.0 * float(flown.worst_height_error[:, -1].max()), 2),
    }


def _norms(errors: list[FloatArray] | FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.asarray(errors), axis=-1))


def plot_ball(
    path: Path, rows: Sequence[Mapping[str, Any]], curves: Mapping[str, FloatArray]
) -> None:
    """Draw random and worst errors over time, gains mid, and the balls of all gains."""
    headline = "Theorem 5: the ball of the position error under a model error"
    with picture(path, 14.0, 4.4, headline) as figure:
        envelope, growing, balls = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.25])
        mid = next(row for row in rows if row["gains"] == "mid")
        time = curves["time_s"]
        for k, error in enumerate(100.0 * curves["point_random_m"]):
            label = "point mass, random errors" if k == 0 else None
            envelope.plot(time, error, color=PLANTS[0][1], linewidth=0.9, label=label)
        bound = 100.0 * curves["envelope_m"]
        envelope.plot(time, bound, color=INK, linewidth=1.8, label="bound on the way there")
        for key, color, label, line in PLANTS:
            growing.plot(time, 100.0 * curves[f"{key}_m"], color=color, label=label, **line)
        for axis, title in ((envelope, "Random errors, gains mid"), (growing, "Worst error")):
            axis.axhline(mid["ball_cm"], color=GREY, linestyle=":", label="ball, eq. (23)")
            axis.set(title=title, xlabel="Time (s)", ylabel="Position error (cm)")
            axis.grid(True)
            axis.legend(fontsize=8)
        growing.set_ylim(0.0, 3.2 * mid["ball_cm"])
        drawn = (("ball", "#B8BEC5", "ball, eq. (23)"), *(plant[:3] for plant in PLANTS))
        series = {label: (color, [row[f"{key}_cm"] for row in rows]) for key, color, label in drawn}
        _draw_bars(balls, [row["gains"] for row in rows], series)
        balls.legend(fontsize=8, ncols=2, loc="upper center")
        balls.set(title="Worst error, by gains", ylim=(1.0, 500.0), ylabel="Largest error (cm)")


def _draw_bars(
    axis: Axes, groups: Sequence[str], series: Mapping[str, tuple[str, Sequence[float]]]
) -> None:
    """Draw series (color and heights by label) on a logarithmic axis, numbers above the bars."""
    for k, (label, (color, heights)) in enumerate(series.items()):
        places = np.arange(len(groups)) + 0.2 * (k - 0.5 * (len(series) - 1))
        bars = axis.bar(places, heights, 0.19, color=color, label=label)
        axis.bar_label(bars, [f"{y:.3g}" for y in heights], fontsize=8, color=INK)
    axis.set_yscale("log")
    axis.set_xticks(range(len(groups)), groups)
    axis.grid(True, axis="y")
