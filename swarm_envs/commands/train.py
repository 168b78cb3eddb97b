"""`swarm-envs train`: a policy by reinforcement learning."""

from __future__ import annotations

import importlib.util
import inspect
import shlex
from collections.abc import Sequence
from typing import Any

from swarm_envs.commands.checks import as_misuse, check_inputs, check_outputs, need_torch
from swarm_envs.commands.fly import find_task
from swarm_envs.errors import unknown_name
from swarm_envs.training.rl.rl_config import RlConfig

TrainOptions = RlConfig
"""Options of the command."""


def check_training(config: RlConfig) -> str:
    """The versioned name of the task, if the options make a run."""
    check_outputs(config.out, config.json, (".json",))
    from swarm_envs.training.rl.choosing import with_defaults

    with as_misuse():
        task = find_task(config.task)
        with_defaults(config, task)
    return task


def check_teachers(teachers: Sequence[str]) -> None:
    """Refuse teachers that are no agents; parts of the training may stand before a name."""
    from swarm_envs.agents import load

    with as_misuse(FileNotFoundError):
        for teacher in teachers:
            load(teacher.rpartition("=")[2])


def check_algorithm(config: RlConfig, task: str) -> None:
    """Refuse an algorithm that does not exist, and arguments that it does not take."""
    from swarm_envs.training.rl.runs import make_setting
    from swarm_envs.training.rl.sb3 import algorithm_of, arguments_of

    with as_misuse():
        found = inspect.signature(algorithm_of(config.algo)).parameters
        taken = [name for name in found if name not in ("self", "policy", "env")]
        for name in arguments_of(make_setting(config, task)):
            if name not in taken and "kwargs" not in taken:
                said = unknown_name("argument", name, taken)
                raise ValueError(f"--algo {config.algo} refuses its arguments: {said}")


def run_train(config: RlConfig) -> None:
    """Train, or say that it was done before; print what came out."""
    task = check_training(config)
    check_inputs(config)
    if config.imitates:
        check_teachers(config.dagger.teacher)
    need_torch()
    if importlib.util.find_spec("stable_baselines3") is None:
        raise ImportError(
            "training needs Stable-Baselines3; install it by: pip install 'swarm-envs[train]'"
        )
    if not config.imitates:
        check_algorithm(config, task)
    from swarm_envs.files import write_json
    from swarm_envs.training.rl.runs import finished_report, train_policy

    report = finished_report(config, task)
    if report is not None:
        print(f"the run in {config.out} was finished before, and stays as it is")
    else:
        try:
            report = train_policy(config, task)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted; the same command resumes from the last checkpoint in {config.out}"
            ) from None
    if config.json is not None:
        write_json(config.json, report)
    print(_summary(report))
    words = ["swarm-envs", "evaluate", *setting(config), "--agent", str(config.out)]
    print("to evaluate it:", shlex.join(words))


def setting(config: RlConfig) -> list[str]:
    """The largest team and the place that the run was trained with, as `evaluate` takes them."""
    words = ["--task", config.task]
    for name in ("layout", "obstacles", "world"):
        if value := getattr(config, name):
            words += [f"--{name}", value]
    if config.interactions != "learned":
        words += ["--interactions", config.interactions]
    largest = max(config.team_sizes)
    if config.team:
        return [*words, "--team", config.team[config.team_sizes.index(largest)]]
    return [*words, "--drones", str(largest)]


def _summary(report: dict[str, Any]) -> str:
    chosen = dict(report["chosen"])
    lines = [
        f"{report['steps']:,} steps in {report['wall_s']:.0f} s ({report['cpu_s']:.0f} s of CPU)",
        f"kept: the policy at {chosen.pop('step'):,.0f} steps, on the seeds for choosing",
    ]
    for name, value in chosen.items():
        shown = f"{100 * value:.1f} cm" if name.endswith("_m") else f"{value:.4g}"
        if name.endswith(("_success", "_collision")):
            shown = f"{value:.1%}"
        lines.append(f"  {name}: {shown}")
    if suggested := report.get("next"):
        lines += ["to try next:", *(f"- {said}" for said in suggested)]
    return "\n".join(lines)
