"""The whole fit: read rows, calibrate, train, export, evaluate, report."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import torch

from swarm_envs.files import write_json
from swarm_envs.training.force_model.calibration import (
    NO_OFFSETS,
    RULE,
    estimate_offsets,
    subtract_offsets,
)
from swarm_envs.training.force_model.config import FitConfig as FitConfig
from swarm_envs.training.force_model.config import settled
from swarm_envs.training.force_model.data import data_sha256, read_data
from swarm_envs.training.force_model.drag import fit_drag
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.files import json_ready
from swarm_envs.training.force_model.log_options import LogOptions
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    HARD_LATERAL_M,
    HARD_VERTICAL_M,
    OUTER_FADE,
    DeepSetSpec,
    InputRange,
    without_velocity,
)
from swarm_envs.training.force_model.report import FitReport, examine
from swarm_envs.training.force_model.rows import InteractionRows
from swarm_envs.training.force_model.tensorboard import scalar_writer
from swarm_envs.training.force_model.train import train
from swarm_envs.vehicles import GRAM_FORCE

VOLUME_M = np.array([HARD_LATERAL_M, HARD_LATERAL_M, HARD_VERTICAL_M])
"""Half edges of the interaction volume."""


def fit(config: FitConfig) -> FitReport:
    """Fit a deep set to rows and write `learned.safetensors` and `learned.json` into `config.out`.

    Killed and called again with the same configuration, it continues from its checkpoint and
    gives the same weights.

    Raises:
        FileNotFoundError: there is no data file.
        ValueError: the rows cannot be fitted; the message says which rule they break.
    """
    began = time.perf_counter()
    told, config = config, settled(config, config.mode)
    rows, logs = read_data(config.data, config.logs, config.progress)
    _check(rows)
    drag = fit_drag(rows)
    anchored = config.mode == "anchored"
    calibrated = anchored and config.offsets == "estimated"
    offsets = estimate_offsets(rows) if calibrated else NO_OFFSETS
    if not anchored:
        drag[:, 2] = 0.0  # the network learns the vertical drag with the rest
    spec = _spec(rows, config) if anchored else DeepSetSpec(rows.types, EVERYWHERE, None, None)
    spec = dataclasses.replace(spec, hidden=config.hidden, layers=config.layers)
    spec = spec if config.relative_velocity else without_velocity(spec)
    treated = subtract_offsets(rows, offsets)
    vertical_drag_g = drag[rows.ego_type, 2] * rows.velocity[:, 2] / GRAM_FORCE
    target = treated.with_vertical_force(treated.force_g[:, 2] + vertical_drag_g)
    checkpoint = config.out / "checkpoint.safetensors"
    with scalar_writer(config.tensorboard) as watch:
        run = train(target, spec, config, checkpoint, config.progress, watch)
    with torch.no_grad():
        run.network.drag.copy_(torch.from_numpy(drag))
    path = config.out / "learned.safetensors"
    provenance: dict[str, object] = {
        "command": command(told),
        "data_sha256": data_sha256(config.data),
        "mode": config.mode,
        "seed": config.seed,
    }
    save_network(path, run.network, provenance)
    report = FitReport(
        command=command(told),
        config=json_ready(config),
        data_sha256=data_sha256(config.data),
        offset_rule=RULE if calibrated else "none",
        vehicle_offsets_g={str(vehicle): g for vehicle, g in offsets.vehicle.items()},
        drag={name: drag[index].tolist() for index, name in enumerate(rows.types)},
        history=run.history,
        chosen=run.chosen,
        findings=examine(load_network(path), rows, offsets, config.lipschitz_samples, config.seed),
        wall_time_s=round(time.perf_counter() - began, 1),
        logs=logs,
    )
    write_json(config.out / "learned.json", json_ready(report))
    checkpoint.unlink()
    return report


def command(config: FitConfig) -> str:
    """Command line that makes this fit, with the folders left out of its file names."""
    words = ["python -m swarm_envs.training.force_model", f"--data {config.data.name}", "--out DIR"]
    return " ".join([*words, *_options(config)])


def _options(config: FitConfig | LogOptions, prefix: str = "--") -> list[str]:
    """Options that differ from their defaults."""
    words = []
    for entry in dataclasses.fields(config):
        value, name = getattr(config, entry.name), prefix + entry.name.replace("_", "-")
        if isinstance(value, LogOptions):
            words += _options(value, f"{name}.")
        elif entry.default is not dataclasses.MISSING and value != entry.default:
            words += [] if entry.name == "progress" else [f"{name} {value}"]
    return words


def _check(rows: InteractionRows) -> None:
    for index, name in enumerate(rows.types):
        if not ((rows.ego_type == index) & ~rows.validation).any():
            raise ValueError(
                f"no training row has a drone of type {name!r} that feels the force, so its rho "
                "cannot be fitted; add such rows or leave the type out of `types`"
            )
    if not rows.validation.any():
        raise ValueError("no row is marked for validation; mark whole blocks of time, about 20 %")


def _spec(rows: InteractionRows, config: FitConfig) -> DeepSetSpec:
    return DeepSetSpec(rows.types, OUTER_FADE, measured_range(rows), config.anchor_height_m)


def measured_range(rows: InteractionRows) -> InputRange:
    """Range that the inputs of an anchored fit are clamped to.

    Heights between the lowest and the highest of all rows; of every speed and of the vertical
    distance the 99.9 % quantile of its magnitude inside the interaction volume, one number for x
    and y; laterally the edge of the volume, since the window ends there.
    """
    inside = (np.abs(rows.neighbor[..., :3]) <= VOLUME_M).all(axis=-1) & rows.has_neighbor
    own = np.quantile(np.abs(rows.velocity), 0.999, axis=0)
    own[:2] = own[:2].max()
    pair = np.zeros(6)
    if inside.any():
        pair = np.quantile(np.abs(rows.neighbor[inside]), 0.999, axis=0)
    pair[3:5] = pair[3:5].max()
    pair[:2] = VOLUME_M[:2]
    own, pair = np.round(own, 2), np.round(pair, 2)
    height = rows.position[:, 2]
    low, high = round(float(height.min()), 2), round(float(height.max()), 2)
    return InputRange(
        pair=(tuple((-pair).tolist()), tuple(pair.tolist())),
        environment=((-high, *(-own).tolist()), (-low, *own.tolist())),
    )
