"""`swarm-envs fit`: a force model, or what a force model leaves over."""

from __future__ import annotations

from dataclasses import dataclass, fields

from swarm_envs.commands.checks import check_inputs, check_outputs, need_torch
from swarm_envs.files import claimed
from swarm_envs.training.force_model.force_fit_config import FitConfig, ResidualConfig


@dataclass(frozen=True, kw_only=True)
class FitOptions(FitConfig):
    """Fit a model of the interaction forces to flight logs or to rows of measured force.

    Writes the model and a report of its errors. Most fits need no more than --data, --out, --model,
    --mode and --seed. With --residual, it identifies what a force model leaves over, the random
    force of the hall.

    Columns of a flight log, SI units, world frame: time (s), drone, type (S, L or S*), x y z (m),
    vx vy vz (m/s), qx qy qz qw, ax ay az (m/s^2, +9.81 in hover; optional), pwm1 to pwm4 (0 to
    65535), voltage (V).
    """

    residual: bool = False
    """fit no model, but write into residual.json what --force leaves over; of the other options,
    this takes --data, --out, --steps, --seed, --progress, --json and --logs.* alone"""
    force: str = "composed"
    """with --residual: `composed`, that of environments, or `wake`, refitted for each fold of
    flights; or the file of a model, which is taken as it is, so that flights it was fitted to
    flatter it"""
    folds: int = 5
    """with --residual: parts into which the flights of each scenario are dealt"""
    bootstrap: int = 400
    """with --residual: draws of flights for the 95 % intervals"""

    def config(self) -> FitConfig | ResidualConfig:
        """Return the configuration of the fit, or of the identification with `residual`."""
        kind = ResidualConfig if self.residual else FitConfig
        return kind(**{field.name: getattr(self, field.name) for field in fields(kind)})


def run_fit(options: FitOptions) -> None:
    """Fit, write and print."""
    check_outputs(options.out, options.json)
    need_torch()
    check_inputs(options)
    config = options.config()
    with claimed(options.out):
        if isinstance(config, ResidualConfig):
            from swarm_envs.training.force_model.residual_fit import fit_residual

            report = fit_residual(config).lines()
        else:
            from swarm_envs.training.force_model.pipeline import fit

            report = [*fit(config).lines(), *config.how_to_use()]
    print(*report, f"wrote the model and the report into {config.out}", sep="\n")
