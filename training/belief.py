"""Fit of the force model that a controller feeds forward, to flights in the environment.

The model is called a belief, to distinguish it from the true force model of the environment, which
the controller never reads. Flights are collected, a heterogeneous deep set is fitted to them, and
evaluated in stacked swaps with and without compensation. The included models are
`belief*.safetensors` of `swarm_envs.baselines.neural_swarm`.

Command: `python -m swarm_envs.training.belief --out DIR --seed 0`, with
`--collection.interactions wake` for an environment with another force model.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from swarm_envs.baselines.neural_swarm.agent import BELIEFS
from swarm_envs.baselines.neural_swarm.flights import PAPER_SWAP, Flights, run_flights, swap_test
from swarm_envs.control.config import ControllerConfig
from swarm_envs.errors import check_bool, check_integer, check_type
from swarm_envs.files import write_json
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.collection.collect import MANIFEST, CollectionConfig, collect
from swarm_envs.training.collection.table import interaction_rows
from swarm_envs.training.force_model import FitConfig, load_network, save_network
from swarm_envs.training.force_model import fit as fit_force_model
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.provenance import changed_options, file_sha256, json_ready

__all__ = ["SwapTrial", "fly_swaps", "simulated_fit_config"]


@dataclass(frozen=True)
class SwapTrial:
    """Randomized stacked swaps of one team."""

    team: str
    """The vehicle types, the lowest last."""
    layout: StackedLayout
    """The distribution of the swaps."""
    episodes: int
    """The number of swaps."""
    world: str = "ideal"
    """`ideal` or `hall`; see `swarm_envs.hall`."""


TRIALS = (
    *(SwapTrial(team, PAPER_SWAP, 30) for team in ("S2S", "L2S", "SS2S")),
    *(SwapTrial(team, StackedLayout(), 30) for team in ("S2S", "L2S", "SS2S")),
    *(SwapTrial(team, StackedLayout(), 12) for team in ("S2L", "L2L", "SL2S", "LL2S", "SS2L")),
    *(SwapTrial(team, PAPER_SWAP, 40, "hall") for team in ("S2S", "L2S", "SS2S")),
)
"""The trials in which a model is evaluated; their seeds count from 0."""


@dataclass(frozen=True, kw_only=True)
class CompensationResult(SwapTrial):
    """Worst height error of the lowest drone over the episodes of a trial, cm."""

    uncompensated_median_cm: float  # Median of the worst height errors without compensation, cm
    compensated_median_cm: float  # Median of the worst height errors with compensation, cm
    largest_ratio: float  # Largest ratio of the errors with and without compensation
    worse: int  # Number of episodes in which compensation increased the error
    upper_largest_growth_cm: float
    """Largest increase of another drone's worst height error by compensation, cm."""
    crashed: int  # Number of compensated episodes that ended in a collision or a tumble


@dataclass(frozen=True)
class FeedforwardConfig:
    """Options of the fit of a model for feed-forward."""

    out: Path
    """Output folder for belief.safetensors, belief.json, and the logs in flights/.
    With another force model than `learned`, the files are named after it, such as
    belief_wake.safetensors."""
    seed: int = 0
    """Random seed of the flights and the fit."""
    steps: int = 4000
    """Number of optimizer steps."""
    collection: CollectionConfig = field(default_factory=CollectionConfig)
    """Options of the flights; --seed replaces their seed."""
    trials: tyro.conf.Suppress[tuple[SwapTrial, ...]] = TRIALS
    """Trials in which the model is evaluated."""
    progress: bool = True
    """Show progress bars."""

    def __post_init__(self) -> None:
        """Raise ValueError if an option has an invalid value."""
        check_integer("seed", self.seed, at_least=0)
        check_integer("steps", self.steps, at_least=1)
        check_type("collection", self.collection, CollectionConfig)
        check_bool("progress", self.progress)


FeedforwardReport = dict[str, Any]  # The content of `belief.json`


