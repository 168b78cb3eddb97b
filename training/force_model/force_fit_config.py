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
    """The training of a network."""

    steps: int = 6000
    """optimizer steps"""
    batch_size: int = 1024
    """rows of a step; every row comes once in each pass, in random order"""
    learning_rate: tyro.conf.Suppress[float] = 3e-3
    """Adam's rate at the start; it falls to zero along a cosine"""
    spectral: Literal["clip", "exact", "none"] = "clip"
    """what is done to the spectral norm of every weight matrix after each step: `clip` scales it
    down to `max_spectral_norm` if it is larger, as the models that ship were trained; `exact` sets
    it to this value, as eq. (12) is written; `none` leaves it"""
    max_spectral_norm: float = 3.0
    """that norm; the paper's gamma is its fourth power. The networks of a composed model, which
    stand for phi and rho, take its square"""
    balance: float = 0.0
    """how far squared errors are weighted by the inverse mean square label of the drone's type: 0
    not at all, 1 fully, so that weak forces on small drones count as much as those on large"""
    seed: int = 0
    """seed of the first weights and of every draw; the same seed gives the same weights"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for name in ("steps", "batch_size"):
            check_integer(name, getattr(self, name), at_least=1)
        for name in ("learning_rate", "max_spectral_norm"):
            check_number(name, getattr(self, name), above=0.0)
        check_name("spectral", self.spectral, ("clip", "exact", "none"))
        check_number("balance", self.balance, at_least=0.0)
        check_integer("seed", self.seed, at_least=0)


Mode = Literal["anchored", "measured"]
"""The labels that are fitted: the forces of environments, or labels as measured."""
Model = Literal["deep-set", "composed", "wake"]  # Which function is fitted

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
    """The flights of a fit."""

    data: Path
    """a flight log (.csv, .parquet; the format: docs/flight-logs.md), a folder of logs or of
    `swarm-envs collect`, or rows: the published flights' table, or what `save_rows` wrote (.npz)"""


@dataclass(frozen=True, kw_only=True)
class FitFiles(FlightData):
    """The options that a fit must have: fields of the last base class come first in the help."""

    out: Path
    """folder for model and report: `learned.safetensors` and `learned.json` of a deep set,
    `composed.safetensors` and `composed.json`, `wake.json` and its report `wake-fit.json`"""


@dataclass(frozen=True, kw_only=True)
class FitConfig(TrainConfig, FitFiles):
    """Fit a model of the interaction forces to flight logs or to rows of measured force.

    Writes the model and a report of its errors. Most fits need no more than --data, --out, --model,
    --mode and --seed. With --residual, which has options of its own (`fit --residual --help`), it
    fits what a force model leaves over, for the hall.

    Columns of a flight log, SI units, world frame: time (s), drone, type (S, L or S*), x y z (m),
    vx vy vz (m/s), qx qy qz qw, ax ay az (m/s^2, +9.81 in hover; optional), pwm1 to pwm4 (0 to
    65535), voltage (V).
    """

    model: Model = "deep-set"
    """`deep-set`: Neural-Swarm2, eq. 10; `composed`: a wake and a network per pair of types, joined
    so that the force of any number of neighbors stays physical; `wake`: the closed form, by least
    squares"""
    mode: Mode = "anchored"
    """`anchored`: for environments, with offsets subtracted, window, clamp and anchor;
    `measured`: the paper's form on the labels as they are, every neighbour seen"""
    offsets: Literal["estimated", "none"] = "estimated"
    """calibration offsets of an anchored fit; `none` if the labels are exact"""
    anchor_height_m: tyro.conf.Suppress[float] = 0.6
    """height from which a lone drone feels exactly nothing, in an anchored fit"""
    hidden: tyro.conf.Suppress[int] = 20
    """H, length of the hidden state between phi and rho"""
    layers: tyro.conf.Suppress[int] = 4
    """L, layers of every phi and rho"""
    relative_velocity: tyro.conf.Suppress[bool] = True
    """let the network see velocities; without, it sees positions alone"""
    torque: bool = False
    """let the deep set give the torque too, from rows that carry it"""
    progress: bool = True
    """show a progress bar"""
    json: Path | None = None
    """write the report to this file too"""
    logs: LogOptions = LogOptions()
    """how flight logs become rows"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have, and options that exclude each other."""
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
            raise ValueError("a composed model is for environments; fit it in anchored mode")
        if self.torque and self.model != "deep-set":
            raise ValueError(f"--model {self.model} gives no torque; only a deep-set does")

    def how_to_use(self) -> list[str]:
        """Return lines that say how the fitted model is used."""
        path = self.out / WEIGHTS[self.model]
        return [
            f"fly it: swarm-envs fly --interactions {path}",
            f'in Python: swarm_envs.make("swap_v1", interactions="{path}")',
        ]


FITTED = ("composed", "wake")
"""Force models that are refitted, to flights other than those that they are judged on."""


@dataclass(frozen=True, kw_only=True)
class ResidualConfig(FlightData):
    """Identify the force that a model leaves over on flights.

    The result is the random force of `world="hall"`: see docs/hall.md.
    """

    out: Path
    """folder for `residual.json`"""
    force: str = "composed"
    """the force model: `composed`, that of environments, or `wake`, refitted for each fold of
    flights; or the file of a model, which is taken as it is, so that flights it was fitted to
    flatter it"""
    folds: int = 5
    """parts into which the flights of each scenario are dealt"""
    steps: int = FitConfig.steps
    """optimizer steps of each fit"""
    bootstrap: int = 400
    """draws of flights for the 95 % intervals"""
    seed: int = 0
    """of every draw"""
    progress: bool = True
    """show a progress bar while logs are read"""
    json: Path | None = None
    """write the report to this file too"""
    logs: LogOptions = LogOptions()
    """how flight logs become rows"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_integer("folds", self.folds, at_least=2)
        for name in ("steps", "bootstrap"):
            check_integer(name, getattr(self, name), at_least=1)
        check_integer("seed", self.seed, at_least=0)
        check_bool("progress", self.progress)
        check_type("logs", self.logs, LogOptions)
