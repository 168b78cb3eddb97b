"""Calibration: bins of measured force beside what a model predicts there.

The table has one bin a line: case, scenario, the bin's edges, number of rows, mean and standard
deviation of f_a,z in gram-force (acceleration measured, thrust lagged), and a second variable's
range. Cases: force over height alone above the ground, over a neighbour's vertical distance (by
lateral distance), over lateral distance 0.2-0.4 m below it (by relative speed).

Measured means carry the calibration error of each vehicle's mass and thrust; a fitted network may
carry it too. So of both sides the mean far from every effect is subtracted: aloft over the ground,
or above the neighbour. What remains is what the air does.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.heat_maps import force_on_ego_g
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["SCENARIO_COLORS"]

_GROUND, _VERTICAL, _LATERAL = "ground", "vertical", "lateral"
"""Kinds of bins: over height, over the distance below, over the distance beside."""
KINDS = {
    "ground: f vs z, |v|<0.3": _GROUND,
    "one neighbour: f vs dz": _VERTICAL,
    "one above dz in[.2,.4): f vs lateral, by rel speed": _LATERAL,
}
"""The table's cases by what we call them."""
COLUMNS = ("case", "scenario", "bin_lo", "bin_hi", "n", "fa_delay_mean", "fa_delay_std", "extra")
"""Columns of the table of bins."""

_ALOFT_M = 0.3  # height from which a bin of a lone drone counts as far from the ground
_CRUISE_M = 1.0  # height at which pairs are predicted; the bins do not say theirs
_POINTS = 5


@dataclass(frozen=True)
class _ForceBin:
    """One bin; forces in gram-force, up positive."""

    kind: str  # `ground`, `vertical` or `lateral`
    scenario: str  # `L2S`: a large neighbour, the force on a small drone; `Ge2S`: alone
    low: float  # lower edge, m
    high: float
    """Edges of height, vertical distance (neighbour above: positive) or lateral distance, m."""
    second: tuple[float, float] | None  # edges of lateral distance (m) or relative speed (m/s)
    rows: int  # rows in it
    measured_g: float  # mean of the measured force, g
    spread_g: float  # standard deviation of the rows in the bin
    predicted_g: float = 0.0  # mean of the predicted force on the same rows, g

    @property
    def middle(self) -> float:
        """Middle of the bin, m."""
        return (self.low + self.high) / 2

    @property
    def is_baseline(self) -> bool:
        """Whether nothing is expected to be felt here."""
        return self.low >= _ALOFT_M if self.kind == _GROUND else self.high <= 0.0


