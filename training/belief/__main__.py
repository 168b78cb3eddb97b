"""Command line of `swarm_envs.training.belief.fit_feedforward`."""

from __future__ import annotations

import tyro

from swarm_envs.training.belief.feedforward import FeedforwardConfig, fit_feedforward


def _main() -> None:
    about = "Fit the force model that the compensated controller feeds forward."
    config = tyro.cli(FeedforwardConfig, description=about)
    report = fit_feedforward(config)
    errors = report["fit"].findings.errors
    print(f"validation MSE {errors.overall:.2f} g^2 (of zero force: {errors.zero:.2f} g^2)")
    for j in report["judgements"]:
        print(
            f"{j.team:5} radius {j.layout.radius_m} m, {j.layout.duration_s} s: "
            f"{j.uncompensated_median_cm:5.1f} -> {j.compensated_median_cm:4.1f} cm, "
            f"{j.worse} of {j.episodes} worse"
        )
    print(f"report in {config.out / report['name']}.json, {report['wall_time_s']:.0f} s")


if __name__ == "__main__":
    _main()
