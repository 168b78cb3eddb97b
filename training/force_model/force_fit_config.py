"""Options of a fit, readable where torch is not installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from swarm_envs.arguments import (
    NOT_NEGATIVE,
    POSITIVE,
    POSITIVE_M,
    Count,
    Range,
    Seed,
    typed_options,
)
from swarm_envs.training.flight_logs.log_options import LogOptions

__all__ = ["FitConfig", "TrainConfig", "with_mode_defaults"]

Share = Annotated[float, Range(0.0, 1.0)]  # From nothing, 0, to all of it, 1


@typed_options
@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained."""

    steps: Count | None = None
    """optimiser steps; None counts by `epochs`"""
    epochs: Annotated[float, POSITIVE] | None = None
    """epochs of training; if `steps` is not given either, the mode's own length"""
    batch_size: Count = 1024
    """rows per step; every row comes once in each pass, in random order"""
    learning_rate: Annotated[float, POSITIVE] = 3e-3
    """the optimiser's rate at the start"""
    optimiser: Literal["adam", "soap"] | None = None
    """`soap` is Adam in the eigenbasis of the gradients' covariance, which needs a quarter of the
    passes; None: the mode's own"""
    teachers: Annotated[int, Range(0)] | None = None
    """networks of the same size that are trained first, from other seeds; the result then learns
    the mean of their answers, each turned and mirrored in all eight ways; 0 for labels alone;
    None: the mode's own"""
    teacher_epochs: Annotated[float, POSITIVE] = 16.0
    """epochs of each teacher"""
    schedule: Literal["cosine", "constant"] | None = None
    """schedule of the rate: a cosine to zero at the last step, or constant; None: the mode's own"""
    average_share: Share | None = None
    """the result is a running average of the weights over about this share of the run; 0 takes the
    weights of the last step; None: the mode's own"""
    spectral: Literal["clip", "exact", "none"] = "clip"
    """what holds after each step for every weight matrix: `clip`, its spectral norm is at most
    `max_spectral_norm`; `exact`, it is exactly this (eq. 12); `none`, nothing"""
    max_spectral_norm: Annotated[float, POSITIVE] = 3.0
    """that norm; the paper's gamma is its fourth power; a pairwise sum, whose one network stands
    for phi and rho, takes its square"""
    slope_limit: Annotated[float, NOT_NEGATIVE] | None = 250.0
    """slope, g per m (or m/s), above which random inputs are penalised; None for no penalty"""
    slope_weight: Annotated[float, NOT_NEGATIVE] = 0.01
    """weight of that penalty, (g per m)^2, relative to the mean squared error, g^2"""
    slope_inputs: Count = 256
    """random inputs per step on which the slope is looked at"""
    position_jitter_m: Annotated[float, NOT_NEGATIVE] = 0.02
    """standard deviation of noise on neighbours' relative positions: rounds off the sharp tips
    that layers of ReLU make on the axis of a wake, where there are few rows"""
    velocity_jitter: Annotated[float, NOT_NEGATIVE] = 0.08
    """the same for relative velocities, m/s"""
    balance: Annotated[float, NOT_NEGATIVE] = 1.0
    """how far squared errors are weighed by the inverse mean square label of the drone's type: 0
    not at all, 1 fully, so that weak forces on small drones count as much as those on large"""
    symmetry: Literal["square", "circle", "none"] = "square"
    """turn and mirror each row at random: by the eight symmetries of the square in x and y, or by
    any angle"""
    checkpoint_every: Count = 500
    """steps between checkpoints and validation errors"""
    seed: Seed = 0
    """seed of the first weights and of every draw; the same seed gives the same weights"""

    def __post_init__(self) -> None:
        if self.steps is not None and self.epochs is not None:
            raise ValueError(
                f"steps is {self.steps} and epochs {self.epochs}, but a run has one length; give "
                "one of them"
            )


Mode = Literal["anchored", "measured"]
"""What is fitted: the forces of environments, or labels as measured."""
Model = Literal["deep-set", "composed", "pairwise", "wake"]  # Which function is fitted

_OWN: Mapping[Mode, Mapping[str, Any]] = {
    "anchored": {
        "steps": 6000,
        "schedule": "cosine",
        "average_share": 0.0,
        "optimiser": "adam",
        "teachers": 0,
    },
    "measured": {
        "epochs": 24.0,
        "schedule": "constant",
        "average_share": 0.1,
        "optimiser": "soap",
        "teachers": 4,
    },
}

_NOT_IN_THE_PAPER: Mapping[str, Any] = {
    "slope_limit": None,
    "position_jitter_m": 0.0,
    "velocity_jitter": 0.0,
    "balance": 0.0,
}
"""What a measured fit leaves out, and one of a composed model, which is smooth by its closed form;
they refuse any but these values and the usual ones."""
_COMPOSED: Mapping[str, Any] = {
    "epochs": 8.0,
    "schedule": "cosine",
    "average_share": 0.0,
    "optimiser": "soap",
    "teachers": 0,
}

Config = TypeVar("Config", bound=TrainConfig)


