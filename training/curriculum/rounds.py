"""One round: fly, compute forces from the logs, fit to everything so far, say how it went."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.files import write_json
from swarm_envs.training.collection.collect import collect
from swarm_envs.training.collection.table import Flight, interaction_rows
from swarm_envs.training.curriculum.closeness import Closeness, measure, next_clearance
from swarm_envs.training.curriculum.config import CurriculumConfig, collection_config
from swarm_envs.training.force_model.config import FitConfig
from swarm_envs.training.force_model.evaluate import predict_rows
from swarm_envs.training.force_model.export import load_network
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.provenance import file_sha256, json_ready

MARK = "round.json"
"""Written last: a round that has it is done."""


@dataclass(frozen=True)
class RoundReport:
    """How a round went."""

    number: int
    """Of the round, from 1."""
    title: str
    """What was new in it."""
    teams: tuple[str, ...]
    """Who flew."""
    compensated: bool
    """Whether the last round's model was fed forward."""
    clearance_m: float
    """Least vertical clearance that its swaps planned."""
    closeness: Closeness
    """How near drones came to each other."""
    unknown_before_g: float
    """RMS of the force on the round's held-out flights that its pilot did not know, noise of the
    labels included."""
    unknown_after_g: float
    """The same for the model that was fitted then."""
    next_clearance_m: float
    """What the rule allows the next round."""
    rows: int
    """Of all flights so far."""
    validation_mse: float
    """Of its model on held-out flights so far, against noisy labels, g^2."""
    zero_mse: float
    """Of predicting no force."""
    drag: dict[str, list[float]]
    """Fitted linear drag by type and axis, N s/m."""
    weights_sha256: str
    """SHA-256 of the model that was learned."""
    wall_time_s: float
    """Of this call: what was done before a kill is not in it."""


def round_folder(config: CurriculumConfig, number: int) -> Path:
    """Folder of a round, counted from 1."""
    return config.out / f"round_{number}"


def weights_of(config: CurriculumConfig, number: int) -> Path:
    """The model that a round fitted."""
    return round_folder(config, number) / "fit" / "learned.safetensors"


def fly_round(
    config: CurriculumConfig, number: int, clearance_m: float, earlier: list[Flight]
) -> tuple[RoundReport, list[Flight]]:
    """Fly a round, fit, and report; what is done already is read.

    Args:
        config: of the curriculum.
        number: of the round, from 1.
        clearance_m: that its swaps plan.
        earlier: flights of the rounds before.

    Returns:
        The report, and the flights of all rounds so far.
    """
    began, stage, folder = (
        time.perf_counter(),
        config.stages[number - 1],
        round_folder(config, number),
    )
    feedforward = weights_of(config, number - 1) if stage.compensated else None
    collection = collection_config(config, number, clearance_m, feedforward)
    flown = collect(collection, folder / "flights", config.progress)
    flights, mark = [*earlier, *flown], folder / MARK
    if mark.exists():
        return read_report(mark), flights
    fitted = fit_all(config, number, flights)
    closeness = measure(flown, config.duration_s)
    held_out = interaction_rows([f for f in flown if f.validation], config.label)
    before = unknown_g(held_out, feedforward)
    after = unknown_g(held_out, weights_of(config, number))
    report = RoundReport(
        number=number,
        title=stage.title,
        teams=stage.teams,
        compensated=stage.compensated,
        clearance_m=clearance_m,
        closeness=closeness,
        unknown_before_g=round(before, 4),
        unknown_after_g=round(after, 4),
        next_clearance_m=next_clearance(
            clearance_m, closeness, after / before, config.margin, config.least_clearance_m
        ),
        rows=fitted["findings"]["rows"],
        validation_mse=fitted["findings"]["errors"]["overall"],
        zero_mse=fitted["findings"]["errors"]["zero"],
        drag=fitted["drag"],
        weights_sha256=file_sha256(weights_of(config, number)),
        wall_time_s=round(time.perf_counter() - began, 1),
    )
    write_json(mark, json_ready(report))
    return report, flights


def fit_all(config: CurriculumConfig, number: int, flights: list[Flight]) -> dict[str, Any]:
    """Fit a model to the flights of all rounds so far; returns what its report says.

    A fit that was killed goes on from its checkpoint; one that is done is read.
    """
    folder = round_folder(config, number)
    table, said = folder / "rows.npz", folder / "fit" / "learned.json"
    if not (table.exists() and said.exists()):
        save_rows(table, interaction_rows(flights, config.label))
        fit(fit_config(config, number, table))
    found: dict[str, Any] = json.loads(said.read_text())
    return found


def fit_config(config: CurriculumConfig, number: int, table: Path) -> FitConfig:
    """Options of a round's fit: calibration offsets only where vehicles differ from their type."""
    last = number == len(config.stages)
    differ = any(vars(config.errors).values())
    return FitConfig(
        data=table,
        out=table.parent / "fit",
        offsets="estimated" if differ else "none",
        steps=config.last_steps if last else config.steps,
        slope_limit=None,
        position_jitter_m=0.0,
        velocity_jitter=0.0,
        lipschitz_samples=0,
        seed=config.seed,
        progress=config.progress,
    )


def unknown_g(rows: InteractionRows, weights: Path | None) -> float:
    """RMS of the vertical labels less what a model says, g; None stands for no model."""
    predicted = 0.0 if weights is None else predict_rows(load_network(weights), rows)
    return float(np.sqrt(np.mean((rows.force_g[:, 2] - predicted) ** 2)))


def read_report(path: Path) -> RoundReport:
    """Read what `fly_round` wrote; JSON holds null for what no flight showed, which was NaN."""
    found = json.loads(path.read_text())
    closeness: dict[str, Any] = found["closeness"]
    closeness |= {name: math.nan for name, value in closeness.items() if value is None}
    found["closeness"] = Closeness(**closeness)
    found["teams"] = tuple(found["teams"])
    return RoundReport(**found)
