"""`swarm-envs fit`: fit a force model, or identify its residual force."""

from __future__ import annotations

from swarm_envs.commands.checks import check_inputs, check_outputs, need_torch
from swarm_envs.files import claimed
from swarm_envs.training.force_model.force_fit_config import WEIGHTS, FitConfig

FitOptions = FitConfig
"""Options of the command."""


def run_fit(config: FitConfig) -> None:
    """Check the options, fit, write and print."""
    check_outputs(config.out, config.json)
    need_torch()
    check_inputs(config)
    with claimed(config.out):
        if config.residual:
            from swarm_envs.training.force_model.residual_fit import fit_residual

            report = fit_residual(config).lines()
        else:
            from swarm_envs.training.force_model.pipeline import fit

            path = config.out / WEIGHTS[config.model]
            report = [
                *fit(config).lines(),
                f"fly it: swarm-envs fly --interactions {path}",
                f'in Python: swarm_envs.make("swap_v1", interactions="{path}")',
            ]
    print(*report, f"wrote the model and the report into {config.out}", sep="\n")
