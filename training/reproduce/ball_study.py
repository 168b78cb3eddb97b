"""Theorem 5 flown: do position errors end in the ball of eq. (23), and do the quadrotor's?

A model error with known bounds is planted. On the plant that the theorem assumes, a point mass that
feels f_d at once, the bound must hold, and the worst error must come close to it. The quadrotor,
with attitude, rotor lag and limits, is outside of the theorem: its ball is reported too, with
the controller's clamp on the integral and without.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm import theorem
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import fly, format_columns, swap_test
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.errors import check_array
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import PHYSICS_RATE, TIME_STEP
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.training.reproduce.charts import draw_numbered_bars, label_axis
from swarm_envs.training.reproduce.lag_study import TEAM, TRUTH
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study
from swarm_envs.vehicles import GRAM_FORCE, SMALL, Vehicle
from swarm_envs.viewing.style import GREY, INK, picture

_RATE_G = 0.5  # d_f: how fast the planted error changes, gram-force a second
_SIZE_G = 5.0
"""Bound of the random errors, gram-force. The growing one reaches _RATE_G times _DURATION_S."""
_DURATION_S = 20.0  # length of a flight, s
_START = (0.3, 0.0, 0.1)  # position error at the start of the random errors' flights, m
_SHOWN = 24  # every 24th sample of a curve is kept
_EPISODES = 8  # random errors of each set of gains
_TURN_S = 0.7  # mean time for which a random error goes in one direction, s


def growing_error(steps: int, rate: float) -> FloatArray:
    """(steps, 3) an error that grows downwards by a rate, N/s: the worst for Theorem 5, N."""
    return np.asarray(rate * TIME_STEP * np.arange(steps)[:, None] * [0.0, 0.0, -1.0])


def random_errors(
    rng: np.random.Generator, flights: int, steps: int, size: float, rate: float
) -> FloatArray:
    """Errors (E, T, 3), N, that change by `rate`, N/s, at random, within a ball of `size`."""
    errors = np.zeros((flights, steps, 3))
    heading = _directions(rng, flights)
    for k in range(1, steps):
        turns = rng.random(flights) < TIME_STEP / _TURN_S
        heading[turns] = _directions(rng, int(turns.sum()))
        last = errors[:, k - 1]
        outside = np.linalg.norm(last + rate * TIME_STEP * heading, axis=1) > size
        heading[outside] = -last[outside] / np.linalg.norm(last[outside], axis=1, keepdims=True)
        errors[:, k] = last + rate * TIME_STEP * heading
    return errors


def _directions(rng: np.random.Generator, count: int) -> FloatArray:
    """(count, 3) unit vectors, uniform on the sphere."""
    vectors = rng.standard_normal((count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def fly_quadrotors(
    vehicle: Vehicle,
    config: ControllerConfig,
    force_errors: FloatArray,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Position errors (E, T + 1, 3), m, of quadrotors that hold a place and compensate -eps_f.

    The planted model errors `force_errors` (E, T, 3) are in N; attitude, rotor lag and limits of
    the thrust are those of the package's engine, at 240 Hz. `position_error` (3,) is that of the
    start.

    Raises:
        ValueError: the errors have another shape, or are not finite.
    """
    shape = (*np.shape(force_errors)[:2], 3)
    errors = check_array("force_errors", force_errors, shape, "(E, T, 3), newton")
    flights, steps = shape[:2]
    place = np.tile([0.0, 0.0, 100.0], (flights, 1, 1))  # where no ground is near
    physics = BatchPhysics((vehicle,), flights, "none")
    controller = TrackingController((vehicle,), flights, config)
    setpoint = Setpoint.hold(place)
    state = physics.reset(hover_state((vehicle,), place + np.asarray(position_error)))
    found = np.empty((flights, steps + 1, 3))
    found[:, 0] = position_error
    for k in range(steps):
        commands = controller.commands(state, setpoint, -errors[:, None, k])
        state = physics.step(commands)
        found[:, k + 1] = (state.position - place)[:, 0]
    return found


def _settings(options: Any) -> dict[str, Any]:
    return {
        "seed": options.seed,
        "episodes": options.episodes or _EPISODES,
        "vehicle": SMALL.token,
        "error_rate_g_per_s": _RATE_G,
        "random_error_g": _SIZE_G,
        "duration_s": _DURATION_S,
    }


