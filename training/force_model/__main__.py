"""Command line of `swarm_envs.training.force_model.fit`."""

from __future__ import annotations

import tyro

from swarm_envs.training.force_model.pipeline import FitConfig, fit


def main() -> None:
    """Fit a force model and say how well it fits."""
    config = tyro.cli(FitConfig, description="Fit a deep set to rows of measured force.")
    report = fit(config)
    print(*report.lines(), f"wrote the weights and the report into {config.out}", sep="\n")


if __name__ == "__main__":
    main()
