"""A training run from its options to its report: begun, gone on with, or found finished.

Read this first, then `learner` (what the algorithms share) and one of `ppo`, `sac`, `mappo` and
`dagger`.
"""

from __future__ import annotations

import importlib.util
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.policy import CHECKPOINT, FILE, Policy, PolicyNote, write_policy
from swarm_envs.files import claimed, write_json, write_table
from swarm_envs.training.force_model.export import write_safetensors
from swarm_envs.training.provenance import check_same, json_ready, scalar_writer
from swarm_envs.training.rl.learner import Learner, make_learner
from swarm_envs.training.rl.recipes import choosing_seeds, evaluate_policy, recipe_of, with_recipe
from swarm_envs.training.rl.rl_config import RlConfig

__all__ = ["finished_report", "train_policy"]

REPORT, CURVE = "report.json", "curve.csv"
"""Files of a run: its report, where it continues, and its curve."""
_NO_RESULT = ("out", "json", "progress", "tensorboard", "threads")
"""Options that change nothing of the policy."""
_EARLIER = {
    **{"action": "acceleration", "activation": "tanh", "encoder": "mlp", "pooling": "mean"},
    **{"set_hidden": [32, 32], "per_type": False, "most": None, "start": None, "start_kl": 0.0},
    **{"time_cost": 0.0, "num_obstacles": 0, "observe_load": None, "observe_force": False},
    **{"features": None, "controller": None},
}
"""What all runs did before there was an option for it."""


@dataclass
class _Progress:
    """State of a run: what its checkpoint holds besides tensors."""

    config: dict[str, Any]
    rollouts: int
    history: list[dict[str, float]]
    judged: list[dict[str, float]]
    best: float | None
    cpu_s: float
    wall_s: float


def train_policy(config: RlConfig, task: str) -> dict[str, Any]:
    """Train to the end and return the report, which is also written.

    Raises:
        BlockingIOError: another process writes into the folder.
        ImportError: Stable-Baselines3 is not installed.
        OSError: the folder cannot be written.
        ValueError: the folder holds another run, or a damaged one.
    """
    config = with_recipe(config, task)
    with claimed(config.out):
        learner = make_learner(config, task)
        try:
            progress = _begin(config, task, learner)
            _train_segments(config, task, learner, progress)
        finally:
            learner.close()
        report = {
            "config": progress.config,
            "steps": progress.rollouts * config.rollout_steps,
            "chosen": max(reversed(progress.judged), key=recipe_of(task).quality),
            "last": progress.judged[-1],
            "cpu_s": round(progress.cpu_s, 1),
            "wall_s": round(progress.wall_s, 1),
            "version": __version__,
        }
        write_json(config.out / REPORT, report)
    return report


def _begin(config: RlConfig, task: str, learner: Learner) -> _Progress:
    options, path = result_options(config, task), config.out / CHECKPOINT
    if not path.is_file():
        return _Progress(options, 0, [], [], None, 0.0, 0.0)
    progress = _Progress(**_load_checkpoint(path, learner, options))
    write_table(config.out / CURVE, _curve(progress))  # its last rows may not have been written
    steps = progress.rollouts * config.rollout_steps
    tqdm.write(f"resuming from the checkpoint at {steps:,} steps in {config.out}")
    return progress


def _train_segments(config: RlConfig, task: str, learner: Learner, progress: _Progress) -> None:
    wanted = config.tensorboard and importlib.util.find_spec("tensorboard") is not None
    segments = config.segments()
    bar = tqdm(
        total=config.rollouts * config.rollout_steps,
        initial=progress.rollouts * config.rollout_steps,
        unit="step",
        unit_scale=True,
        desc="train",
        disable=not config.progress,
        mininterval=0.5,
    )

    def watch() -> None:
        said = "success {success:.0%}, collisions {collision:.0%}".format(**learner.rates())
        bar.set_postfix_str(said, refresh=False)
        bar.update(config.rollout_steps)

    with scalar_writer(config.out / "tensorboard" if wanted else None) as log, bar:
        for number, segment in enumerate(segments, 1):
            if segment.start < progress.rollouts:
                continue
            clocks = time.process_time(), time.monotonic()
            entry = learner.fly(segment, watch)
            progress.rollouts = segment.stop
            progress.history.append(entry)
            if number % config.judge_every == 0 or number == len(segments):
                _evaluate(config, task, learner, progress)
                entry = {**entry, **progress.judged[-1]}
            progress.cpu_s += time.process_time() - clocks[0]
            progress.wall_s += time.monotonic() - clocks[1]
            _save_checkpoint(config.out / CHECKPOINT, learner, progress)
            write_table(config.out / CURVE, _curve(progress))
            if log is not None:
                log(entry)


