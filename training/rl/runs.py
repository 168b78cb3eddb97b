"""The common parts of runs of all algorithms: environments, evaluation, and files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, NamedTuple

from swarm_envs.agents.features import TYPES, FeatureSizes, feature_sizes
from swarm_envs.agents.networks import Network
from swarm_envs.agents.policy import FILE, Policy, PolicyNote, observation_options, write_policy
from swarm_envs.envs.options import Blueprint, batch_of
from swarm_envs.errors import check_type
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.learning import Parts
from swarm_envs.training.provenance import check_same, json_ready
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.validation import (
    evaluate_policy,
    learning_of,
    validation_seeds,
    with_defaults,
)
from swarm_envs.user_files import file_digest

__all__ = ["finished_report", "train_policy"]

REPORT = "report.json"  # The file of a complete run
FORCE_RATE = 48  # Rate at which interaction forces are computed in training, Hz
_NO_RESULT = ("out", "json", "progress", "threads")  # Options that do not change the policy


class Setting(NamedTuple):
    """The environments of a run, and the observations of its policy."""

    config: RlConfig  # Options with the task's defaults
    task: str  # Versioned name
    blueprints: list[Blueprint]  # Blueprint of each team
    sizes: FeatureSizes  # Numbers of features
    types: tuple[str, ...]  # Vehicle types

    def note(self) -> PolicyNote:
        """Return the description of the environments that the policy is trained for."""
        config = self.config
        return PolicyNote(
            self.blueprints[0].task.name,
            max(config.team_sizes) if config.most is None else config.most,
            config.action,
            config.decision_rate,
            config.num_neighbors,
            types=self.types,
            fewest=min(config.team_sizes) if config.fewest is None else config.fewest,
            activation="relu" if config.imitates else "tanh",
            num_obstacles=config.num_obstacles or 0,
            observe_load=bool(config.observe_load),
            observe_force=config.observe_force,
            observe_setpoint=config.observe_setpoint,
            controller=config.controller or "",
        )


def make_setting(config: RlConfig, task: str) -> Setting:
    """Return the setting of a run.

    Raises:
        ValueError: an option has an invalid value.
    """
    config = with_defaults(config, task)
    blueprints = [training_blueprint(config, task, team) for team in config.teams]
    present = {vehicle.token for found in blueprints for vehicle in found.task.team}
    flown = tuple(token for token in TYPES if token in present)
    sizes = feature_sizes(config.num_neighbors, *observed_in_rows(config))
    return Setting(config, task, blueprints, sizes, flown)


def training_blueprint(config: RlConfig, task: str, team: Mapping[str, Any]) -> Blueprint:
    """Return the training environment of a team, one of `config.teams`, from the curriculum.

    Raises:
        ValueError: an option has an invalid value.
    """
    learning, world = learning_of(task), config.world_options()
    chosen = world.pop("reward_weights", {})
    check_type("reward_weights", chosen, Mapping)
    options = {
        **learning.layouts[str(config.layout)],
        **team,
        "reward_weights": {**learning.reward_weights, **chosen},
        "interactions": config.interactions,
        "action": config.action,
        "decision_rate": config.decision_rate,
        "force_rate": FORCE_RATE,
        "num_neighbors": config.num_neighbors,
        "horizon_s": config.horizon_s,
        "threads": config.threads,
        **observation_options(*observed_in_rows(config), config.controller),
        **world,
    }
    found = batch_of(task, **options)
    flown = learning.curriculum(found.task, str(config.layout))
    clock = config.horizon_s or flown.episode_s
    weights = dict(flown.reward_weights)
    for name in learning.reward_weights.keys() & {"at_goal", "tracking"} - chosen.keys():
        weights[name] = weights[name] / clock  # the task integrates these over time
    return found._replace(task=flown.as_kind(type(flown), reward_weights=weights))


def parts_of(config: RlConfig, task: str, trained: Task) -> Parts:
    """Return the parts of a training task, which keep the fields that `--env` gives."""
    names = {field.name for field in fields(trained)} - {"reward_weights"}
    own = {name: getattr(trained, name) for name in names.intersection(config.env_options())}
    parts = learning_of(task).parts(trained, str(config.layout))
    return {name: (share, each.as_kind(type(each), **own)) for name, (share, each) in parts.items()}


def observed_in_rows(config: RlConfig) -> tuple[int, bool, bool, bool]:
    """Return M of a policy's rows, and True for each of loads, forces and set-points they have."""
    extra = (bool(config.observe_load), config.observe_force, config.observe_setpoint)
    return config.num_obstacles or 0, *extra