def read_bins(path: str | os.PathLike[str]) -> list[_ForceBin]:
    """Read a table of bins."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"no table of measured bins at {os.fspath(path)!r}; give its path")
    with Path(path).open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    missing = set(COLUMNS) - set(lines[0] if lines else ())
    if missing or not lines:
        raise ValueError(
            f"{os.fspath(path)!r} has {len(lines)} bins and lacks the columns "
            f"{sorted(missing)}; it must have {COLUMNS}"
        )
    return [_bin(line) for line in lines]


def _bin(line: dict[str, str]) -> _ForceBin:
    kind = KINDS[check_name("case", line["case"], KINDS)]
    check_name("scenario", line["scenario"], _scenarios(kind))
    edges = re.findall(r"[\d.]+", line["extra"])
    try:
        numbers = [float(line[name]) for name in COLUMNS[2:7]]
        second = (float(edges[0]), float(edges[1])) if edges else None
    except (ValueError, IndexError) as error:
        raise ValueError(f"the bin {line} holds what is no number ({error}); mend it") from error
    if (second is None) != (kind == _GROUND):
        raise ValueError(f"the bin {line} needs a range like 'lat[0,0.05)' in `extra`; mend it")
    low, high, rows, mean, spread = numbers
    return _ForceBin(kind, line["scenario"], low, high, second, int(rows), mean, spread)


def _scenarios(kind: str) -> tuple[str, ...]:
    return ("Ge2S", "Ge2L") if kind == _GROUND else ("S2S", "S2L", "L2S", "L2L")


def predict_bins(model: InteractionModel, bins: Sequence[_ForceBin]) -> list[_ForceBin]:
    """The same bins with the model's mean in each, both sides free of their baselines.

    A bin's mean is taken over five points along each of its edges and eight directions. Drones
    rest, but where the bin gives a relative speed: there the neighbour moves, in eight directions.
    The baseline is the mean, weighted by rows, of a scenario's bins where nothing is felt; lateral
    bins have none, and use that of the vertical ones.
    """
    raw = [replace(b, predicted_g=_predict(model, b)) for b in bins]
    baseline = {}
    for scenario in {b.scenario for b in raw}:
        far = [b for b in raw if b.scenario == scenario and b.is_baseline]
        if not far:
            raise ValueError(
                f"scenario {scenario!r} has no bin far from every effect (aloft from {_ALOFT_M} m, "
                "or above the neighbour), so its calibration error is unknown; add one"
            )
        sides = [[b.measured_g for b in far], [b.predicted_g for b in far]]
        baseline[scenario] = np.average(sides, axis=1, weights=[b.rows for b in far])
    return [
        replace(
            b,
            measured_g=float(b.measured_g - baseline[b.scenario][0]),
            predicted_g=float(b.predicted_g - baseline[b.scenario][1]),
        )
        for b in raw
    ]


def _predict(model: InteractionModel, b: _ForceBin) -> float:
    along = _points(b.low, b.high)
    if b.second is None:
        position = np.zeros((_POINTS, 1, 3))
        position[:, 0, 2] = along
        return float(force_on_ego_g(model, [b.scenario[-1]], position).mean())
    turn = np.arange(8) * np.pi / 4
    if b.kind == _VERTICAL:
        vertical, lateral, speed = along, _points(*b.second), np.zeros(1)
    else:
        vertical, lateral, speed = _points(0.2, 0.4), along, np.array([sum(b.second) / 2])
    heading = turn if b.kind == _LATERAL else turn[:1]
    grid = np.meshgrid(vertical, lateral, turn, speed, heading, indexing="ij")
    dz, r, angle, v, way = (a.ravel() for a in grid)
    position, velocity = np.zeros((2, len(dz), 2, 3))
    position[:, 0, 2] = _CRUISE_M
    position[:, 1] = np.stack([r * np.cos(angle), r * np.sin(angle), _CRUISE_M + dz], axis=1)
    velocity[:, 1, :2] = np.stack([v * np.cos(way), v * np.sin(way)], axis=1)
    team = [b.scenario[-1], b.scenario[0]]
    return float(force_on_ego_g(model, team, position, velocity).mean())


def _points(low: float, high: float) -> FloatArray:
    return low + (np.arange(_POINTS) + 0.5) / _POINTS * (high - low)


def bin_errors(bins: Sequence[_ForceBin]) -> dict[str, Any]:
    """Errors of predicted bins by case and scenario, weighted by rows; ready for JSON."""
    groups: dict[str, list[_ForceBin]] = {"all": list(bins)}
    for b in bins:
        groups.setdefault(f"{b.kind} {b.scenario}", []).append(b)
    return {name: _errors(group) for name, group in groups.items()}


def _errors(bins: Sequence[_ForceBin]) -> dict[str, float | int | None]:
    weight = np.array([b.rows for b in bins], float)
    measured = np.array([b.measured_g for b in bins])
    error = np.array([b.predicted_g for b in bins]) - measured
    variance = np.average((measured - np.average(measured, weights=weight)) ** 2, weights=weight)
    square = float(np.average(error**2, weights=weight))
    return {
        "bins": len(bins),
        "rows": int(weight.sum()),
        "root_mean_square_error_g": round(square**0.5, 3),
        "mean_error_g": round(float(np.average(error, weights=weight)), 3),
        "largest_error_g": round(float(error[np.abs(error).argmax()]), 3),
        "variance_explained": round(1.0 - square / float(variance), 3) if variance else None,
    }


SCENARIO_COLORS = {"S2S": "#0072B2", "L2S": "#D55E00", "S2L": "#009E73", "L2L": "#CC79A7"}
"""Okabe and Ito's palette, which colour-blind readers can tell apart, by scenario."""
SCENARIO_COLORS |= {"Ge2S": "#56B4E9", "Ge2L": "#E69F00"}
_PAIRS = ("S2S", "L2S", "S2L", "L2L")
_SHADES = ("#08306B", "#2171B5", "#6BAED6", "#B5C7DB")
_TITLES = {
    _GROUND: "Height above the ground",
    _VERTICAL: "Vertical distance to one neighbour",
    _LATERAL: "Lateral distance, 0.2-0.4 m below one",
}
_NAMES = {"S": "small", "L": "large"}


def plot_calibration(path: Path, bins: Sequence[_ForceBin], model: str) -> None:
    """Scatter of predicted against measured bin means, one panel a case."""
    errors = bin_errors(bins)
    ends = [value for b in bins for value in (b.measured_g, b.predicted_g)]
    low, high = min(ends) - 1.5, max(ends) + 1.5
    headline = f"Predicted and measured bin means, model {model!r}"
    with picture(path, 14.0, 5.2, headline) as figure:
        axes = figure.subplots(1, 3)
        for axis, kind in zip(axes, (_VERTICAL, _LATERAL, _GROUND), strict=True):
            _scatter(axis, [b for b in bins if b.kind == kind])
            axis.plot([low, high], [low, high], color=GREY, linewidth=1.0, zorder=1)
            limits = (low, high) if kind != _GROUND else (-1.5, 7.5)
            axis.set(xlim=limits, ylim=limits, title=_TITLES[kind], xlabel="Measured (g)")
            axis.set_aspect("equal")
            axis.grid(True)
        axes[0].set_ylabel("Predicted (g)")
        whole = errors["all"]
        figure.supxlabel(
            "Bars: spread of the rows in a bin; larger dots: more rows. Off by "
            f"{whole['root_mean_square_error_g']:.2f} g (root mean square over {whole['rows']:,} "
            "rows). Calibration offsets are subtracted.",
            fontsize=9,
        )


