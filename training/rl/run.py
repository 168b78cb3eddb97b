"""A training run from its options to its report: begun, gone on with, or found finished."""

from __future__ import annotations

import importlib.util
import json
import time
from dataclasses import dataclass, fields
from typing import Any

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.policy import CHECKPOINT, FILE
from swarm_envs.agents.policy_file import Policy, PolicyNote, write_policy
from swarm_envs.files import claimed, write_json, write_table
from swarm_envs.training.force_model.tensorboard import scalar_writer
from swarm_envs.training.provenance import json_ready
from swarm_envs.training.rl.checkpoint import differing_runs, load_checkpoint, save_checkpoint
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.judging import Judges, choosing_seeds
from swarm_envs.training.rl.learner import Learner, make_learner
from swarm_envs.training.rl.practice import Practice
from swarm_envs.training.rl.recipes import RECIPES, completed

REPORT, CURVE = "report.json", "curve.csv"
"""Files of a run: its report, where it goes on, and its curve."""
_NO_RESULT = ("out", "json", "progress", "tensorboard", "threads")
"""Options that change nothing of the policy."""


def result_options(config: TrainConfig, task: str) -> dict[str, Any]:
    """What the policy depends on, ready for JSON."""
    config = completed(config, task)
    names = [f.name for f in fields(config) if f.name not in _NO_RESULT and config.uses(f.name)]
    options = {name: getattr(config, name) for name in names}
    ready: dict[str, Any] = json.loads(json.dumps(json_ready({**options, "task": task})))
    return ready


def finished_report(config: TrainConfig, task: str) -> dict[str, Any] | None:
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
    differences = differing_runs(made, result_options(config, task))
    if differences:
        raise ValueError(
            f"{str(path)!r} is of a finished run with other options: {differences}; choose another "
            "folder by --out: it is not overwritten"
        )
    return report


@dataclass
class _Standing:
    """Where a run stands; what its checkpoint says beside weights."""

    config: dict[str, Any]
    rollouts: int
    history: list[dict[str, float]]
    judged: list[dict[str, float]]
    best: float | None
    cpu_s: float
    wall_s: float


def train(config: TrainConfig, task: str) -> dict[str, Any]:
    """Train to the end and return the report, which is also written.

    Raises:
        BlockingIOError: another process writes into the folder.
        ImportError: Stable-Baselines3 is not installed.
        OSError: the folder cannot be written.
        ValueError: the folder holds another run, or a damaged one.
    """
    with claimed(config.out):
        return _train(completed(config, task), task)


def _train(config: TrainConfig, task: str) -> dict[str, Any]:
    learner = make_learner(config, task)
    judges = Judges(
        task,
        RECIPES[task].judged_on(str(config.layout)),
        choosing_seeds(config.judge_episodes),
        {"interactions": config.interactions, "force_rate": config.force_rate},
        config.teams,
    )
    try:
        standing = _begin(config, task, learner)
        _go_on(config, task, learner, judges, standing)
    finally:
        learner.close()
        judges.close()
    report = _report(config, task, standing)
    write_json(config.out / REPORT, report)
    return report


def _begin(config: TrainConfig, task: str, learner: Learner) -> _Standing:
    """A new run, or one that goes on from its checkpoint, and says so."""
    depends, path = result_options(config, task), config.out / CHECKPOINT
    if not path.is_file():
        return _Standing(depends, 0, [], [], None, 0.0, 0.0)
    standing = _Standing(**load_checkpoint(path, learner, depends))
    steps = standing.rollouts * config.rollout_steps
    tqdm.write(f"going on from the checkpoint at {steps:,} steps in {config.out}")
    return standing


def _go_on(
    config: TrainConfig, task: str, learner: Learner, judges: Judges, standing: _Standing
) -> None:
    """Train what is left, with a checkpoint after each segment."""
    events = config.out / "tensorboard" if config.tensorboard and _has_tensorboard() else None
    total, done = config.rollouts * config.rollout_steps, standing.rollouts * config.rollout_steps
    segments = config.segments()
    with (
        scalar_writer(events) as log,
        tqdm(
            total=total,
            initial=done,
            unit="step",
            unit_scale=True,
            desc="train",
            disable=not config.progress,
            mininterval=0.5,
        ) as bar,
    ):

        def watch() -> None:
            ended = max(learner.env.episodes, 1)
            success, collision = learner.env.successes / ended, learner.env.collisions / ended
            bar.set_postfix_str(f"success {success:.0%}, collisions {collision:.0%}", refresh=False)
            bar.update(config.rollout_steps)

        for number, segment in enumerate(segments, 1):
            if segment.start < standing.rollouts:
                continue
            clocks = time.process_time(), time.monotonic()
            entry = learner.fly(segment, watch)
            standing.rollouts = segment.stop
            standing.history.append(entry)
            if number % config.judge_every == 0 or number == len(segments):
                _judge(config, task, learner, judges, standing)
                entry = {**entry, **standing.judged[-1]}
            standing.cpu_s += time.process_time() - clocks[0]
            standing.wall_s += time.monotonic() - clocks[1]
            save_checkpoint(config.out / CHECKPOINT, learner, vars(standing))
            write_table(config.out / CURVE, _curve(standing))
            if log is not None:
                log(entry)


def _judge(
    config: TrainConfig, task: str, learner: Learner, judges: Judges, standing: _Standing
) -> None:
    """Judge the policy, and keep it if none before was better."""
    steps = standing.rollouts * config.rollout_steps
    note = policy_note(config, task, learner.env)
    about = {"config": standing.config, "steps": steps, "version": __version__}
    policy = Policy(note, learner.actor(), about)
    rates = judges.judge(policy)
    quality = RECIPES[task].quality(rates)
    standing.judged.append({"step": float(steps), **rates})
    if standing.best is None or quality >= standing.best:
        standing.best = quality
        write_policy(
            config.out / FILE, Policy(note, policy.networks, {**about, "chosen_by": rates})
        )


def policy_note(config: TrainConfig, task: str, env: Practice) -> PolicyNote:
    """What a run's policy is trained for."""
    return PolicyNote(
        task,
        max(config.team_sizes),
        config.action,
        config.decision_rate,
        config.num_neighbors,
        features=env.features,
        encoder=config.encoder,
        pooling=config.pooling,
        types=env.types,
        per_type=config.per_type,
        fewest=min(config.team_sizes) if config.fewest is None else config.fewest,
    )


def _has_tensorboard() -> bool:
    return importlib.util.find_spec("tensorboard") is not None


def _curve(standing: _Standing) -> list[dict[str, Any]]:
    """History and judgements in one table; empty where a checkpoint was not judged."""
    judged = {entry["step"]: entry for entry in standing.judged}
    names = [name for entry in standing.judged[:1] for name in entry]
    return [
        {**entry, **{n: judged.get(entry["step"], {}).get(n, "") for n in names if n != "step"}}
        for entry in standing.history
    ]


def _report(config: TrainConfig, task: str, standing: _Standing) -> dict[str, Any]:
    best = max(reversed(standing.judged), key=RECIPES[task].quality)
    return {
        "config": standing.config,
        "steps": standing.rollouts * config.rollout_steps,
        "chosen": best,
        "last": standing.judged[-1],
        "cpu_s": round(standing.cpu_s, 1),
        "wall_s": round(standing.wall_s, 1),
        "version": __version__,
    }
