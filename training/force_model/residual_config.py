"""Options of `swarm-envs fit --residual`, readable where torch is not installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from swarm_envs.arguments import Count, Range, Seed, typed_options
from swarm_envs.training.flight_logs.log_options import LogOptions

__all__ = ["ResidualConfig"]

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