def with_mode_defaults(
    config: Config, mode: Mode = "anchored", model: Model = "deep-set"
) -> Config:
    """The same options with nothing left to mode and model: what is trained, what reports record.

    Raises:
        ValueError: an option is set that such a fit leaves out.
    """
    if model == "composed" and mode == "measured":
        raise ValueError("a composed model is for environments; fit it in anchored mode")
    left_out: Mapping[str, Any] = {}
    if mode == "measured" or model == "composed":
        left_out = _NOT_IN_THE_PAPER
        _check_left_out(config, "measured fit" if mode == "measured" else "composed model")
    if model == "composed":
        left_out = {**left_out, "symmetry": "none"}  # it has every symmetry
    usual = _COMPOSED if model == "composed" else _OWN[mode]
    own = {name: v for name, v in usual.items() if getattr(config, name) is None}
    if config.steps is not None or config.epochs is not None:
        own = {name: v for name, v in own.items() if name not in ("steps", "epochs")}
    return replace(config, **own, **left_out)


def _check_left_out(config: TrainConfig, what: str) -> None:
    for name, value in _NOT_IN_THE_PAPER.items():
        given = getattr(config, name)
        if given not in (value, getattr(TrainConfig, name)):
            raise ValueError(
                f"{name} is {given}, but a {what} takes {value}; leave it out, or fit another "
                "model in anchored mode"
            )


@dataclass(frozen=True, kw_only=True)
class FitFiles:
    """What a fit cannot do without: fields of the last base class come first in the help."""

    data: Path
    """rows: the published flights' table, or what `save_rows` wrote (.npz); or a flight log (.csv,
    .parquet; the format: docs/flight-logs.md); or a folder of any of them"""
    out: Path
    """folder for model, report and checkpoint: `learned.safetensors` and `learned.json` of a deep
    set, `composed.safetensors` and `composed.json`, `pairwise.safetensors` and `pairwise.json`,
    `wake.json` and its report `wake-fit.json`"""


@typed_options
@dataclass(frozen=True, kw_only=True)
class FitConfig(TrainConfig, FitFiles):
    """Fit a model of the interaction forces to flight logs or to rows of measured force.

    Writes the model and a report of its errors. Interrupted and run again, it resumes from the last
    checkpoint. Most fits need no more than --data, --out, --model, --mode and --seed.
    """

    model: Model = "deep-set"
    """`deep-set`: Neural-Swarm2, eq. 10; `composed`: a wake and a network per pair of types, joined
    so that any number stays physical; `pairwise`: a network per pair of types, summed up; `wake`:
    the closed form, by least squares"""
    mode: Mode = "anchored"
    """`anchored`: for environments, with offsets subtracted, window, clamp and anchor;
    `measured`: the paper's form on the labels as they are, every neighbour seen"""
    offsets: Literal["estimated", "none"] = "estimated"
    """calibration offsets of an anchored fit; `none` if the labels are exact"""
    anchor_height_m: Annotated[float, POSITIVE_M] = 0.6
    """height from which a lone drone feels exactly nothing, in an anchored fit"""
    hidden: Count = 20
    """H, length of the hidden state between phi and rho"""
    layers: Annotated[int, Range(2)] = 4
    """L, layers of every phi and rho"""
    relative_velocity: bool = True
    """let the network see velocities; without, it sees positions alone"""
    torque: bool = False
    """let the deep set give the torque too, from rows that carry it"""
    lipschitz_samples: Annotated[int, Range(0)] = 1_000_000
    """random pairs on which the Lipschitz constant is measured; 0 leaves it out"""
    progress: bool = True
    """show a progress bar"""
    tensorboard: Path | None = None
    """folder for TensorBoard's event files: losses and errors at every checkpoint"""
    json: Path | None = None
    """write the report to this file too"""
    logs: LogOptions = LogOptions()
    """how flight logs become rows, and what of row tables is held out"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.torque and self.model != "deep-set":
            raise ValueError(f"--model {self.model} gives no torque; only a deep-set does")


FITTED = ("composed", "wake")
"""Force models that are refitted, to flights other than those that they are judged on."""


@typed_options
@dataclass(frozen=True, kw_only=True)
class ResidualConfig:
    """What is left over by which model, on which flights.

    The result is the random force of `world="hall"`: see docs/hall.md.
    """

    data: Path
    """rows: the published flights' table, or what `save_rows` wrote (.npz); or a flight log (.csv,
    .parquet; the format: docs/flight-logs.md); or a folder of any of them"""
    out: Path
    """folder for `residual.json`"""
    force: str = "composed"
    """the force model: `composed`, that of environments, or `wake`, refitted for each fold of
    flights; or the file of a model, which is taken as it is, so that flights it was fitted to
    flatter it"""
    folds: Annotated[int, Range(2)] = 5
    """parts into which the flights of each scenario are dealt"""
    rows: Count = 30_000
    """rows of each fit of the wake, drawn at random"""
    bootstrap: Count = 400
    """draws of flights for the 95 % intervals"""
    seed: Seed = 0
    """of every draw"""
    progress: bool = True
    """show a progress bar while logs are read"""
    json: Path | None = None
    """write the report to this file too"""
    logs: LogOptions = LogOptions()
    """how flight logs become rows"""
