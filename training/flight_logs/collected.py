"""Flights that `swarm-envs collect` wrote: npz files beside a manifest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.training.collection.collect import MANIFEST
from swarm_envs.training.collection.fleet import vehicle_names
from swarm_envs.training.collection.storage import flight_file, read_log
from swarm_envs.training.collection.table import ROW_RATE, Flight, interaction_rows
from swarm_envs.training.flight_logs.report import FileReport, LogReport, ScenarioReport
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.vehicles import parse_team

__all__ = ["MANIFEST", "is_collection", "read_collected"]


def is_collection(path: Path) -> bool:
    """Whether a folder holds npz flights and their manifest; Parquet ones are read as real logs."""
    manifest = path / MANIFEST
    if not manifest.is_file():
        return False
    return bool(_config(json.loads(manifest.read_text())).get("format") != "parquet")


def read_collected(path: Path) -> tuple[InteractionRows, LogReport]:
    """Read the flights of a finished collection; labels, filter and split are the collection's.

    Raises:
        FileNotFoundError: a flight of the manifest is missing.
        ValueError: the collection is not finished, or gives no row.
    """
    manifest = json.loads((path / MANIFEST).read_text())
    if "flights" not in manifest:
        raise ValueError(
            f"{str(path / MANIFEST)!r} lists no flights: the collection was not finished; run "
            "`swarm-envs collect` again with the same options"
        )
    flights = [
        Flight(
            e["name"],
            e["team"],
            read_log(flight_file(path, e["name"])),
            e["validation"],
            manifest["log_rate"],
        )
        for e in manifest["flights"]
    ]
    label = _config(manifest)["label"]
    rows = interaction_rows(flights, label)
    files = [
        FileReport(
            file=flight_file(path, entry["name"]).name,
            seconds=entry["seconds"],
            rate_hz=manifest["log_rate"],
            acceleration="logged" if label == "imu" else label,
            **_counts(flights[index], int((rows.flight == index).sum())),
        )
        for index, entry in enumerate(manifest["flights"])
    ]
    scenarios = {}
    for index, name in enumerate(rows.scenario_names):
        held_out = rows.validation[rows.scenario == index]
        scenarios[name] = ScenarioReport(int((~held_out).sum()), int(held_out.sum()))
    return rows, LogReport(files, scenarios, {}, len(rows), int(np.sum(rows.validation)))


def _counts(flight: Flight, rows: int) -> dict[str, Any]:
    """Who flew, the entries of all drones, and why some are no rows."""
    team, every = parse_team(flight.team), round(flight.rate_hz / ROW_RATE)
    entries = len(flight.log.position) * len(team)
    kept = len(flight.log.position[::every]) * len(team)
    reason = "no neighbour in the volume, or force unknown" if len(team) > 1 else "force unknown"
    names = (vehicle.token for vehicle in team)
    return {
        "drones": dict(zip(vehicle_names(team), names, strict=True)),
        "entries": entries,
        "rows": rows,
        "dropped": {"between kept entries": entries - kept, reason: kept - rows},
    }


def _config(manifest: dict[str, Any]) -> dict[str, Any]:
    config: dict[str, Any] = manifest.get("config", {})
    return config
