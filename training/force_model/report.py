"""What a fit reports: errors, Lipschitz constants, bins, extremes, as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.training.force_model.calibration import Offsets, subtract_offsets
from swarm_envs.training.force_model.evaluate import (
    AxisBin,
    Errors,
    Extremes,
    axis_bins,
    mean_squared_errors,
    predict_rows,
    scan_swarms,
)
from swarm_envs.training.force_model.lipschitz import (
    LipschitzBound,
    MeasuredLipschitz,
    lipschitz_bound,
    measure_lipschitz,
)
from swarm_envs.training.force_model.network import DeepSet
from swarm_envs.training.force_model.rows import InteractionRows

if TYPE_CHECKING:
    from swarm_envs.training.flight_logs import LogReport

_SWARM_SIZES = (2, 3, 5, 8, 16)
_SWARMS = 2000


@dataclass(frozen=True)
class Findings:
    """What was measured on the weights as they ship."""

    rows: int
    validation_rows: int
    errors: Errors
    """Against labels treated as in training."""
    errors_vehicle_offsets: Errors
    """Against labels with one offset per vehicle, as if it did not drift between flights."""
    errors_raw: Errors
    """Against labels as measured."""
    lipschitz_bound: LipschitzBound
    lipschitz_measured: dict[str, MeasuredLipschitz]
    """By number of neighbours; empty if it was left out."""
    axis_bins: list[AxisBin]
    """Measured and modelled force under one neighbour; labels treated as in training."""
    extremes: list[Extremes]
    """Largest forces in random swarms by number of drones."""


@dataclass(frozen=True)
class FitReport:
    """What was fitted and how well: the content of `learned.json`."""

    command: str
    config: object
    data_sha256: str
    offset_rule: str
    vehicle_offsets_g: dict[str, float]
    drag: dict[str, list[float]]
    """c per type and axis, N s/m."""
    findings: Findings
    history: list[dict[str, float]]
    """Step, training loss, validation MSE and that of early validation, g^2."""
    chosen: str
    """Which weights of the run these are."""
    wall_time_s: float
    """Of this call: reading, training (if it was resumed, only what was left), evaluation."""
    logs: LogReport | None = None
    """What became of flight logs; None where the data were rows already."""

    def lines(self) -> list[str]:
        """What a command prints of it."""
        errors = self.findings.errors
        said = self.logs.lines() if self.logs else []
        return [
            *said,
            f"validation MSE {errors.overall:.2f} g^2 (zero {errors.zero:.2f}, scenario mean "
            f"{errors.scenario_mean:.2f})",
        ]


def examine(
    network: DeepSet, rows: InteractionRows, offsets: Offsets, lipschitz_samples: int, seed: int
) -> Findings:
    """Measure a float64 network on rows whose labels are as measured.

    Args:
        network: as `load_network` returns it.
        rows: all rows, with the labels as measured.
        offsets: what training took out of the labels.
        lipschitz_samples: random pairs for the Lipschitz constants; 0 leaves them out.
        seed: of the random inputs.
    """
    rng = np.random.default_rng(seed)
    predicted = predict_rows(network, rows)
    treated = subtract_offsets(rows, offsets)
    vehicle = subtract_offsets(rows, offsets.per_vehicle())
    measured = {}
    for neighbors in (1, 2) if lipschitz_samples else ():
        measured[str(neighbors)] = measure_lipschitz(network, lipschitz_samples, neighbors, rng)
    return Findings(
        rows=len(rows),
        validation_rows=int(rows.validation.sum()),
        errors=mean_squared_errors(predicted, treated),
        errors_vehicle_offsets=mean_squared_errors(predicted, vehicle),
        errors_raw=mean_squared_errors(predicted, rows),
        lipschitz_bound=lipschitz_bound(network),
        lipschitz_measured=measured,
        axis_bins=axis_bins(network, predicted, treated),
        extremes=[scan_swarms(network, size, _SWARMS, rng) for size in _SWARM_SIZES],
    )
