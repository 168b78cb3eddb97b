"""What a fit reports: errors, Lipschitz constants, bins, extremes, as JSON."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.training.flight_logs import LogReport
from swarm_envs.training.force_model.evaluate import (
    AxisBin,
    Errors,
    Extremes,
    ForceFunction,
    axis_bins,
    mean_squared_errors,
    scan_swarms,
)
from swarm_envs.training.force_model.labels import Treated
from swarm_envs.training.force_model.lipschitz import (
    LipschitzBound,
    MeasuredLipschitz,
    lipschitz_bound,
    measure_lipschitz,
)
from swarm_envs.training.force_model.network import ForceNetwork
from swarm_envs.training.force_model.torque_head import TorqueErrors
from swarm_envs.training.interaction_rows.calibration import subtract_offsets
from swarm_envs.training.interaction_rows.rows import FloatArray

_SWARM_SIZES = (2, 3, 5, 8, 16)
_SWARMS = 2000


@dataclass(frozen=True)
class Findings:
    """What was measured on the weights as they ship."""

    rows: int
    """Rows there were."""
    validation_rows: int
    """Those of them that were held out."""
    errors: Errors
    """Against labels treated as in training."""
    errors_vehicle_offsets: Errors
    """Against labels with one offset per vehicle, as if it did not drift between flights."""
    errors_raw: Errors
    """Against labels as measured."""
    lipschitz_bound: LipschitzBound | None
    """Of a network; None of the closed form."""
    lipschitz_measured: dict[str, MeasuredLipschitz]
    """By number of neighbours; empty if it was left out, or of the closed form."""
    axis_bins: list[AxisBin]
    """Measured and modelled force under one neighbour; labels treated as in training."""
    extremes: list[Extremes]
    """Largest forces in random swarms by number of drones."""


@dataclass(frozen=True)
class FitReport:
    """What was fitted and how well: the content of `learned.json`, whatever the model."""

    model: str
    """`deep-set`, `pairwise` or `wake`."""
    command: str
    """The command that was run."""
    config: object
    """Its options."""
    data_sha256: str
    """SHA-256 of the data."""
    offset_rule: str
    """How offsets were taken out of the labels, in words."""
    vehicle_offsets_g: dict[str, float]
    """Offset of each vehicle, gram-force."""
    drag: dict[str, list[float]]
    """c per type and axis, N s/m."""
    findings: Findings
    """What came out."""
    history: list[dict[str, float]]
    """Step, training loss, validation MSE and that of early validation, g^2."""
    chosen: str
    """Which weights of the run these are."""
    wall_time_s: float
    """Of this call: reading, training (if it was resumed, only what was left), evaluation."""
    logs: LogReport
    """What became of every file."""
    notes: list[str]
    """What a user of the model must know: types that no row shows."""
    torque_errors: TorqueErrors | None = None
    """On held-out rows, if there is a torque head."""

    def lines(self) -> list[str]:
        """What a command prints of it."""
        errors = self.findings.errors
        kept = self.logs.vehicles and self.offset_rule == "none"
        return [
            *self.logs.lines(),
            *(
                ["calibration offsets are not subtracted: labels are fitted as measured"]
                if kept
                else []
            ),
            *(f"note: {note}" for note in self.notes),
            f"{self.model}: validation MSE {errors.overall:.2f} g^2 (zero {errors.zero:.2f}, "
            f"scenario mean {errors.scenario_mean:.2f})",
        ]


def worth(errors: Errors) -> list[str]:
    """A note if a model is no better than one of the trivial ones."""
    trivial = {"of predicting nothing": errors.zero, "of the scenario mean": errors.scenario_mean}
    better = [f"that {name} ({e:.2f})" for name, e in trivial.items() if errors.overall >= e]
    if not better:
        return []
    return [
        f"the model explains nothing: its validation MSE {errors.overall:.2f} g^2 is not below "
        f"{' nor '.join(better)}; fly more, nearer to each other, or train for more steps"
    ]


def examine(
    function: ForceFunction,
    predicted_g: FloatArray,
    treated: Treated,
    lipschitz_samples: int,
    seed: int,
) -> Findings:
    """Measure a fitted model.

    Args:
        function: the model; Lipschitz constants are those of networks.
        predicted_g: (R,) its vertical force for every row, drag included.
        treated: the rows, and what was taken out of their labels.
        lipschitz_samples: random pairs for the Lipschitz constants; 0 leaves them out.
        seed: of the random inputs.
    """
    rng = np.random.default_rng(seed)
    rows, offsets = treated.rows, treated.offsets
    free = subtract_offsets(rows, offsets)
    measured, bound = {}, None
    if isinstance(function, ForceNetwork):
        bound = lipschitz_bound(function)
        for neighbors in (1, 2) if lipschitz_samples else ():
            found = measure_lipschitz(function, lipschitz_samples, neighbors, rng)
            measured[str(neighbors)] = found
    return Findings(
        rows=len(rows),
        validation_rows=int(rows.validation.sum()),
        errors=mean_squared_errors(predicted_g, free),
        errors_vehicle_offsets=mean_squared_errors(
            predicted_g, subtract_offsets(rows, offsets.per_vehicle())
        ),
        errors_raw=mean_squared_errors(predicted_g, rows),
        lipschitz_bound=bound,
        lipschitz_measured=measured,
        axis_bins=axis_bins(function, predicted_g, free),
        extremes=[scan_swarms(function, size, _SWARMS, rng) for size in _SWARM_SIZES],
    )
