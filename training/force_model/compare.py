"""Cross-validation of force models: `python -m swarm_envs.training.force_model.compare`.

For each fold of flights, every model is fitted to the other folds and evaluated on it. Folds are
stratified by the scenarios of the flights. Two models are compared by the difference of their
squared errors on the same rows. As rows of a flight are not independent, the interval of the
difference is that of a bootstrap over flights.

Labels are the same for all models and folds: calibration offsets are estimated from the quiet rows
of every flight, held out or not, because they belong to the measurement.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import tyro
from scipy import stats
from tqdm import tqdm

from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import write_json, written_whole
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import data_sha256, read_data
from swarm_envs.training.force_model.force_fit_config import (
    FitConfig,
    Model,
)
from swarm_envs.training.force_model.labels import FALL_SPEED, prepare
from swarm_envs.training.force_model.pipeline import train_model
from swarm_envs.training.force_model.train import predict, to_batch
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.training.provenance import begin_manifest, json_ready

DRAWS = 2000  # Number of bootstrap samples
_ASIDE = ("data", "out", "json", "progress")  # Options that do not change the results


@dataclass(frozen=True, kw_only=True)
class CompareConfig:
    """Options of a comparison of models."""

    data: Path
    """Flight log, folder or table of rows, as for `swarm-envs fit`."""

    out: Path
    """Output folder for the models' predictions of held-out flights; an interrupted comparison
    resumes from it."""
    models: tuple[Model, ...] = ("composed", "deep-set", "wake")
    """Models; the first is compared with each of the others."""
    folds: int = 5
    """Number of folds of the flights."""
    steps: int = FitConfig.steps
    """Number of optimizer steps of each fit."""
    seed: int = 0
    """Random seed of the folds, the fits and the bootstrap."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """Also write the comparison to this file."""
    logs: LogOptions = LogOptions()
    """Options of the conversion of flight logs to rows."""

    def __post_init__(self) -> None:
        """Raise ValueError if an option has an invalid value."""
        for model in self.models:
            check_name("models", model, get_args(Model))
        check_integer("folds", self.folds, at_least=2)
        check_integer("steps", self.steps, at_least=1)
        check_integer("seed", self.seed, at_least=0)


@dataclass(frozen=True)
class ModelComparison:
    """Errors of models on held-out flights."""

    flights: int  # Number of flights
    rows: int  # Number of rows
    errors: dict[str, dict[str, float]]
    """Mean squared error by model, g^2: of `all` rows, of rows with controlled flight (`flown`),
    and of each scenario."""
    differences: list[dict[str, Any]]
    """Differences of the first `model` and each `other` on `all` rows or those `flown`: the mean
    difference of squared errors, g^2, negative if the first is better, and its 95 % interval."""
    config: object  # Options
    data_sha256: str  # SHA-256 of the data

    def lines(self) -> list[str]:
        """Return the lines that the command prints."""
        found = [f"{self.rows} rows of {self.flights} flights; mean squared errors, g^2"]
        for model, errors in self.errors.items():
            found.append(
                f"{model}: {errors['all']:.2f}, below {FALL_SPEED:g} m/s {errors['flown']:.2f}"
            )
        for d in self.differences:
            found.append(
                f"{d['model']} minus {d['other']}, {d['rows']} rows: {d['mean']:+.2f} "
                f"(95 % interval {d['low']:+.2f} to {d['high']:+.2f})"
            )
        return found


def flight_folds(rows: InteractionRows, folds: int, seed: int) -> IntArray:
    """Return the fold of each row's flight, (R,), stratified by scenarios."""
    flights, index = np.unique(rows.flight, return_inverse=True)
    if len(flights) < folds:
        raise ValueError(
            f"there are {len(flights)} flights for {folds} folds; give more flights or fewer folds"
        )
    kinds = [tuple(np.unique(rows.scenario[rows.flight == f]).tolist()) for f in flights]
    rng, chosen, dealt = np.random.default_rng(seed), np.zeros(len(flights), dtype=np.int64), 0
    for kind in sorted(set(kinds)):
        same = rng.permutation([k for k, own in enumerate(kinds) if own == kind])
        chosen[same] = (dealt + np.arange(len(same))) % folds
        dealt += len(same)
    return chosen[index.reshape(-1)]


