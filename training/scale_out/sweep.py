"""Many training runs, one a job: each in a folder of its own, judged on the same frozen seeds."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs import __version__
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.policy import FILE
from swarm_envs.agents.policy_file import read_policy
from swarm_envs.agents.scores import bootstrap_interval, interquartile_mean
from swarm_envs.files import write_json
from swarm_envs.training.rl.config import TrainConfig

SCORES = "scores.json"
"""File in a run's folder with what was measured on the seeds for reporting."""


def write_marker(path: Path, content: object) -> str:
    """Write the file by which workers know that they see the same folder; give its digest.

    Raises:
        OSError: it cannot be written.
    """
    write_json(path, content)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_marker(path: Path, digest: str) -> None:
    """Refuse a machine that does not see what `write_marker` wrote.

    Raises:
        OSError: it does not; the message names the machine.
    """
    if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise OSError(
            f"machine {platform.node()!r} does not see {str(path)!r} as the one that began the "
            "sweep wrote it; choose a folder by --out on storage that all machines share"
        )


def train_and_judge(config: TrainConfig, task: str, episodes: int, seed: int) -> dict[str, Any]:
    """Train a run, or find it finished, and judge its policy on seeds that nothing was chosen on.

    Args:
        config: of the run; killed, it goes on where it was.
        task: versioned name.
        episodes: on each layout, at the force rate of flights.
        seed: the episodes' seeds are drawn from it, as by `swarm-envs evaluate --seed`.

    Returns:
        `measured`, such as `random_success`; `steps`, `cpu_s` and `wall_s` of the training.

    Raises:
        ImportError: Stable-Baselines3 is not installed.
        OSError: the folder cannot be written, or another process writes into it.
        ValueError: the folder holds another run, or a damaged one.
    """
    from swarm_envs.training.rl.run import finished_report, train

    report = finished_report(config, task) or train(config, task)
    measured = _judged(config, task, episodes, seed)
    return {"measured": measured, **{name: report[name] for name in ("steps", "cpu_s", "wall_s")}}


def _judged(config: TrainConfig, task: str, episodes: int, seed: int) -> dict[str, float]:
    """Measures on the seeds for reporting, as they were written, if of this policy and seeds."""
    from swarm_envs.training.rl.judging import Judges
    from swarm_envs.training.rl.recipes import RECIPES, completed

    policy, path = read_policy(config.out / FILE), config.out / SCORES
    about = {"episodes": episodes, "seed": seed, "policy": policy.digest, "version": __version__}
    if path.is_file():
        written = json.loads(path.read_text(encoding="utf-8"))
        if all(written.get(name) == value for name, value in about.items()):
            found: dict[str, float] = written["measured"]
            return found
    layouts = RECIPES[task].judged_on(str(completed(config, task).layout))
    options = {"interactions": config.interactions}
    judges = Judges(task, layouts, frozen_seeds(seed, episodes), options, config.teams)
    try:
        measured = judges.judge(policy)
    finally:
        judges.close()
    write_json(path, {**about, "measured": measured})
    return measured


def summary(runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Interquartile mean over training seeds of each measure, with its bootstrap interval.

    Args:
        runs: as `train_and_judge` gives them, one a seed; at least one.
    """
    found = {}
    for name in runs[0]["measured"]:
        values = np.array([run["measured"][name] for run in runs])
        found[name] = {
            "iqm": float(interquartile_mean(values)),
            "interval": bootstrap_interval(values),
            "each": values.tolist(),
        }
    return found
