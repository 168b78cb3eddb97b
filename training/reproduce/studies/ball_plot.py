"""Theorem 5 as a picture: errors under their envelope, and the ball beside what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.training.reproduce.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINT, _QUADROTOR, _CLAMPED = "#0072B2", "#009E73", "#D55E00"


def plot_ball(
    path: Path, rows: Sequence[Mapping[str, Any]], curves: Mapping[str, Sequence[Any]]
) -> None:
    """Draw random and worst errors over time, gains mid, and the balls of all gains.

    Args:
        path: the picture to write.
        rows: as `reproduce_ball` returns them.
        curves: of gains mid, as `measure` returns them.
    """
    headline = "Theorem 5: the ball of the position error under a planted model error"
    with picture(path, 14.0, 4.4, headline) as figure:
        envelope, growing, balls = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.25])
        mid = next(row for row in rows if row["gains"] == "mid")
        time = np.array(curves["time_s"])
        for k, own in enumerate(curves["point_random_m"]):
            label = "point mass, random errors" if k == 0 else None
            envelope.plot(time, 100.0 * np.array(own), color=_POINT, linewidth=0.9, label=label)
        bound = 100.0 * np.array(curves["envelope_m"])
        envelope.plot(time, bound, color=INK, linewidth=1.8, label="bound on the way there")
        growing.plot(time, 100.0 * np.array(curves["point_growing_m"]), color=_POINT,
                     linewidth=3.0, label="point mass")  # fmt: skip
        growing.plot(time, 100.0 * np.array(curves["quadrotor_growing_m"]), "--",
                     color=_QUADROTOR, label="quadrotor, integral free")  # fmt: skip
        growing.plot(time, 100.0 * np.array(curves["clamped_growing_m"]), color=_CLAMPED,
                     label="quadrotor, integral clamped")  # fmt: skip
        for axis, title in ((envelope, "Random errors, gains mid"), (growing, "Worst error")):
            axis.axhline(mid["ball_cm"], color=GREY, linestyle=":", label="ball, eq. (23)")
            axis.set(xlabel="Time (s)", ylabel="Position error (cm)", title=title)
            axis.legend(fontsize=8)
            axis.grid(True)
        growing.set_ylim(0.0, 3.2 * mid["ball_cm"])
        _balls(balls, rows)


def _balls(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    drawn = (
        ("ball_cm", "#B8BEC5", "ball, eq. (23)"),
        ("point_growing_cm", _POINT, "point mass"),
        ("quadrotor_growing_cm", _QUADROTOR, "quadrotor, integral free"),
        ("clamped_growing_cm", _CLAMPED, "quadrotor, integral clamped"),
    )
    for k, (key, color, label) in enumerate(drawn):
        place = np.arange(len(rows)) + 0.2 * (k - 1.5)
        height = [row[key] for row in rows]
        axis.bar(place, height, 0.19, color=color, label=label)
        for x, y in zip(place, height, strict=True):
            axis.text(x, 1.04 * y, f"{y:.1f}", ha="center", va="bottom", fontsize=8, color=INK)
    axis.set_yscale("log")
    axis.set_ylim(1.0, 500.0)
    axis.set_xticks(range(len(rows)), [row["gains"] for row in rows])
    axis.set(ylabel="Largest error (cm)", title="Worst error, by gains")
    axis.legend(fontsize=8, ncols=2, loc="upper center")
    axis.grid(True, axis="y")
