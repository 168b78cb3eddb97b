"""Command line of `swarm_envs.training.force_model.fit`."""

from __future__ import annotations

import tyro

from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.pipeline import fit

if __name__ == "__main__":
    config = tyro.cli(FitConfig, description="Fit a deep set to rows of measured force.")
    report = fit(config)
    print(*report.lines(), f"wrote the weights and the report into {config.out}", sep="\n")
