"""Plots of a benchmark's summary: success by task, and scores by family of tasks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarm_envs.files import written_whole

__all__ = ["plot_scores", "plot_success"]

_SHOWN = 8  # Number of plotted agents of a family, the best by score
_STYLE: Any = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.fontsize": 7,
    "font.size": 8,
    "text.parse_math": False,  # names of custom agents may contain $
}


def plot_success(path: Path, content: Mapping[str, Any]) -> None:
    """Plot success rates with Wilson's 95 % intervals by task, one panel per family."""
    families, about = content["families"], content["about"]
    cells = {(cell["task"], cell["agent"]): cell for cell in content["cells"]}
    tasks = {f: [k for k, v in about["tasks"].items() if v["family"] == f] for f in families}
    heights = [0.6 + 0.45 * len(of) for of in tasks.values()]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(8.0, sum(heights) + 0.4), layout="constrained")
        panels = figure.subplots(len(families), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axes, (family, names) in zip(panels, tasks.items(), strict=True):
            shown = _best(content, family)
            for i, agent in enumerate(shown):
                flown = [
                    (k, cells[task, agent]["values"]["success_rate"])
                    for k, task in enumerate(names)
                    if cells[task, agent]["status"] == "flown"
                ]
                places = [k + 0.7 * (i + 0.5) / len(shown) - 0.35 for k, _ in flown]
                _intervals(axes, places, [value for _, value in flown], agent)
            axes.set(title=family, xlim=(-0.02, 1.02), ylim=(len(names) - 0.5, -0.5))
            axes.set_yticks(range(len(names)), names)
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        panels[-1].set_xlabel("success rate")
        _save(figure, path)


def plot_scores(path: Path, content: Mapping[str, Any]) -> None:
    """Plot the interquartile mean and the performance profile of scores for each family."""
    families = content["families"]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 2.4 * len(families) + 0.3), layout="constrained")
        panels = figure.subplots(len(families), 2, squeeze=False)
        for (left, right), family in zip(panels, families, strict=True):
            shown = _best(content, family)
            for k, agent in enumerate(shown):
                found = families[family][agent]
                _intervals(left, [k], [found], agent)
                right.plot(content["thresholds"], found["fraction"], label=agent)
                right.fill_between(content["thresholds"], found["low"], found["high"], alpha=0.15)
            left.set(title=f"{family}: interquartile mean", xlim=(-0.02, 1.02))
            left.set_yticks(range(len(shown)), shown)
            left.invert_yaxis()
            right.set(title=f"{family}: performance profile", ylabel="fraction of episodes above")
            right.set(xlim=(0.0, 1.0), ylim=(-0.02, 1.02))
        for axes in panels[-1]:
            axes.set_xlabel("score")
        _save(figure, path)


def _best(content: Mapping[str, Any], family: str) -> list[str]:
    """Return the agents of a family with the highest scores, best first."""
    found = content["families"][family]
    return sorted(found, key=lambda name: -found[name]["value"])[:_SHOWN]


def _intervals(
    axes: Axes, places: list[float], values: list[Mapping[str, Any]], label: str
) -> None:
    """Draw values with their intervals as horizontal bars at vertical positions."""
    middle = [each["value"] for each in values]
    below = [max(0.0, each["value"] - each["interval"][0]) for each in values]
    above = [max(0.0, each["interval"][1] - each["value"]) for each in values]
    axes.errorbar(middle, places, xerr=[below, above], fmt="o", ms=3, lw=1, label=label)


def _save(figure: Figure, path: Path) -> None:
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=120)