def _grid(options: Any) -> Cells:
    """Errors planted on point mass and quadrotor with each set of gains; the included one flown."""
    own = (options.seed, options.episodes or _EPISODES)
    jobs: dict[str, Callable[[], Cell]] = {
        name: partial(measure_ball, name, *own) for name in GAINS
    }
    return jobs | {"shipped belief": partial(_measure_belief, *own)}


def measure_ball(name: str, seed: int, flights: int) -> Cell:
    """Fly one set of gains: the bound, and the largest errors that were found."""
    gains, mass, steps = GAINS[name], SMALL.mass, round(_DURATION_S / TIME_STEP)
    clamped, rate = ControllerConfig(gains), _RATE_G * GRAM_FORCE
    free, ball = theorem.without_clamp(clamped), theorem.error_ball(gains, mass, rate)
    worst = growing_error(steps, rate)
    rng = np.random.default_rng(seed)
    drawn = random_errors(rng, flights, steps, _SIZE_G * GRAM_FORCE, rate)
    point = _norms([theorem.fly_point_mass(SMALL, free, e, TIME_STEP, _START) for e in drawn])
    point_worst = _norms([theorem.fly_point_mass(SMALL, free, worst, TIME_STEP)])[0]
    time = np.arange(steps + 1) * TIME_STEP
    envelope = theorem.error_envelope(gains, mass, rate, time, _START)
    quadrotor = {
        key: (_norms(fly_quadrotors(SMALL, config, worst[None]))[0],
              _norms(fly_quadrotors(SMALL, config, drawn, _START)))
        for key, config in (("free", free), ("clamped", clamped))
    }  # fmt: skip
    late = time >= 0.5 * _DURATION_S
    row = {
        "ball_cm": 100.0 * ball.radius,
        "rate_per_s": ball.rate,
        "point_growing_cm": 100.0 * point_worst.max(),
        "point_random_cm": 100.0 * point[:, late].max(),
        "point_over_envelope": float((point / envelope).max()),
        "quadrotor_growing_cm": 100.0 * quadrotor["free"][0].max(),
        "quadrotor_random_cm": 100.0 * quadrotor["free"][1][:, late].max(),
        "quadrotor_over_envelope": float((quadrotor["free"][1] / envelope).max()),
        "clamp_holds_g": theorem.integral_force(clamped, mass) / GRAM_FORCE,
        "clamped_growing_cm": 100.0 * quadrotor["clamped"][0].max(),
        "clamped_random_cm": 100.0 * quadrotor["clamped"][1][:, late].max(),
        "clamped_bound_cm": 100.0 * theorem.clamped_radius(clamped, mass, -worst[-1, 2]),
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
        "curves": {key: np.round(c[..., ::_SHOWN], 6).tolist() for key, c in curves.items()},
    }


def _measure_belief(seed: int, flights: int) -> Cell:
    """What the bounds say of the belief that ships, and what is flown: L2S, default gains."""
    controller = ControllerConfig(feedforward=load_belief())
    test = replace(swap_test(TEAM, truth=TRUTH), decision_rate=PHYSICS_RATE)
    flown = fly(test, controller, frozen_seeds(seed, flights))
    error = (flown.force - flown.believed)[:, 1:, -1]
    size = float(np.linalg.norm(error, axis=-1).max())
    rate = float(np.linalg.norm(np.diff(error, axis=1), axis=-1).max() / TIME_STEP)
    return {
        "error_g": round(size / GRAM_FORCE, 3),
        "error_rate_g_per_s": round(rate / GRAM_FORCE, 2),
        "ball_cm": round(100.0 * theorem.error_ball(controller.gains, SMALL.mass, rate).radius, 2),
        "clamped_bound_cm": round(100.0 * theorem.clamped_radius(controller, SMALL.mass, size), 2),
        "flown_cm": round(100.0 * float(flown.worst_height_error[:, -1].max()), 2),
    }


def _norms(errors: list[FloatArray] | FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.asarray(errors), axis=-1))


