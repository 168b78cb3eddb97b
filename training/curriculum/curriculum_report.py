"""What a curriculum reports: the share of the true force that is explained, table, picture.

The truth, an environment's own model, is asked here alone: for the report, never for a fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.belief.feedforward import SwapTrial, fly_swaps
from swarm_envs.training.force_model.explained import explained_variance
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOALS = {2: 0.85, 3: 0.85, 5: 0.70}
"""Share of the variance of f_a,z that a model is to explain, by number of drones."""
FIRST_SEED = 50_000  # Of the episodes


Unseen = dict[str, Any]
"""How well the models of the rounds explain the true force on the swaps of a team."""


def evaluate_unseen(
    models: Sequence[InteractionModel], truth: InteractionModel, team: str, episodes: int
) -> Unseen:
    """Compare the models of the rounds with the truth on swaps, flown with the last of them."""
    trial = SwapTrial(team, StackedLayout(), episodes)
    controller = ControllerConfig(feedforward=models[-1])
    flights = fly_swaps(trial, controller, truth, FIRST_SEED)
    flying = np.arange(1, len(flights.time)) < flights.samples[:, None] - 1
    position, velocity = flights.position[:, 1:][flying], flights.velocity[:, 1:][flying]
    true = truth.forces(position, velocity, team) / GRAM_FORCE
    found = [model.forces(position, velocity, team) / GRAM_FORCE for model in models]
    return {
        "team": team,
        "drones": len(parse_team(team)),
        "episodes": episodes,
        "crashed": int(flights.crashed.sum()),
        "rms_force_g": round(float(np.sqrt(np.mean(true[..., 2] ** 2))), 3),
        "rms_error_g": round(float(np.sqrt(np.mean((found[-1] - true)[..., 2] ** 2))), 3),
        # By round; the models have linear drag alone in the horizontal.
        "explained": [
            round(explained_variance(model, truth, position, velocity, team), 4) for model in models
        ],
        "explained_horizontal": [round(horizontal_share(force, true), 4) for force in found],
    }


def horizontal_share(found: FloatArray, true: FloatArray) -> float:
    """Share of the variance of the true horizontal force (T, N, 3) that another explains."""
    error = (found - true)[..., :2]
    variance = float(true[..., :2].var(axis=(0, 1)).sum())
    return 1.0 - float(np.mean(error**2, axis=(0, 1)).sum()) / variance if variance > 0 else 0.0


def _by_size(unseen: Sequence[Unseen]) -> dict[int, tuple[float, float]]:
    """Mean and least share of the last model over the teams of each number of drones."""
    return {
        size: (float(np.mean(shares)), min(shares))
        for size in GOALS
        if (shares := [u["explained"][-1] for u in unseen if u["drones"] == size])
    }


class CurriculumReport(dict[str, Any]):
    """The content of `curriculum.json`."""

    def lines(self) -> list[str]:
        """What the command prints."""
        return [rounds_table(self["rounds"], self["unseen"]), ""] + [
            f"{size} drones: {100 * mean:.1f} % of the variance of the true f_a,z on unseen swaps "
            f"(least of the teams {100 * least:.1f} %; goal {100 * GOALS[size]:.0f} %)"
            for size, (mean, least) in _by_size(self["unseen"]).items()
        ]


def sizes_as_json(unseen: list[Unseen]) -> dict[str, dict[str, float]]:
    """Mean, least and goal by number of drones."""
    return {
        str(size): {"mean": round(mean, 4), "least": least, "goal": GOALS[size]}
        for size, (mean, least) in _by_size(unseen).items()
    }


def goals_reached(unseen: list[Unseen]) -> bool:
    """Whether every team of each number of drones reaches the goal."""
    return all(least >= GOALS[size] for size, (_, least) in _by_size(unseen).items())


def rounds_table(rounds: Sequence[Mapping[str, Any]], unseen: list[Unseen]) -> str:
    """The rounds as a table, plain text."""
    head = ("round", "planned", "gap error", "clearance", "distance", "cut", "rows", "val. MSE")
    units = ("", "cm", "cm", "flown, cm", "/ radii", "", "", "g^2 (zero)")
    shares = [f"{size} drones" for size in GOALS]
    lines = [(*head, *shares), (*units, *("% of f_z" for _ in shares))]
    for k, r in enumerate(rounds):
        c = r["closeness"]
        by_size = [[u["explained"][k] for u in unseen if u["drones"] == size] for size in GOALS]
        means = [float(np.mean(own)) if unseen else np.nan for own in by_size]
        lines.append(
            (
                f"{r['number']} {r['title']}",
                f"{100 * r['clearance_m']:.1f}",
                f"{100 * c.gap_error_m:.1f}",
                f"{100 * c.least_clearance_m:.1f}",
                f"{c.least_distance_ratio:.2f}",
                f"{c.cut_swaps + c.cut_walks}/{c.flights}",
                str(r["rows"]),
                f"{r['validation_mse']:.2f} ({r['zero_mse']:.1f})",
                *(f"{100 * mean:.1f}" for mean in means),
            )
        )
    return "\n".join(line.rstrip() for line in format_columns(lines, rule=False))


def draw_curriculum(report: CurriculumReport, path: Path) -> None:
    """Draw the rounds and write the picture, whole, to `path` (PNG, PDF or SVG)."""
    headline = f"Curriculum in an environment with the force model {report['interactions']!r}"
    with picture(path, 12.0, 4.0, headline) as figure:
        left, middle, right = figure.subplots(1, 3)
        _closeness(left, report)
        _errors(middle, report)
        _explained(right, report)
        for axis in (left, middle, right):
            axis.set_xticks([r["number"] for r in report["rounds"]])
            axis.set_xlabel("round")
            axis.grid(axis="y")


_BLUE, _ORANGE, _GREEN = "#0072B2", "#D55E00", "#009E73"


def _closeness(axis: Axes, report: CurriculumReport) -> None:
    number = [r["number"] for r in report["rounds"]]
    planned = [100 * r["clearance_m"] for r in report["rounds"]]
    flown = [100 * r["closeness"].least_clearance_m for r in report["rounds"]]
    error = [100 * r["closeness"].gap_error_m for r in report["rounds"]]
    axis.plot(number, planned, "o-", color=INK, label="least planned")
    axis.plot(number, flown, "s--", color=_BLUE, label="least flown")
    axis.plot(number, error, "^:", color=_ORANGE, label="error of the gap (95 %)")
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set_ylabel("vertical clearance of two spheres, cm")
    axis.set_title("How close drones flew")
    axis.legend(fontsize=9)


def _errors(axis: Axes, report: CurriculumReport) -> None:
    number = np.array([r["number"] for r in report["rounds"]])
    zero = [r["zero_mse"] for r in report["rounds"]]
    model = [r["validation_mse"] for r in report["rounds"]]
    axis.bar(number - 0.2, zero, 0.38, color="#C9CDD2", label="no model")
    axis.bar(number + 0.2, model, 0.38, color=_BLUE, label="model of the round")
    for x, value in zip(number + 0.2, model, strict=True):
        axis.annotate(f"{value:.2f}", (x, value), ha="center", va="bottom", fontsize=9)
    axis.set_ylabel("MSE of $f_{a,z}$ on held-out flights, g²")
    axis.set_title("Validation, noisy labels")
    axis.legend(fontsize=9)


def _explained(axis: Axes, report: CurriculumReport) -> None:
    number = [r["number"] for r in report["rounds"]]
    for size, color in zip(GOALS, (_BLUE, _GREEN, _ORANGE), strict=True):
        shares = np.array([u["explained"] for u in report["unseen"] if u["drones"] == size])
        if not len(shares):
            continue
        axis.plot(number, 100 * shares.mean(axis=0), "o-", color=color, label=f"{size} drones")
        low, high = 100 * shares.min(axis=0), 100 * shares.max(axis=0)
        axis.fill_between(number, low, high, color=color, alpha=0.15, linewidth=0)
    for goal in sorted(set(GOALS.values())):
        axis.axhline(100 * goal, color=GREY, linewidth=0.9, linestyle="--")
        axis.annotate(
            f"goal {100 * goal:.0f}",
            (0.99, 100 * goal),
            xycoords=axis.get_yaxis_transform(),  # right margin
            ha="right",
            va="center",
            fontsize=8,
            color=INK,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
            zorder=5,
        )
    axis.set_ylim(bottom=max(0.0, axis.get_ylim()[0]), top=101)
    axis.set_ylabel("% of the variance of the true $f_{a,z}$")
    axis.set_title("Unseen swaps (band: all teams)")
    axis.legend(fontsize=9, loc="lower right")
