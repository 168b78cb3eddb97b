"""Options of a fit, readable where torch is not installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import tyro

from swarm_envs.errors import check_bool, check_integer, check_name, check_number, check_type
from swarm_envs.training.flight_logs.log_options import LogOptions

__all__ = ["REPORTS", "FitConfig", "TrainConfig"]


@dataclass(frozen=True)
class TrainConfig:
    """Options of the training of a force network."""

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

    def __post_init__(self) -> None:
        """Raise ValueError if an option has an invalid value."""
        for name in ("steps", "batch_size"):
            check_integer(name, getattr(self, name), at_least=1)
        for name in ("learning_rate", "max_spectral_norm"):
            check_number(name, getattr(self, name), above=0.0)
        check_name("spectral", self.spectral, ("clip", "exact", "none"))
        check_number("balance", self.balance, at_least=0.0)
        check_integer("seed", self.seed, at_least=0)


Mode = Literal["anchored", "measured"]
"""Model that is fitted: that of environments, or the paper's on the labels as measured."""
Model = Literal["deep-set", "composed", "wake"]  # Kind of the fitted function

WEIGHTS = {
    "composed": "composed.safetensors",
    "deep-set": "learned.safetensors",
    "wake": "wake.json",
}
"""File of the fitted model, by kind; `swarm_envs.interactions.load` reads it."""
REPORTS = {"composed": "composed.json", "deep-set": "learned.json", "wake": "wake-fit.json"}
"""File of the report, by kind."""


@dataclass(frozen=True, kw_only=True)
class FlightData:
    """The flight data of a fit."""

    data: Path
    """Flight log (.csv or .parquet, in the format of docs/flight-logs.md), folder of logs or of
    `swarm-envs collect`, or table of rows: the published flights, or a file of `save_rows`
    (.npz)."""


@dataclass(frozen=True, kw_only=True)
class FitFiles(FlightData):
    """The required options of a fit; fields of the last base class come first in the help."""

    out: Path
    """Output folder for the model and its report: learned.safetensors and learned.json of a
    `deep-set`, composed.safetensors and composed.json, or wake.json and wake-fit.json."""


@dataclass(frozen=True, kw_only=True)
class FitConfig(TrainConfig, FitFiles):
    """Fit a model of the interaction forces to flight logs or to rows of measured force.

    Columns of a flight log, SI units, world frame: time (s), drone, type (S, L or S*), x y z (m),
    vx vy vz (m/s), qx qy qz qw, ax ay az (m/s^2, +9.81 in hover; optional), pwm1 to pwm4 (0 to
    65535), voltage (V).
    """

    model: Model = "deep-set"
    """Force model: `deep-set` (eq. 10 of Neural-Swarm2); `composed`, a wake model plus a network
    per pair of vehicle types, whose forces stay physical for any number of neighbors; or `wake`, a
    closed form that is fitted by least squares."""
    mode: Mode = "anchored"
    """`anchored` fits a model for environments: zero force on a lone drone aloft, smooth cut-off of
    distant neighbors, inputs clamped to the data's range; `measured` fits the paper's model to the
    labels as they are, with all neighbors."""
    offsets: Literal["estimated", "none"] = "estimated"
    """Calibration offsets that `anchored` subtracts from the labels; `none` for exact labels."""
    anchor_height_m: tyro.conf.Suppress[float] = 0.6
    """Height above which the force on a lone drone is zero in an anchored fit, m."""
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

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values and for contradictory options."""
        super().__post_init__()
        check_name("model", self.model, get_args(Model))
        check_name("mode", self.mode, get_args(Mode))
        check_name("offsets", self.offsets, ("estimated", "none"))
        check_number("anchor_height_m", self.anchor_height_m, above=0.0, unit="m")
        check_integer("hidden", self.hidden, at_least=1)
        check_integer("layers", self.layers, at_least=2)
        for name in ("relative_velocity", "torque", "progress"):
            check_bool(name, getattr(self, name))
        check_type("logs", self.logs, LogOptions)
        if self.model == "composed" and self.mode == "measured":
            raise ValueError("--model composed is for environments; use it with --mode anchored")
        if self.torque and self.model != "deep-set":
            raise ValueError(f"--model {self.model} has no torque; use --torque with deep-set")

    def how_to_use(self) -> list[str]:
        """Return lines that explain the use of the fitted model."""
        path = self.out / WEIGHTS[self.model]
        return [
            f"fly it: swarm-envs fly --interactions {path}",
            f'in Python: swarm_envs.make("swap_v1", interactions="{path}")',
        ]


FITTED = ("composed", "wake")
"""Force models that are refitted to flights other than those on which they are evaluated."""


@dataclass(frozen=True, kw_only=True)
class ResidualConfig(FlightData):
    """Identify the residual force of a model: the measured force that it does not explain.

    The result is the random force of `world="hall"`: see docs/hall.md.
    """

    out: Path
    """The output folder for `residual.json`."""
    force: str = "composed"
    """The force model: `composed` (that of the environments) or `wake`, refitted for each fold of
    the flights; or the file of a model, whose error is too small on the flights that it was fitted
    to."""
    folds: int = 5
    """The number of folds of cross-validation into which the flights of each scenario are split."""
    steps: int = FitConfig.steps
    """The number of optimizer steps of each fit."""
    bootstrap: int = 400
    """The number of bootstrap samples for the 95 % intervals."""
    seed: int = 0
    """The random seed."""
    progress: bool = True
    """Show a progress bar while logs are read."""
    json: Path | None = None
    """Also write the report to this file."""
    logs: LogOptions = LogOptions()
    """Options of the conversion of flight logs to rows."""

    def __post_init__(self) -> None:
        """Raise ValueError if an option has an invalid value."""
        check_integer("folds", self.folds, at_least=2)
        for name in ("steps", "bootstrap"):
            check_integer(name, getattr(self, name), at_least=1)
        check_integer("seed", self.seed, at_least=0)
        check_bool("progress", self.progress)
        check_type("logs", self.logs, LogOptions)
