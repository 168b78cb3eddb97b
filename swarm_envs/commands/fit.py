"""`swarm-envs fit`: fit a force model, or identify its residual force."""

from __future__ import annotations

from dataclasses import dataclass, fields

from swarm_envs.commands.checks import check_inputs, check_outputs, need_torch
from swarm_envs.files import claimed
from swarm_envs.training.force_model.force_fit_config import FitConfig, ResidualConfig


@dataclass(frozen=True, kw_only=True)
class FitOptions(FitConfig):
    """Fit a model of the aerodynamic forces between drones to flight logs or measured forces.

    The command writes the model and a report of its errors. Most fits need only --data, --out,
    --model, --mode and --seed. With --residual, it fits no model but identifies the residual force,
    the part of the measured force that a model does not explain, which acts at random in the world
    `hall`.

    Columns of a flight log, SI units, world frame: time (s), drone, type (S, L or S*), x y z (m),
    vx vy vz (m/s), qx qy qz qw, ax ay az (m/s^2, +9.81 in hover; optional), pwm1 to pwm4 (0 to
    65535), voltage (V).
    """

    residual: bool = False
    """Write the statistics of the residual force of the model --force to residual.json. Used with
    --data, --out, --steps, --seed, --progress, --json, --logs.* and the options below only."""
    force: str = "composed"
    """With --residual, the force model: `composed` (that of the environments) or `wake`, refitted
    for each fold of the flights; or the file of a model, whose error is too small on flights that
    it was fitted to."""
    folds: int = 5
    """With --residual, the number of folds of cross-validation of the flights of each scenario."""
    bootstrap: int = 400
    """With --residual, the number of bootstrap samples for the 95 % intervals."""

    def config(self) -> FitConfig | ResidualConfig:
        """Return the configuration of the fit, or of the identification with `residual`."""
        kind = ResidualConfig if self.residual else FitConfig
        return kind(**{field.name: getattr(self, field.name) for field in fields(kind)})


def run_fit(options: FitOptions) -> None:
    """Check the options, fit, write and print."""
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
