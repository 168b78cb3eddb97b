"""`swarm-envs train`: train a policy by reinforcement or imitation learning."""

from __future__ import annotations

import importlib.util
import inspect
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from swarm_envs.commands.checks import as_misuse, check_inputs, check_outputs, need_torch
from swarm_envs.commands.fly import find_task
from swarm_envs.errors import unknown_name
from swarm_envs.training.rl.rl_config import RlConfig

TrainOptions = RlConfig
"""Options of the command."""
_EVALUATES = {"physics", "force_rate"}  # Options that `evaluate` has and `train` has not


def check_training(config: RlConfig) -> str:
    """Return the versioned name of the task; raise Misuse if the options are invalid."""
    check_outputs(config.out, config.json, (".json",))
    from swarm_envs.training.rl.runs import make_setting

    with as_misuse(TypeError):  # an unknown option in --env
        task = find_task(config.task)
        make_setting(config, task)
    return task


def check_teachers(teachers: Sequence[str]) -> None:
    """Raise Misuse if a teacher is no agent; a layout and a team size may precede its name."""
    from swarm_envs.agents import load

    with as_misuse(FileNotFoundError):
        for teacher in teachers:
            load(teacher.rpartition("=")[2])


def check_algorithm(config: RlConfig, task: str) -> None:
    """Raise Misuse if the algorithm does not exist, or does not take the given arguments."""
    from swarm_envs.training.rl.runs import make_setting
    from swarm_envs.training.rl.sb3 import algorithm_of, arguments_of

    with as_misuse():
        found = inspect.signature(algorithm_of(config.algo)).parameters
        taken = [name for name in found if name not in ("self", "policy", "env")]
        takes_all = any(each.kind is each.VAR_KEYWORD for each in found.values())
        for name in arguments_of(make_setting(config, task)):
            if name not in taken and not takes_all:
                why = unknown_name("argument", name, taken)
                raise ValueError(f"--algo {config.algo} refuses its arguments: {why}")


def run_train(config: RlConfig) -> None:
    """Train unless the run is complete, and print the results."""
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
        print(f"the run in {config.out} is already complete and was not changed")
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
    without = ", without the randomization of its training" if config.randomization else ""
    print(f"to evaluate it{without}:", shlex.join(words))


def setting(config: RlConfig) -> list[str]:
    """Return the environment of the run with its largest team, as options of `evaluate`."""
    words = ["--task", config.task]
    given = {"layout": config.layout, **replace(config, env=()).world_options()}
    given.pop("randomization", None)  # which is for training
    for name, value in given.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    options = config.env_options()
    for name in sorted(options.keys() & _EVALUATES):
        words += [f"--{name.replace('_', '-')}", str(options[name])]
    others = [entry for entry in config.env if entry.partition("=")[0] not in _EVALUATES]
    words += ["--env", *others] if others else []
    if config.interactions != "learned":
        words += ["--interactions", config.interactions]
    if not config.teams:
        return words
    largest = max(config.team_sizes)
    if config.team:
        return [*words, "--team", config.team[config.team_sizes.index(largest)]]
    return [*words, "--drones", str(largest)]


def _summary(report: dict[str, Any]) -> str:
    chosen = dict(report["chosen"])
    lines = [
        f"{report['steps']:,} steps in {report['wall_s']:.0f} s ({report['cpu_s']:.0f} s of CPU)",
        f"best policy, after {chosen.pop('step'):,.0f} steps, on the validation seeds:",
    ]
    for name, value in chosen.items():
        shown = f"{100 * value:.1f} cm" if name.endswith("_m") else f"{value:.4g}"
        if name.endswith(("_success", "_crash", "_collision")):
            shown = f"{value:.1%}"
        lines.append(f"  {name}: {shown}")
    if suggested := report.get("next"):
        lines += ["suggestions:", *(f"- {each}" for each in suggested)]
    return "\n".join(lines)
