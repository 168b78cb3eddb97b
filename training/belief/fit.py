"""Collect flights, fit a heterogeneous deep set to them, judge it in flight, write what ships."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import tyro

from swarm_envs.baselines.neural_swarm.agent import BELIEFS
from swarm_envs.files import write_json, written_whole
from swarm_envs.interactions import load
from swarm_envs.training.belief.card import model_card
from swarm_envs.training.belief.judge import TRIALS, SwapJudgement, SwapTrial, judge
from swarm_envs.training.collection.collect import MANIFEST, collect
from swarm_envs.training.collection.config import CollectionConfig
from swarm_envs.training.collection.table import interaction_rows
from swarm_envs.training.force_model import FitConfig, FitReport, load_network, save_network
from swarm_envs.training.force_model import fit as fit_force_model
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.provenance import file_sha256, json_ready


@dataclass(frozen=True)
class BeliefConfig:
    """How the belief is made."""

    out: Path
    """folder for `belief.safetensors`, `belief.json`, `MODEL_CARD.md`; `flights` below it keeps
    the logs. The weights and the report of another environment than `learned` are named after it,
    such as `belief_wake.safetensors`"""
    seed: int = 0
    """seed of flights and fit"""
    steps: int = 4000
    """optimiser steps"""
    collection: CollectionConfig = field(default_factory=CollectionConfig)
    """what is flown; `seed` takes the place of its seed"""
    trials: tyro.conf.Suppress[tuple[SwapTrial, ...]] = TRIALS
    """what the belief is judged by in flight"""
    progress: bool = True
    """show progress bars"""


@dataclass(frozen=True)
class BeliefReport:
    """The content of `belief.json`."""

    name: str
    """Of the files: weights and this report."""
    command: str
    """The command that made the belief."""
    interactions: str
    """Force model of the environment that was flown in."""
    interactions_sha256: str
    """Fingerprint of its numbers."""
    flights: int
    """Flights it was fitted to."""
    flown_s: float
    """Their length together, s."""
    rows: int
    """Rows it was fitted to."""
    rows_sha256: str
    """SHA-256 of these rows."""
    fit: FitReport
    """How well it fits them."""
    judgements: list[SwapJudgement]
    """How well swaps are flown with it."""
    wall_time_s: float
    """Time that all of this took, s."""


def fit_belief(config: BeliefConfig) -> BeliefReport:
    """Make the belief: see the module. Killed and called again, it goes on.

    Raises:
        ValueError: the folder holds flights of another configuration or force model.
    """
    began = time.perf_counter()
    collection = dataclasses.replace(config.collection, seed=config.seed)
    flights = collect(collection, config.out / "flights", config.progress)
    rows = interaction_rows(flights)
    table = config.out / "flights" / "rows.npz"
    save_rows(table, rows)
    fitted = fit_force_model(fit_config(config, table))
    model = load(collection.interactions)
    provenance: dict[str, object] = {
        "command": command(config),
        "data": f"flights simulated with the force model {model.name!r}",
        "interactions_sha256": model.fingerprint,
        "manifest_sha256": file_sha256(config.out / "flights" / MANIFEST),
        "seed": config.seed,
    }
    name = file_name(collection.interactions)
    path = config.out / f"{name}.safetensors"
    network = load_network(config.out / "fit" / "learned.safetensors")
    save_network(path, network, provenance, torch.float32)  # as it was trained
    report = BeliefReport(
        name=name,
        command=command(config),
        interactions=model.name,
        interactions_sha256=model.fingerprint,
        flights=len(flights),
        flown_s=round(sum(flight.seconds for flight in flights), 1),
        rows=len(rows),
        rows_sha256=file_sha256(table),
        fit=fitted,
        judgements=judge_all(path, config),
        wall_time_s=round(time.perf_counter() - began, 1),
    )
    write_json(config.out / f"{name}.json", json_ready(report))
    limits = network.spec.input_range
    assert limits is not None  # an anchored fit has one
    with written_whole(config.out / "MODEL_CARD.md") as partial:
        partial.write_text(model_card(report, collection, limits))
    return report


def file_name(interactions: str) -> str:
    """Name of a belief's files, by the force model of the environment: a name or a path."""
    return BELIEFS.get(interactions, f"belief_{Path(interactions).stem}")


def command(config: BeliefConfig) -> str:
    """Command line that makes this belief, with the folder left out."""
    words = ["python -m swarm_envs.training.belief --out DIR", f"--seed {config.seed}"]
    if config.steps != BeliefConfig.steps:
        words.append(f"--steps {config.steps}")
    return " ".join(words + changed_options("collection", config.collection, CollectionConfig()))


def changed_options(prefix: str, config: Any, default: Any) -> list[str]:
    """Options of a nested configuration that differ from the default, without its seed."""
    words = []
    for entry in dataclasses.fields(config):
        value, usual = getattr(config, entry.name), getattr(default, entry.name)
        name = f"{prefix}.{entry.name.replace('_', '-')}"
        if dataclasses.is_dataclass(value):
            words += changed_options(name, value, usual)
        elif value != usual and entry.name != "seed":
            given = value if isinstance(value, tuple) else (value,)
            words.append(f"--{name} {' '.join(map(str, given))}")
    return words


def fit_config(config: BeliefConfig, table: Path) -> FitConfig:
    """Options of the trainer: labels of simulated flights have no calibration offset."""
    return FitConfig(
        data=table,
        out=config.out / "fit",
        offsets="none",
        steps=config.steps,
        slope_limit=None,
        position_jitter_m=0.0,
        velocity_jitter=0.0,
        lipschitz_samples=0,
        seed=config.seed,
        progress=config.progress,
    )


def judge_all(belief: Path, config: BeliefConfig) -> list[SwapJudgement]:
    """Fly every trial without and with the belief."""
    environment = load(config.collection.interactions)
    return [judge(trial, load(belief), environment) for trial in config.trials]