def _scatter(axis: Axes, bins: Sequence[_ForceBin]) -> None:
    for scenario in dict.fromkeys(b.scenario for b in bins):
        own = [b for b in bins if b.scenario == scenario]
        x, y = [b.measured_g for b in own], [b.predicted_g for b in own]
        color, spread = SCENARIO_COLORS[scenario], [b.spread_g for b in own]
        axis.errorbar(x, y, xerr=spread, fmt="none", ecolor=color, elinewidth=0.7, alpha=0.3)
        size = [8 + 14 * np.log10(max(b.rows, 10) / 10) for b in own]
        axis.scatter(x, y, size, color, label=scenario, edgecolor="white", linewidth=0.5, zorder=3)
    if bins:
        axis.legend(loc="upper left", handletextpad=0.2)


def plot_force_curves(path: Path, bins: Sequence[_ForceBin], model: str) -> None:
    """Force over vertical and lateral distance, measured with its spread and predicted."""
    headline = f"Force over distance: measured (dots) and model {model!r} (lines)"
    with picture(path, 15.0, 8.0, headline) as figure:
        grid = figure.add_gridspec(2, 5)
        for column, scenario in enumerate(_PAIRS):
            above, below = _NAMES[scenario[0]], _NAMES[scenario[-1]]
            for row, kind in enumerate((_VERTICAL, _LATERAL)):
                axis = figure.add_subplot(grid[row, column])
                _curves(axis, [b for b in bins if b.kind == kind and b.scenario == scenario], kind)
                if row == 0:
                    axis.set_title(f"{scenario}: {below} below {above}")
                if column == 0:
                    axis.set_ylabel("Vertical force (g)")
        for row, scenario in enumerate(("Ge2S", "Ge2L")):
            axis = figure.add_subplot(grid[row, 4])
            _curves(axis, [b for b in bins if b.scenario == scenario], _GROUND)
            axis.set_title(f"{_NAMES[scenario[-1]]} alone over the ground")
        figure.supxlabel(
            "Bars: standard deviation of the rows in a bin (shifted aside to be seen). Calibration "
            "offsets are subtracted.",
            fontsize=9,
        )


def _curves(axis: Axes, bins: Sequence[_ForceBin], kind: str) -> None:
    seconds = sorted({b.second or (0.0, 0.0) for b in bins})
    for order, (color, second) in enumerate(zip(_SHADES, seconds, strict=False)):
        own = sorted(
            (b for b in bins if (b.second or (0.0, 0.0)) == second), key=lambda b: b.middle
        )
        scale, unit = (100, "cm") if kind == _VERTICAL else (1, "m/s")
        label = f"{second[0] * scale:g}-{second[1] * scale:g} {unit}" if kind != _GROUND else None
        for run in _without_gaps(own):
            x, line = [b.middle for b in run], [b.predicted_g for b in run]
            axis.plot(x, line, color=color, linewidth=1.8, label=label)
            label = None
        shift = 0.0 if kind == _GROUND else 0.02 * (order - 1) * (own[-1].high - own[0].low)
        axis.errorbar(
            [b.middle + shift for b in own],
            [b.measured_g for b in own],
            [b.spread_g for b in own],
            fmt="o",
            color=color,
            markersize=4,
            markeredgecolor="white",
            markeredgewidth=0.5,
            elinewidth=0.9,
            ecolor=(color, 0.45),
            zorder=3,
        )
    across = {
        _GROUND: "Height (m)",
        _VERTICAL: "Neighbour above by (m)",
        _LATERAL: "Lateral distance (m)",
    }
    label_axis(axis, "", across[kind], zero=True)
    if kind != _GROUND and bins:
        title = "lateral distance" if kind == _VERTICAL else "relative speed"
        side: Any = "lower left" if kind == _VERTICAL else "lower right"
        axis.legend(title=title, loc=side, fontsize=8, title_fontsize=8)


def _without_gaps(bins: Sequence[_ForceBin]) -> list[list[_ForceBin]]:
    """Split sorted bins where one does not begin at the end of the last."""
    runs: list[list[_ForceBin]] = []
    for b in bins:
        if runs and abs(runs[-1][-1].high - b.low) < 1e-6:
            runs[-1].append(b)
        else:
            runs.append([b])
    return runs
