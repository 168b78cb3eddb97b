"""Command line of `swarm_envs.training.force_model.fit`."""

from __future__ import annotations

import tyro

from swarm_envs.training.force_model.pipeline import FitConfig, fit


def main() -> None:
    """Fit a force model and say how well it fits."""
    config = tyro.cli(FitConfig, description="Fit a deep set to rows of measured force.")
    report = fit(config)
    for line in report.logs.lines() if report.logs else ():
        print(line)
    errors = report.findings.errors
    print(
        f"validation MSE {errors.overall:.2f} g^2 (zero {errors.zero:.2f}, scenario mean "
        f"{errors.scenario_mean:.2f}); report in {config.out / 'learned.json'}"
    )


if __name__ == "__main__":
    main()