class Evaluation:
    """Validation of the policies of a run, which saves the best one in its folder.

    Args:
        setting: the setting of the run.
        results: the results of earlier evaluations of a resumed run.
    """

    def __init__(self, setting: Setting, results: list[dict[str, float]] | None = None) -> None:
        self.setting, self.results = setting, results or []

    def add(self, network: Network, steps: int) -> dict[str, float]:
        """Evaluate a network after a number of steps; return the means of its measures."""
        config, task = self.setting.config, self.setting.task
        learning = learning_of(task)
        policy = Policy(self.setting.note(), network, {})
        rates = evaluate_policy(
            policy,
            task,
            learning.evaluation_layouts(str(config.layout)),
            validation_seeds(config.evaluation_episodes),
            {
                "interactions": config.interactions,
                "force_rate": FORCE_RATE,
                **config.world_options(),
            },
            config.teams,
            config.progress,
        )
        before = [learning.quality(result) for result in self.results]
        self.results.append({"step": float(steps), **rates})
        if not before or learning.quality(rates) >= max(before):
            about = {"config": result_options(config, task), "steps": steps, "chosen_by": rates}
            write_policy(config.out / FILE, replace(policy, provenance=about))
        return rates

    @property
    def best(self) -> dict[str, float]:
        """Result of the policy that was kept."""
        quality = learning_of(self.setting.task).quality
        return max(reversed(self.results), key=quality)


def result_options(config: RlConfig, task: str) -> dict[str, Any]:
    """Return the options on which the policy depends, ready for JSON."""
    config = with_defaults(config, task)
    foreign = ("set",) if config.imitates else ("start", "dagger")
    names = [f.name for f in fields(config) if f.name not in (*_NO_RESULT, *foreign)]
    options = {name: getattr(config, name) for name in names}
    own = {name: file_digest(str(getattr(config, name))) for name in ("task", "interactions")}
    options |= {f"file of {name}": digest for name, digest in own.items() if digest}
    ready: dict[str, Any] = json.loads(json.dumps(json_ready({**options, "task": task})))
    return ready


def finished_report(config: RlConfig, task: str) -> dict[str, Any] | None:
    """Return the report of the same run if it is complete, else None.

    A run of Stable-Baselines3 is not complete if more steps are requested than it made.

    Raises:
        ValueError: the folder has the report of another run, or the report is damaged.
    """
    path = config.out / REPORT
    if not path.is_file():
        return None
    try:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        made = dict(report["config"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{str(path)!r} is no report of a training run ({error}); choose another folder"
        ) from error
    options = result_options(config, task)
    if not config.imitates and options["steps"] > made.get("steps", math.inf):
        check_same(path, made | {"steps": options["steps"]}, options)
        return None  # Stable-Baselines3 goes on from the last model
    check_same(path, made, options)
    return report


def train_policy(config: RlConfig, task: str) -> dict[str, Any]:
    """Train a policy, and write and return the report.

    Raises:
        BlockingIOError: another process writes to the folder.
        ImportError: Stable-Baselines3 is not installed.
        OSError: the folder cannot be written.
        ValueError: the folder has another run, or a damaged one.
    """
    if config.imitates:
        from swarm_envs.training.rl.dagger import train_dagger

        return train_dagger(config, task)
    from swarm_envs.training.rl.sb3 import train_sb3

    return train_sb3(config, task)