def _report(options: Any, cells: Mapping[str, Cell]) -> Report:
    rows = [{"gains": name, **cells[name]["row"]} for name in GAINS]
    summary = {**_settings(options), "rows": rows, "shipped_belief": cells["shipped belief"]}
    draw = partial(_plot, rows=rows, curves=cells["mid"]["curves"])
    return Report(summary, _text(summary), rows, {"ball.png": draw})


def _text(summary: Mapping[str, Any]) -> str:
    """The bound and what was found."""
    plants = {"point": "point mass", "quadrotor": "quadrotor", "clamped": "quadrotor, clamp"}
    kinds = [(key, kind) for key in plants for kind in ("growing", "random")]
    lines = [("gains", "ball, eq. (23)", *(f"{plants[key]}, {kind}" for key, kind in kinds))]
    for row in summary["rows"]:
        found = (f"{row[f'{key}_{kind}_cm']:.2f}" for key, kind in kinds)
        lines.append((row["gains"], f"{row['ball_cm']:.2f}", *found))
    found = summary["shipped_belief"]
    error = f"{found['error_g']:.2f} g and {found['error_rate_g_per_s']:.1f} g/s"
    return "\n".join(
        [
            f"Position error (cm), model error changing by {_RATE_G:g} g/s, growing to "
            f"{_RATE_G * _DURATION_S:g} g or random within {_SIZE_G:g} g",
            *format_columns(lines),
            f"belief that ships, L2S: error up to {error}; eq. (23) allows "
            f"{found['ball_cm']:.0f} cm, its size {found['clamped_bound_cm']:.1f} cm; flown "
            f"{found['flown_cm']:.1f} cm",
        ]
    )


_PLANTS = (
    ("point_growing", "#0072B2", "point mass"),
    ("quadrotor_growing", "#009E73", "quadrotor, integral free"),
    ("clamped_growing", "#D55E00", "quadrotor, integral clamped"),
)
# They lie on each other.
_LINES: tuple[dict[str, Any], ...] = ({"linewidth": 3.0}, {"linestyle": "--"}, {})


def _plot(
    path: Path, rows: Sequence[Mapping[str, Any]], curves: Mapping[str, Sequence[Any]]
) -> None:
    """Random and worst errors over time, gains mid, and the balls of all gains."""
    headline = "Theorem 5: the ball of the position error under a planted model error"
    with picture(path, 14.0, 4.4, headline) as figure:
        envelope, growing, balls = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.25])
        mid = next(row for row in rows if row["gains"] == "mid")
        time = np.array(curves["time_s"])
        for k, own in enumerate(curves["point_random_m"]):
            label = "point mass, random errors" if k == 0 else None
            envelope.plot(
                time, 100.0 * np.array(own), color=_PLANTS[0][1], linewidth=0.9, label=label
            )
        bound = 100.0 * np.array(curves["envelope_m"])
        envelope.plot(time, bound, color=INK, linewidth=1.8, label="bound on the way there")
        for (key, color, label), line in zip(_PLANTS, _LINES, strict=True):
            error = 100.0 * np.array(curves[f"{key}_m"])
            growing.plot(time, error, color=color, label=label, **line)
        for axis, title in ((envelope, "Random errors, gains mid"), (growing, "Worst error")):
            axis.axhline(mid["ball_cm"], color=GREY, linestyle=":", label="ball, eq. (23)")
            label_axis(axis, title, "Time (s)", "Position error (cm)", legend=8)
        growing.set_ylim(0.0, 3.2 * mid["ball_cm"])
        drawn = (("ball", "#B8BEC5", "ball, eq. (23)"), *_PLANTS)
        series = [([row[f"{key}_cm"] for row in rows], color, label) for key, color, label in drawn]
        draw_numbered_bars(balls, [row["gains"] for row in rows], series)
        balls.legend(fontsize=8, ncols=2, loc="upper center")
        balls.set_ylim(1.0, 500.0)
        label_axis(balls, "Worst error, by gains", "", "Largest error (cm)", grid="y")


BALL = Study(
    paper="neural-swarm2",
    name="study-ball",
    label="Theorem 5",
    shows="the ball of the position error under a planted model error",
    takes=("episodes",),
    grid=_grid,
    settings=_settings,
    report=_report,
)
"""Each set of gains, and the belief that ships."""
