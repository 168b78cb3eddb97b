"""What a fit is told: options alone, readable where torch is not installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from swarm_envs.training.force_model.log_options import LogOptions


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained."""

    steps: int = 6000
    """optimiser steps"""
    batch_size: int = 1024
    """rows per step, drawn with replacement"""
    learning_rate: float = 3e-3
    """Adam's rate at the start; a cosine takes it to zero at the last step"""
    max_spectral_norm: float | None = 3.0
    """limit of every weight matrix (the paper's gamma is its fourth power), held after each step;
    None for none"""
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
    symmetric: bool = True
    """turn and mirror each row at random: the eight symmetries of the square in x and y"""
    checkpoint_every: int = 500
    """steps between checkpoints and validation errors"""
    seed: int = 0
    """seed of the first weights and of every draw; the same seed gives the same weights"""


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
    logs: LogOptions = LogOptions()
    """how flight logs become rows"""