def paired_difference(
    one: FloatArray, other: FloatArray, flight: IntArray, seed: int
) -> tuple[float, float, float]:
    """Return the mean difference of squared errors (R,) and its 95 % interval over flights.

    The interval is that of a paired percentile bootstrap: flights are drawn with replacement, each
    with its sum of differences and its number of rows.
    """
    index = np.unique(flight, return_inverse=True)[1].reshape(-1)
    total, count = np.bincount(index, one - other), np.bincount(index)
    found = stats.bootstrap(
        (total, count),
        lambda totals, counts, axis: totals.sum(axis) / counts.sum(axis),
        paired=True,
        n_resamples=DRAWS,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(total.sum() / count.sum()), float(found.low), float(found.high)


def compare(config: CompareConfig) -> ModelComparison:
    """Cross-validate every model, and compare them.

    Raises:
        FileNotFoundError: there is no data.
        ValueError: there are too few flights, or `config.out` has another comparison.
    """
    rows, _ = read_data(config.data, config.logs, config.progress)
    rows = dataclasses.replace(rows, validation=np.zeros(len(rows), dtype=np.bool_))
    fold, digest = flight_folds(rows, config.folds, config.seed), data_sha256(config.data)
    options = {k: v for k, v in vars(config).items() if k not in _ASIDE}
    begin_manifest(config.out / "comparison.json", {**options, "data_sha256": digest})
    label, squared = np.zeros(len(rows)), {model: np.zeros(len(rows)) for model in config.models}
    parts = [(model, k) for model in config.models for k in range(fold.max() + 1)]
    for model, k in tqdm(parts, disable=not config.progress, unit="fit"):
        target, held_out = prepare(rows, default_fit(model, config)).target, fold == k
        label = target.force_g[:, 2]
        path = config.out / f"{model}-{k}.npy"
        if not path.is_file():
            own = dataclasses.replace(target, validation=held_out)
            predicted = fitted_force_g(own, default_fit(model, config))[:, 2]
            with written_whole(path) as partial, partial.open("wb") as stream:
                np.save(stream, predicted[held_out])
        squared[model][held_out] = (np.load(path) - label[held_out]) ** 2
    return _compared(rows, squared, config, digest)


def default_fit(model: Model, config: CompareConfig | FitConfig) -> FitConfig:
    """Return the options of a fit of a model to the same data, with defaults otherwise."""
    return FitConfig(
        data=config.data,
        out=config.out,
        model=model,
        steps=config.steps,
        seed=config.seed,
        progress=False,
    )


def fitted_force_g(target: InteractionRows, options: FitConfig) -> FloatArray:
    """Fit a model to the training rows, and return its force on every row, (R, 3) gram-force.

    Only a composed model has a horizontal force.
    """
    found = np.zeros((len(target), 3))
    network = train_model(target, options).network
    heads = predict(network, to_batch(target), every=True).double().numpy()
    found[:, 2] = heads[:, 0]
    if options.model == "composed":
        found[:, :2] = heads[:, 1:]
    return found


def _compared(
    rows: InteractionRows, squared: dict[Model, FloatArray], config: CompareConfig, digest: str
) -> ModelComparison:
    speed = np.linalg.norm(rows.velocity, axis=1)
    subsets: dict[str, BoolArray] = {
        "all": np.ones(len(rows), dtype=np.bool_),
        "flown": speed < FALL_SPEED,
    }
    named = {name: rows.scenario == k for k, name in enumerate(rows.scenario_names)}
    errors = {
        str(model): {
            name: float(own[use].mean()) for name, use in (subsets | named).items() if use.any()
        }
        for model, own in squared.items()
    }
    first, *others = config.models
    differences = []
    for other in others:
        for name, use in subsets.items():
            pair = squared[first][use], squared[other][use]
            ends = paired_difference(*pair, rows.flight[use], config.seed)
            about = {"model": first, "other": other, "rows": name}
            differences.append(about | dict(zip(("mean", "low", "high"), ends, strict=True)))
    flights = len(np.unique(rows.flight))
    found = ModelComparison(flights, len(rows), errors, differences, json_ready(config), digest)
    if config.json is not None:
        write_json(config.json, json_ready(found))
    return found


if __name__ == "__main__":
    chosen = tyro.cli(CompareConfig, description="Compare force models on held-out flights.")
    print(*compare(chosen).lines(), sep="\n")  # noqa: T201
