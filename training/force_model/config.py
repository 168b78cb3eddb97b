"""What a fit is told: options alone, readable where torch is not installed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from swarm_envs.training.force_model.log_options import LogOptions


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained."""

    steps: int = 6000
    """optimiser steps, where `epochs` is not given"""
    epochs: float | None = None
    """passes over the training rows; None counts by `steps`"""
    batch_size: int = 1024
    """rows per step; every row comes once in each pass, in random order"""
    learning_rate: float = 3e-3
    """Adam's rate at the start"""
    schedule: Literal["cosine", "constant"] = "cosine"
    """how the rate goes on: a cosine to zero at the last step, or as it is"""
    average_epochs: float = 0.0
    """the result is a running average of the weights over about so many passes; 0 takes the
    weights of the last step"""
    early_validation: float = 0.0
    """share of the training rows held out, in contiguous pieces with a guard gap, to choose among
    the checkpoints the weights with the least error there; 0 takes those of the end"""
    spectral: Literal["clip", "exact", "none"] = "clip"
    """what holds after each step for every weight matrix: `clip`, its spectral norm is at most
    `max_spectral_norm`; `exact`, it is exactly this (eq. 12); `none`, nothing"""
    max_spectral_norm: float = 3.0
    """that norm; the paper's gamma is its fourth power"""
    slope_limit: float | None = 250.0
    """slope, g per m (or m/s), above which random inputs are penalised; None for no penalty"""
    slope_weight: float = 0.01
    """weight of that penalty, (g per m)^2, beside the mean squared error, g^2"""
    slope_inputs: int = 256
    """random inputs per step on which the slope is looked at"""
    position_jitter_m: float = 0.02
    """standard deviation of noise on neighbours' relative positions: rounds off the sharp tips
    that layers of ReLU make on the axis of a wake, where there are few rows"""
    velocity_jitter: float = 0.08
    """the same for relative velocities, m/s"""
    balance: float = 1.0
    """how far squared errors are weighed by the inverse mean square label of the drone's type: 0
    not at all, 1 fully, so that weak forces on small drones count as much as those on large"""
    symmetry: Literal["square", "circle", "none"] = "square"
    """turn and mirror each row at random: by the eight symmetries of the square in x and y, or by
    any angle"""
    checkpoint_every: int = 500
    """steps between checkpoints and validation errors"""
    seed: int = 0
    """seed of the first weights and of every draw; the same seed gives the same weights"""

    def __post_init__(self) -> None:
        """Check the numbers that no later step would refuse.

        Raises:
            ValueError: naming the value and the rule.
        """
        for name in ("steps", "batch_size", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        for name in ("epochs", "learning_rate", "max_spectral_norm"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}, but must be finite and above 0")
        if not self.average_epochs >= 0.0:
            raise ValueError(
                f"average_epochs is {self.average_epochs}, but must be 0 (no average) or more"
            )
        if not 0.0 <= self.early_validation <= 0.5:
            raise ValueError(
                f"early_validation is {self.early_validation}, but must be a share from 0 (none) "
                "to 0.5"
            )


@dataclass(frozen=True, kw_only=True)
class FitConfig(TrainConfig):
    """What to fit, from which rows, and where to put the result."""

    data: Path
    """rows: the published flights' table, or what `save_rows` wrote; or flight logs: one .csv or
    .parquet file, or a folder of them (the format: docs/flight-logs.md)"""
    out: Path
    """folder for the weights `learned.safetensors`, the report `learned.json`, the checkpoint"""
    mode: Literal["anchored", "measured"] = "anchored"
    """`anchored`: for environments, with offsets subtracted, window, clamp and anchor;
    `measured`: the paper's form on the labels as they are, every neighbour seen"""
    offsets: Literal["estimated", "none"] = "estimated"
    """calibration offsets of an anchored fit; `none` if the labels are exact"""
    anchor_height_m: float = 0.6
    """height from which a lone drone feels exactly nothing, in an anchored fit"""
    hidden: int = 20
    """H, length of the hidden state between phi and rho"""
    layers: int = 4
    """L, layers of every phi and rho"""
    relative_velocity: bool = True
    """let the network see velocities; without, it sees positions alone"""
    lipschitz_samples: int = 1_000_000
    """random pairs on which the Lipschitz constant is measured; 0 leaves it out"""
    progress: bool = True
    """show a progress bar"""
    tensorboard: Path | None = None
    """folder for TensorBoard's event files: losses and errors at every checkpoint"""
    logs: LogOptions = LogOptions()
    """how flight logs become rows"""
