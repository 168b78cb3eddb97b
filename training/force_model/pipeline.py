"""The whole fit: read rows, calibrate, train, export, evaluate, report."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path

import torch

from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.training.flight_logs.read import data_sha256, read_data
from swarm_envs.training.force_model.evaluate import FitReport, evaluate_model, torque_errors
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.force_fit_config import REPORTS, WEIGHTS, FitConfig
from swarm_envs.training.force_model.labels import (
    check_rows,
    measured_range,
    prepare,
    silence_unseen,
    without_falls,
)
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    OUTER_FADE,
    DeepSet,
    DeepSetSpec,
    without_velocity,
)
from swarm_envs.training.force_model.train import Training, train
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.row_tables import vehicle_name
from swarm_envs.training.provenance import changed_options, check_same, json_ready

__all__ = ["REPORTS", "fit"]

ANCHOR_HEIGHT_M = 0.6  # Height from which the force on a lone drone is zero, m
_ASIDE = ("progress", "json")  # Options that do not change the result


def check_finished(path: Path, config: FitConfig, data_sha256: str) -> None:
    """Check that an existing report is of the same fit, which may then be repeated."""
    if not path.is_file():
        return
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        made = {**report["config"], "data_sha256": report["data_sha256"]}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{str(path)!r} is not the report of a fit; choose another folder or delete it"
        ) from error
    config_now = json.loads(json.dumps(json_ready(config)))
    wanted = {**config_now, "data_sha256": data_sha256}
    aside = ("data", "out", *_ASIDE)
    check_same(path, *({k: v for k, v in c.items() if k not in aside} for c in (made, wanted)))


def fit(config: FitConfig) -> FitReport:
    """Fit a model to rows and write it and its report to `config.out`.

    Raises:
        FileNotFoundError: there is no data.
        ValueError: the rows are invalid, or `config.out` has a fit of other data or options.
    """
    began = time.perf_counter()
    rows, logs = read_data(config.data, config.logs, config.progress)
    check_rows(rows)
    prepared = prepare(rows, config)
    words, digest = fit_command(config), data_sha256(config.data)
    check_finished(config.out / REPORTS[config.model], config, digest)
    run = train_model(prepared.target, config)
    with torch.no_grad():
        run.network.drag.copy_(torch.from_numpy(prepared.drag))
    notes = silence_unseen(run.network, prepared.rows)
    provenance: dict[str, object] = {
        "command": words,
        "data_sha256": digest,
        "mode": config.mode,
        "seed": config.seed,
        **({"notes": notes} if notes else {}),
    }
    path = config.out / WEIGHTS[config.model]
    save_network(path, run.network, provenance)
    network = None if config.model == "wake" else load_network(path)
    torque = None
    if isinstance(network, DeepSet) and config.torque:
        torque = torque_errors(network, rows)
    report = FitReport(
        model=config.model,
        command=words,
        config=json_ready(config),
        data_sha256=digest,
        vehicle_offsets_g={vehicle_name(rows, v): g for v, g in prepared.offsets.vehicle.items()},
        drag={name: prepared.drag[index].tolist() for index, name in enumerate(rows.types)},
        findings=evaluate_model(load(path), prepared, config.seed, network),
        history=run.history,
        wall_time_s=round(time.perf_counter() - began, 1),
        logs=logs,
        notes=notes,
        torque_errors=torque,
    )
    for file in (config.out / REPORTS[config.model], config.json):
        if file is not None:
            write_json(file, json_ready(report))
    return report


def train_model(target: InteractionRows, config: FitConfig) -> Training:
    """Train the network of a configuration on labels from `prepare`.

    A network that replaces phi and rho may have the Lipschitz bound of both.
    """
    rows = without_falls(target) if config.model == "composed" else target
    spec = network_spec(target, config)
    if config.model != "deep-set":
        config = dataclasses.replace(config, max_spectral_norm=config.max_spectral_norm**2)
    return train(rows, spec, config)


def network_spec(rows: InteractionRows, config: FitConfig) -> DeepSetSpec:
    """Return the function whose weights are fitted."""
    anchored = config.mode == "anchored" or config.model == "wake"
    spec = DeepSetSpec(
        rows.types,
        window=OUTER_FADE if anchored else EVERYWHERE,
        input_range=measured_range(rows) if anchored else None,
        anchor_height_m=ANCHOR_HEIGHT_M if anchored else None,
        hidden=config.hidden,
        layers=config.layers,
        kind=config.model,
        torque=config.torque,
    )
    return spec if config.relative_velocity else without_velocity(spec)


def fit_command(config: FitConfig) -> str:
    """Return the command line of this fit, without folders of its file names."""
    words = ["swarm-envs fit", f"--data {config.data.name}", "--out DIR"]
    return " ".join([*words, *changed_options(config, aside=_ASIDE)])
