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
from typing import Any

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.forces import force_on_ego_g

GROUND, VERTICAL, LATERAL = "ground", "vertical", "lateral"
"""Kinds of bins: over height, over the distance below, over the distance beside."""
KINDS = {
    "ground: f vs z, |v|<0.3": GROUND,
    "one neighbour: f vs dz": VERTICAL,
    "one above dz in[.2,.4): f vs lateral, by rel speed": LATERAL,
}
"""The table's cases by what we call them."""
COLUMNS = ("case", "scenario", "bin_lo", "bin_hi", "n", "fa_delay_mean", "fa_delay_std", "extra")
"""Columns of the table of bins."""

ALOFT_M = 0.3
"""Height from which a bin of a lone drone counts as far from the ground."""
CRUISE_M = 1.0
"""Height at which pairs are predicted; the bins do not say theirs."""
_POINTS = 5


@dataclass(frozen=True)
class Bin:
    """One bin; forces in gram-force, up positive."""

    kind: str
    """`ground`, `vertical` or `lateral`."""
    scenario: str
    """`L2S`: a large neighbour, the force on a small drone; `Ge2S`: alone."""
    low: float
    """Lower edge, m."""
    high: float
    """Edges of height, vertical distance (neighbour above: positive) or lateral distance, m."""
    second: tuple[float, float] | None
    """Edges of lateral distance (m) or relative speed (m/s)."""
    rows: int
    """Rows in it."""
    measured_g: float
    """Mean of the measured force, g."""
    spread_g: float
    """Standard deviation of the rows in the bin."""
    predicted_g: float = 0.0
    """Mean of the predicted force on the same rows, g."""

    @property
    def middle(self) -> float:
        """Middle of the bin, m."""
        return (self.low + self.high) / 2

    @property
    def is_baseline(self) -> bool:
        """Whether nothing is expected to be felt here."""
        return self.low >= ALOFT_M if self.kind == GROUND else self.high <= 0.0


def read_bins(path: str | os.PathLike[str]) -> list[Bin]:
    """Read a table of bins.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a column is missing, a case is unknown, or an entry is no number.
    """
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


def _bin(line: dict[str, str]) -> Bin:
    kind = KINDS[check_name("case", line["case"], KINDS)]
    check_name("scenario", line["scenario"], _scenarios(kind))
    edges = re.findall(r"[\d.]+", line["extra"])
    try:
        numbers = [float(line[name]) for name in COLUMNS[2:7]]
        second = (float(edges[0]), float(edges[1])) if edges else None
    except (ValueError, IndexError) as error:
        raise ValueError(f"the bin {line} holds what is no number ({error}); mend it") from error
    if (second is None) != (kind == GROUND):
        raise ValueError(f"the bin {line} needs a range like 'lat[0,0.05)' in `extra`; mend it")
    low, high, rows, mean, spread = numbers
    return Bin(kind, line["scenario"], low, high, second, int(rows), mean, spread)


def _scenarios(kind: str) -> tuple[str, ...]:
    return ("Ge2S", "Ge2L") if kind == GROUND else ("S2S", "S2L", "L2S", "L2L")


def predict_bins(model: InteractionModel, bins: Sequence[Bin]) -> list[Bin]:
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
                f"scenario {scenario!r} has no bin far from every effect (aloft from {ALOFT_M} m, "
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


def _predict(model: InteractionModel, b: Bin) -> float:
    along = _points(b.low, b.high)
    if b.second is None:
        position = np.zeros((_POINTS, 1, 3))
        position[:, 0, 2] = along
        return float(force_on_ego_g(model, [b.scenario[-1]], position).mean())
    turn = np.arange(8) * np.pi / 4
    if b.kind == VERTICAL:
        vertical, lateral, speed = along, _points(*b.second), np.zeros(1)
    else:
        vertical, lateral, speed = _points(0.2, 0.4), along, np.array([sum(b.second) / 2])
    heading = turn if b.kind == LATERAL else turn[:1]
    grid = np.meshgrid(vertical, lateral, turn, speed, heading, indexing="ij")
    dz, r, angle, v, way = (a.ravel() for a in grid)
    position, velocity = np.zeros((2, len(dz), 2, 3))
    position[:, 0, 2] = CRUISE_M
    position[:, 1] = np.stack([r * np.cos(angle), r * np.sin(angle), CRUISE_M + dz], axis=1)
    velocity[:, 1, :2] = np.stack([v * np.cos(way), v * np.sin(way)], axis=1)
    team = [b.scenario[-1], b.scenario[0]]
    return float(force_on_ego_g(model, team, position, velocity).mean())


def _points(low: float, high: float) -> FloatArray:
    return low + (np.arange(_POINTS) + 0.5) / _POINTS * (high - low)


def compare(bins: Sequence[Bin]) -> dict[str, Any]:
    """Errors of predicted bins by case and scenario, weighted by rows; ready for JSON."""
    groups: dict[str, list[Bin]] = {"all": list(bins)}
    for b in bins:
        groups.setdefault(f"{b.kind} {b.scenario}", []).append(b)
    return {name: _errors(group) for name, group in groups.items()}


def _errors(bins: Sequence[Bin]) -> dict[str, float | int | None]:
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