def _evaluate(config: RlConfig, task: str, learner: Learner, progress: _Progress) -> None:
    recipe, steps = recipe_of(task), progress.rollouts * config.rollout_steps
    about = {"config": progress.config, "steps": steps, "version": __version__}
    policy = Policy(policy_note(learner, task), learner.actor(), about)
    rates = evaluate_policy(
        policy,
        task,
        recipe.evaluation_layouts(str(config.layout)),
        choosing_seeds(config.judge_episodes),
        {"interactions": config.interactions, "force_rate": config.force_rate, **config.air()},
        config.teams,
    )
    quality = recipe.quality(rates)
    progress.judged.append({"step": float(steps), **rates})
    if progress.best is None or quality >= progress.best:
        progress.best = quality
        chosen = Policy(policy.note, policy.networks, {**about, "chosen_by": rates})
        write_policy(config.out / FILE, chosen)


def policy_note(learner: Learner, task: str) -> PolicyNote:
    """What a run's policy is trained for."""
    config = learner.config
    return PolicyNote(
        task,
        max(config.team_sizes) if config.most is None else config.most,
        config.action,
        config.decision_rate,
        config.num_neighbors,
        features=learner.features,
        encoder=config.encoder,
        pooling=config.pooling,
        types=learner.types,
        per_type=config.per_type,
        fewest=min(config.team_sizes) if config.fewest is None else config.fewest,
        activation=config.activation,
        num_obstacles=config.num_obstacles or 0,
        observe_load=bool(config.observe_load),
        observe_force=config.observe_force,
        controller=config.controller or "",
    )


def _curve(progress: _Progress) -> list[dict[str, Any]]:
    """History and evaluations in one table; empty where a checkpoint was not evaluated."""
    judged = {entry["step"]: entry for entry in progress.judged}
    names = [name for entry in progress.judged[:1] for name in entry if name != "step"]
    return [
        {**entry, **{name: judged.get(entry["step"], {}).get(name, "") for name in names}}
        for entry in progress.history
    ]


def result_options(config: RlConfig, task: str) -> dict[str, Any]:
    """What the policy depends on, ready for JSON."""
    config = with_recipe(config, task)
    names = [f.name for f in fields(config) if f.name not in _NO_RESULT and config.uses(f.name)]
    options = {name: getattr(config, name) for name in names}
    ready: dict[str, Any] = json.loads(json.dumps(json_ready({**options, "task": task})))
    return ready


def finished_report(config: RlConfig, task: str) -> dict[str, Any] | None:
    """The report of the same run, if it has ended; None if there is none.

    Raises:
        ValueError: the folder holds the report of another run, or what is no report.
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
    _check_same_run(path, made, result_options(config, task))
    return report


def _check_same_run(path: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuse the file of a run with other options; of two algorithms tell the names alone."""
    there = {**{name: old for name, old in _EARLIER.items() if name in here}, **there}
    if there.get("algo") != here["algo"]:
        there, here = {"algo": there.get("algo")}, {"algo": here["algo"]}
    check_same(path, there, here)


def _save_checkpoint(path: Path, learner: Learner, progress: _Progress) -> None:
    metadata = {"progress": json.dumps(vars(progress), allow_nan=False)}
    write_safetensors(path, learner.tensors(), metadata)


def _load_checkpoint(path: Path, learner: Learner, config: Mapping[str, Any]) -> dict[str, Any]:
    """Put a fresh learner where the checkpoint stands, and return its progress."""
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            progress: dict[str, Any] = json.loads((file.metadata() or {})["progress"])
        missing = {"config", "rollouts", "history", "judged"} - progress.keys()
        if missing:
            raise KeyError(*missing)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"checkpoint {str(path)!r} is damaged ({error}); delete the folder and train again"
        ) from error
    _check_same_run(path, progress["config"], config)
    try:
        learner.load(tensors)
    except (KeyError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"checkpoint {str(path)!r} does not fit the networks of its own options ({error}); "
            "delete the folder and train again"
        ) from error
    return progress
