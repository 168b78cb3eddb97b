"""Command line of `swarm_envs.training.collection.collect`."""

from __future__ import annotations

from pathlib import Path

import tyro

from swarm_envs.training.collection.collect import collect
from swarm_envs.training.collection.config import CollectionConfig
from swarm_envs.training.collection.flight import LOG_RATE
from swarm_envs.training.collection.table import interaction_rows
from swarm_envs.training.force_model.rows import save_rows

DEFAULT = CollectionConfig()
"""What is flown unless options say otherwise."""


def run(out: Path, config: CollectionConfig = DEFAULT, progress: bool = True) -> None:
    """Fly drones through each other's wakes in the environment and log them.

    Args:
        out: folder for the flights, the manifest and the table `rows.npz`.
        config: what to fly.
        progress: show a progress bar.
    """
    flights = collect(config, out, progress)
    rows = interaction_rows(flights)
    save_rows(out / "rows.npz", rows)
    seconds = sum(len(flight.log.position) for flight in flights) / LOG_RATE
    print(f"{len(flights)} flights, {seconds:.0f} s, {len(rows)} rows in {out / 'rows.npz'}")


if __name__ == "__main__":
    tyro.cli(run, config=(tyro.conf.OmitArgPrefixes,))
