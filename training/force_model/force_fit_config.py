"""Options of a fit, readable where torch is not installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import tyro

from swarm_envs.errors import check_bool, check_integer, check_name, check_number, check_type
from swarm_envs.training.flight_logs.log_options import LogOptions

__all__ = ["REPORTS", "FitConfig"]

Mode = Literal["anchored", "measured"]
"""Model that is fitted: that of environments, or the paper's on the labels as measured."""
Model = Literal["deep-set", "composed", "wake"]  # Kind of the fitted function

WEIGHTS = {
    "composed": "composed.safetensors",
    "deep-set": "deep-set.safetensors",
    "wake": "wake.json",
}
"""File of the fitted model, by kind; `swarm_envs.interactions.load` reads it."""
REPORTS = {"composed": "composed.json", "deep-set": "deep-set.json", "wake": "wake-fit.json"}
"""File of the report, by kind."""


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """Fit a model of the aerodynamic forces between drones to flight logs or measured forces.

    The command writes the model and a report of its errors. Most fits need only --data, --out,
    --model, --mode and --seed. With --residual, it fits no model but identifies the residual force,
    the part of the measured force that a model does not explain, which acts at random in the world
    `hall`.

    Columns of a flight log, SI units, world frame: time (s), drone, type (S, L or S*), x y z (m),
    vx vy vz (m/s), qx qy qz qw, ax ay az (m/s^2, +9.81 in hover; optional), pwm1 to pwm4 (0 to
    65535), voltage (V).
    """

    data: Path
    """Flight log (.csv or .parquet, in the format of docs/flight-logs.md), folder of logs or of
    `swarm-envs collect`, or table of rows: the published flights, or a file of `save_rows`
    (.npz)."""
    out: Path
    """Output folder for the model and its report: deep-set.safetensors and deep-set.json of a
    `deep-set`, composed.safetensors and composed.json, or wake.json and wake-fit.json."""
    model: Model = "deep-set"
    """Force model: `deep-set` (eq. 10 of Neural-Swarm2); `composed`, a wake model plus a network
    per pair of vehicle types, whose forces stay physical for any number of neighbors; or `wake`, a
    closed form."""
    mode: Mode = "anchored"
    """`anchored` fits a model for environments: zero force on a lone drone aloft, smooth cut-off of
    distant neighbors, inputs clamped to the data's range; `measured` fits the paper's model to the
    labels as they are, with all neighbors."""
    steps: int = 6000
    """Number of optimizer steps."""
    batch_size: int = 1024
    """Rows per optimizer step; every epoch visits all rows once, in random order."""
    learning_rate: tyro.conf.Suppress[float] = 3e-3
    """Initial learning rate of Adam; it is annealed to zero along a cosine."""
    spectral: Literal["clip", "exact", "none"] = "clip"
    """Spectral normalization of every weight matrix after each step: `clip` scales its spectral
    norm down to --max-spectral-norm if it is larger, as for the included models; `exact` sets it to
    that value, as in eq. (12) of Neural-Swarm2; `none` does not change it."""
    max_spectral_norm: float = 3.0
    """Bound on the spectral norm of a weight matrix. The paper's gamma is its fourth power. The
    networks of a composed model, which replace phi and rho, use its square."""
    balance: float = 0.0
    """Exponent from 0 to 1 that weights squared errors by the inverse mean square label of the
    drone's type; with 1, weak forces on small drones count as much as forces on large drones."""
    seed: int = 0
    """Random seed of the initial weights and all samples. The same seed gives the same weights."""
    offsets: Literal["estimated", "none"] = "estimated"
    """Calibration offsets that `anchored` subtracts from the labels; `none` for exact labels."""
    hidden: tyro.conf.Suppress[int] = 20
    """H, the length of the hidden state between phi and rho."""
    layers: tyro.conf.Suppress[int] = 4
    """L, the number of layers of every phi and rho."""
    relative_velocity: tyro.conf.Suppress[bool] = True
    """Use relative velocities as inputs of the network besides relative positions."""
    torque: bool = False
    """Fit torques with the deep set too; the rows must have torque labels."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """Also write the report to this file."""
    logs: LogOptions = LogOptions()
    """Options of the conversion of flight logs to rows of training data."""
    residual: bool = False
    """Write the statistics of the residual force of the model --force to residual.json. Used with
    --data, --out, --steps, --seed, --progress, --json, --logs.* and the options below only."""
    force: str = "composed"
    """With --residual, the force model: `composed` (that of the environments) or `wake`, refitted
    for each fold of the flights; or the file of a model, whose error is too small on flights that
    it was fitted to."""
    folds: int = 5
    """With --residual, the number of folds of cross-validation of the flights of each scenario."""
    bootstrap: int = 400
    """With --residual, the number of bootstrap samples for the 95 % intervals."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values and for contradictory options."""
        for name in ("steps", "batch_size", "bootstrap"):
            check_integer(name, getattr(self, name), at_least=1)
        for name in ("learning_rate", "max_spectral_norm"):
            check_number(name, getattr(self, name), above=0.0)
        check_name("spectral", self.spectral, ("clip", "exact", "none"))
        check_number("balance", self.balance, at_least=0.0, at_most=1.0)
        check_integer("seed", self.seed, at_least=0)
        check_name("model", self.model, get_args(Model))
        check_name("mode", self.mode, get_args(Mode))
        check_name("offsets", self.offsets, ("estimated", "none"))
        check_integer("hidden", self.hidden, at_least=1)
        check_integer("layers", self.layers, at_least=2)
        check_integer("folds", self.folds, at_least=2)
        for name in ("relative_velocity", "torque", "progress", "residual"):
            check_bool(name, getattr(self, name))
        check_type("logs", self.logs, LogOptions)
        for name in ("force", "folds", "bootstrap"):
            if not self.residual and getattr(self, name) != getattr(FitConfig, name):
                raise ValueError(f"--{name} was given, but only applies with --residual; add it")
        if self.model == "composed" and self.mode == "measured":
            raise ValueError("--model composed is for environments; use it with --mode anchored")
        if self.torque and self.model != "deep-set":
            raise ValueError(f"--model {self.model} has no torque; use --torque with deep-set")
