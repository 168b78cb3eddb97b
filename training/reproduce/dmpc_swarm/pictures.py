"""Figures 3b, 3c and 4 as pictures, and the sweep of losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.training.reproduce.dmpc_swarm.cells import LOSSES, MODES, median_total
from swarm_envs.training.reproduce.dmpc_swarm.flights import CRASH_M, Flight
from swarm_envs.training.reproduce.runs import Cell
from swarm_envs.training.reproduce.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#0072B2", "#D55E00", "#009E73")


def plot_sequence(
    path: Path,
    headline: str,
    flights: Mapping[str, Flight],
    cells: Mapping[str, Cell],
    theirs: Mapping[str, float | None],
) -> None:
    """Draw the mean distance to the targets over time, and the times to the last arrival.

    Args:
        path: the picture to write.
        headline: above it.
        flights: one by cell.
        cells: numbers by cell.
        theirs: the public simulation's time by cell, s.
    """
    with picture(path, 11.0, 4.2, headline) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
        for (name, flight), color in zip(flights.items(), _COLORS, strict=False):
            away = np.linalg.norm(flight.position - flight.target, axis=-1).mean(axis=-1)
            left.plot(flight.time, away, color=color, label=name)
            for arrival in flight.arrivals_s:
                left.axvline(arrival, color=color, linewidth=0.7, linestyle=":")
        left.set(xlabel="Time (s)", ylabel="Mean distance to the targets (m)")
        left.set_title("Dotted: all have arrived")
        left.legend()
        left.grid(True)
        _bars(right, cells, theirs)


def _bars(axis: Axes, cells: Mapping[str, Cell], theirs: Mapping[str, float | None]) -> None:
    place = np.arange(len(cells))
    ours = [median_total(cell) or 0.0 for cell in cells.values()]
    axis.bar(place - 0.2, ours, 0.4, color=list(_COLORS[: len(cells)]), label="ours")
    known = [theirs.get(name) or 0.0 for name in cells]
    axis.bar(place + 0.2, known, 0.4, color="#C9CED4", label="public simulation")
    axis.set_xticks(place, list(cells))
    axis.set(ylabel="Time to the last arrival (s)")
    axis.legend(fontsize=8)
    axis.grid(True, axis="y")


def plot_jam(path: Path, flights: Mapping[str, Flight], jam_s: float) -> None:
    """Draw the paths seen from above, and the least distance of any two references.

    Args:
        path: the picture to write.
        flights: one by cell.
        jam_s: for how long nothing was heard, s.
    """
    config = MlrDmpcConfig()
    with picture(
        path, 12.0, 4.2, "Fig. 4: no compute unit hears anything for two seconds"
    ) as figure:
        axes = figure.subplots(1, len(flights) + 1, width_ratios=(*[1.0] * len(flights), 1.5))
        for axis, (name, flight) in zip(axes, flights.items(), strict=False):
            axis.plot(flight.position[..., 0], flight.position[..., 1], linewidth=0.8)
            axis.plot(*flight.target[0, :, :2].T, "s", markersize=4, color=GREY)
            axis.set_aspect("equal")
            axis.set(title=f"{name.split(', ')[1]}: {_outcome(flight)}", xlabel="x (m)")
        for (name, flight), color in zip(flights.items(), _COLORS, strict=False):
            label = name.split(", ")[1]
            axes[-1].plot(flight.time, flight.scaled_distance, color=color, label=label)
        axes[-1].axvspan(0.0, jam_s, color="#F1E3D3", label="jammed")
        axes[-1].axhline(config.distance_m, color=GREY, linestyle="--", linewidth=0.9)
        axes[-1].axhline(CRASH_M, color="#B00020", linestyle="--", linewidth=0.9)
        axes[-1].set(xlabel="Time (s)", ylabel="Least scaled distance (m)", ylim=(0.0, 0.5))
        axes[-1].legend(fontsize=8, title="recovery")
        axes[-1].grid(True)


def _outcome(flight: Flight) -> str:
    if flight.scaled_distance.min() < CRASH_M:
        return "crash"
    return "not all arrive" if flight.total_s is None else f"{flight.total_s:.1f} s"


def plot_losses(path: Path, cells: Mapping[str, Cell]) -> None:
    """Draw time to the last arrival and least distance over the share of messages lost.

    Args:
        path: the picture to write.
        cells: numbers by cell, named as by `loss_cells`.
    """
    with picture(path, 10.0, 4.2, "What the radio loses, and how it is met") as figure:
        left, right = figure.subplots(1, 2)
        place = np.arange(len(LOSSES))
        for mode, color in zip(MODES, _COLORS, strict=True):
            row = [cells[f"{100 * loss:g} %, {mode}"] for loss in LOSSES]
            total = [median_total(cell) for cell in row]
            least = [min(cell["least_scaled_distance_m"]) for cell in row]
            arrived = np.array([np.nan if t is None else t for t in total])
            left.plot(place, arrived, "o-", color=color, label=mode)
            right.plot(place, least, "o-", color=color, label=mode)
        left.set(ylabel="Median time to the last arrival (s)", ylim=(0.0, None))
        left.set_title("No point: half or more of the runs do not arrive")
        right.set(ylabel="Least scaled distance of any run (m)", ylim=(0.0, None))
        right.axhline(CRASH_M, color="#B00020", linestyle="--", linewidth=0.9, label="crash")
        for axis in (left, right):
            axis.set_xticks(place, [f"{100 * loss:g}" for loss in LOSSES])
            axis.set_xlabel("Messages lost (%)")
            axis.legend(fontsize=8, title="recovery")
            axis.grid(True)


def format_cells(cells: Mapping[str, Cell], theirs: Mapping[str, float | None]) -> str:
    """The numbers as text, the public simulation's beside them."""
    lines = [
        f"{'':18}{'arrived':>9}{'median s':>10}{'theirs s':>10}{'least scaled m':>16}{'crashes':>9}"
    ]
    for name, cell in cells.items():
        median, known = median_total(cell), theirs.get(name)
        runs = len(cell["total_s"])
        lines.append(
            f"{name:18}{cell['arrived']:>6}/{runs:<2}{_or_dash(median):>10}{_or_dash(known):>10}"
            f"{min(cell['least_scaled_distance_m']):>16.4f}{cell['crashes']:>9}"
        )
    return "\n".join(lines)


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def rows(
    cells: Mapping[str, Cell], theirs: Mapping[str, float | None]
) -> Sequence[dict[str, object]]:
    """One row for each run, for a table."""
    return [
        {
            "cell": name,
            "seed": seed,
            "total_s": total,
            "legs_s": " ".join(f"{leg:.1f}" for leg in legs),
            "least_scaled_distance_m": least,
            "theirs_s": theirs.get(name),
        }
        for name, cell in cells.items()
        for seed, total, legs, least in zip(
            cell["seeds"],
            cell["total_s"],
            cell["legs_s"],
            cell["least_scaled_distance_m"],
            strict=True,
        )
    ]
