"""Command line of `swarm_envs.training.collection.collect`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from swarm_envs.training.collection.collect import collect
from swarm_envs.training.collection.config import CollectionConfig
from swarm_envs.training.collection.flight import LOG_RATE
from swarm_envs.training.collection.table import interaction_rows
from swarm_envs.training.force_model.rows import save_rows


@dataclass(frozen=True, kw_only=True)
class CollectOptions:
    """Fly drones through each other's wakes in the environment and log them."""

    out: Path
    """folder for the flights, the manifest and the table `rows.npz`"""
    config: CollectionConfig = CollectionConfig()
    """what to fly"""
    progress: bool = True
    """show a progress bar"""


def run(options: CollectOptions) -> None:
    """Collect, and say what was collected."""
    flights = collect(options.config, options.out, options.progress)
    table = options.out / "rows.npz"
    rows = interaction_rows(flights)
    save_rows(table, rows)
    seconds = sum(len(flight.log.position) for flight in flights) / LOG_RATE
    print(f"{len(flights)} flights, {seconds:.0f} s, {len(rows)} rows in {table}")


if __name__ == "__main__":
    run(tyro.cli(CollectOptions, config=(tyro.conf.OmitArgPrefixes,)))