def fit_feedforward(config: FeedforwardConfig) -> FeedforwardReport:
    """Collect flights, fit the model and evaluate it; an interrupted collection resumes.

    Raises:
        ValueError: the folder has flights of another configuration or force model.
    """
    began = time.perf_counter()
    collection = dataclasses.replace(config.collection, seed=config.seed)
    flights = collect(collection, config.out / "flights", config.progress)
    rows = interaction_rows(flights)
    table = config.out / "flights" / "rows.npz"
    save_rows(table, rows)
    fitted = fit_force_model(
        simulated_fit_config(table, config.out / "fit", config.steps, config.seed, config.progress)
    )
    model = load(collection.interactions)
    command = feedforward_command(config)
    provenance: dict[str, object] = {
        "command": command,
        "data": f"flights simulated with the force model {model.name!r}",
        "interactions_sha256": model.fingerprint,
        "manifest_sha256": file_sha256(config.out / "flights" / MANIFEST),
        "seed": config.seed,
    }
    given = collection.interactions
    name = BELIEFS.get(given, f"belief_{Path(given).stem}")
    path = config.out / f"{name}.safetensors"
    network = load_network(config.out / "fit" / "deep-set.safetensors")
    save_network(path, network, provenance, torch.float32)
    fed_forward, environment = load(path), load(given)
    report: FeedforwardReport = {
        "name": name,
        "command": command,
        "interactions": model.name,
        "interactions_sha256": model.fingerprint,
        "flights": len(flights),
        "flown_s": round(sum(flight.seconds for flight in flights), 1),
        "rows": len(rows),
        "rows_sha256": file_sha256(table),
        "fit": fitted,
        "trials": [compare_compensation(t, fed_forward, environment) for t in config.trials],
        "wall_time_s": round(time.perf_counter() - began, 1),
    }
    write_json(config.out / f"{name}.json", json_ready(report))
    return report


def simulated_fit_config(
    table: Path, out: Path, steps: int, seed: int, progress: bool
) -> FitConfig:
    """Return the options of a fit to simulated flights, which have no calibration offsets."""
    return FitConfig(
        data=table,
        out=out,
        offsets="none",
        steps=steps,
        balance=1.0,
        seed=seed,
        progress=progress,
    )


def feedforward_command(config: FeedforwardConfig) -> str:
    """Return the command line that fits this model, with a placeholder for the folder."""
    words = ["python -m swarm_envs.training.belief --out DIR", f"--seed {config.seed}"]
    if config.steps != FeedforwardConfig.steps:
        words.append(f"--steps {config.steps}")
    return " ".join(words + changed_options(config.collection, "--collection.", ("seed",)))


def compare_compensation(
    trial: SwapTrial, model: InteractionModel, environment: str | InteractionModel = "learned"
) -> CompensationResult:
    """Simulate a trial without and with the model, with the same seeds, references and gains.

    Raises:
        RuntimeError: drones collided in the ideal world.
    """
    flown = [
        fly_swaps(trial, controller, environment)
        for controller in (ControllerConfig(), ControllerConfig(feedforward=model))
    ]
    if trial.world == "ideal" and any(flights.crashed.any() for flights in flown):
        raise RuntimeError(f"swap of {trial.team}: drones collided in a trial")
    without, compensated = (flights.worst_height_error for flights in flown)
    lowest, lowest_without = compensated[:, -1], without[:, -1]
    return CompensationResult(
        **vars(trial),
        uncompensated_median_cm=round(100 * float(np.median(lowest_without)), 2),
        compensated_median_cm=round(100 * float(np.median(lowest)), 2),
        largest_ratio=round(float((lowest / lowest_without).max()), 3),
        worse=int((lowest > lowest_without).sum()),
        upper_largest_growth_cm=round(100 * float((compensated - without)[:, :-1].max()), 2),
        crashed=int(flown[1].crashed.sum()),
    )


def fly_swaps(
    trial: SwapTrial,
    controller: ControllerConfig,
    environment: str | InteractionModel,
    first_seed: int = 0,
) -> Flights:
    """Simulate the episodes of a trial, in which every drone follows its reference.

    All drones have the controller; seeds count from `first_seed`.
    """
    test = swap_test(trial.team, trial.layout, environment)
    test = dataclasses.replace(test, world=trial.world)
    return run_flights(test, controller, range(first_seed, first_seed + trial.episodes))


def _lines(report: FeedforwardReport) -> list[str]:
    """Return the lines that the command prints."""
    errors = report["fit"].findings.errors
    return [
        f"validation MSE {errors.overall:.2f} g^2 (of zero force: {errors.zero:.2f} g^2)",
        *(
            f"{trial.team:5} radius {trial.layout.radius_m} m, {trial.layout.duration_s} s: "
            f"{trial.uncompensated_median_cm:5.1f} -> {trial.compensated_median_cm:4.1f} cm, "
            f"{trial.worse} of {trial.episodes} worse"
            for trial in report["trials"]
        ),
    ]


if __name__ == "__main__":
    chosen = tyro.cli(
        FeedforwardConfig,
        description="Fit the force model that the compensated controller feeds forward.",
    )
    print(*_lines(fit_feedforward(chosen)), f"report in {chosen.out}", sep="\n")  # noqa: T201
