"""Fig. 8 as a picture: box plots of worst height errors, both controllers side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.training.reproduce.flight_cases import PLAIN_SWAPS, Case
from swarm_envs.training.reproduce.flown import Flown
from swarm_envs.training.reproduce.style import GREY, INK, picture
from swarm_envs.viewing.comparison import COMPENSATED_COLOR, WITHOUT_COLOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OFFSET, _WIDTH = 0.19, 0.32
_APART = 0.7
"""Room between plain cases and those with stronger motors."""


def plot_swaps(
    path: Path,
    report: Mapping[str, Any],
    cases: Sequence[Sequence[Case]],
    flown: Sequence[Sequence[Flown]],
) -> None:
    """Draw one row of boxes for each force that blew.

    Args:
        path: the picture to write.
        report: of the flights, as `flight_tests` makes it.
        cases: of each force.
        flown: the flights of each of them.
    """
    names = [case.name for case in cases[0]]
    width = max(6.0, 2.0 + 0.75 * len(names))
    headline = "Stacked swaps: worst height error of the lowest drone"
    with picture(path, width, 1.2 + 3.1 * len(cases), headline) as figure:
        axes = figure.subplots(len(cases), 1, sharex=True, squeeze=False)[:, 0]
        for axis, air, own, found in zip(axes, report["truths"], cases, flown, strict=True):
            _boxes(axis, names, [f.judged_cm(c.judged) for c, f in zip(own, found, strict=True)])
            _paper(axis, names, own)
            _doubtful(axis, names, air["cases"])
            axis.set_title(f"Environment with the force model {air['truth']['name']!r}")
            axis.set_ylabel("worst height error, cm")
        _legend(figure, report["episodes"])


def _places(names: Sequence[str]) -> list[float]:
    return [k + _APART * (name not in PLAIN_SWAPS) for k, name in enumerate(names)]


def _boxes(axis: Axes, names: Sequence[str], errors: Sequence[np.ndarray]) -> None:
    places = np.array(_places(names))
    line = {"color": INK, "linewidth": 0.9}
    sides = (WITHOUT_COLOR, -_OFFSET), (COMPENSATED_COLOR, _OFFSET)
    for k, (color, offset) in enumerate(sides):
        axis.boxplot(
            [error[k] for error in errors],
            positions=list(places + offset),
            widths=_WIDTH,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": color, "edgecolor": color, "linewidth": 1.2},
            medianprops={"color": INK, "linewidth": 1.6},
            whiskerprops=line,
            capprops=line,
            flierprops={"marker": "o", "markersize": 2.5, "markeredgecolor": GREY},
        )
    axis.set_xticks(places, names)
    axis.set_xlim(places[0] - 0.6, places[-1] + 0.6)
    axis.set_ylim(bottom=0.0)
    axis.grid(True, axis="y")


def _paper(axis: Axes, names: Sequence[str], cases: Sequence[Case]) -> None:
    """Mark the medians that the paper gives."""
    for place, case in zip(_places(names), cases, strict=True):
        if case.paper_cm:
            places = [place - _OFFSET, place + _OFFSET]
            axis.plot(places, case.paper_cm, "D", color="white", markeredgecolor=INK, zorder=6)


def _doubtful(axis: Axes, names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Say under a case that its difference may be chance."""
    for place, row in zip(_places(names), rows, strict=True):
        if not row["significant"]:
            axis.annotate("n. s.", (place, 1.0), xycoords=("data", "axes fraction"), ha="center",
                          va="top", fontsize=8, color=GREY)  # fmt: skip


def _legend(figure: Figure, episodes: int) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=WITHOUT_COLOR, label="without compensation"),
        Patch(facecolor=COMPENSATED_COLOR, label="with compensation"),
        Line2D([], [], color="white", marker="D", markeredgecolor=INK, linestyle="",
               label="the paper's medians"),
    ]  # fmt: skip
    title = f"{episodes} swaps each: median, quartiles, whiskers of 1.5 quartile distances"
    figure.legend(handles=handles, loc="outside lower center", ncols=3, title=title,
                  title_fontsize=9)  # fmt: skip
