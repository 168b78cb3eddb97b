"""Imported by a server of processes: its children find loaded what a training needs."""

from __future__ import annotations

import tempfile

import swarm_envs.training.rl.mappo
import swarm_envs.training.rl.ppo
import swarm_envs.training.rl.sac  # noqa: F401
from swarm_envs.cli import main

TINY = [
    *("--drones", "2", "--environments", "8", "--n-steps", "8", "--batch-size", "64"),
    *("--hidden", "8", "8", "--steps", "100", "--judge-episodes", "4", "--num-neighbors", "1"),
    *("--interactions", "none", "--n-epochs", "2", "--no-tensorboard", "--no-progress"),
]

with tempfile.TemporaryDirectory() as folder:
    main(["train", *TINY, "--out", folder])
