"""The scores of a student's agent, as of `swarm-envs evaluate`: the grader flies its actions."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs import make
from swarm_envs.agents import record_episode
from swarm_envs.agents.evaluation import evaluate_agent, score_episodes
from swarm_envs.agents.protocol import AT_ONCE, check_options_agree
from swarm_envs.assignments import Assignment
from swarm_envs.commands.evaluate import EvaluateOptions
from swarm_envs.commands.fly import find_task
from swarm_envs.commands.grading.copies import copied_acts
from swarm_envs.commands.grading.remote import RemoteWork, remote_agent, train_work
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.envs.core import SwarmCore
from swarm_envs.viewing import write_replay
from swarm_envs.viewing.record import Recorder


def grade_agent(
    process: RemoteWork,
    made: Mapping[str, Any],
    assignment: Assignment,
    seeds: list[int],
    shown: str | None,
) -> dict[str, Any]:
    """Fly a student's agent.

    Args:
        process: its process.
        made: what it says of itself.
        assignment: what is flown.
        seeds: of the episodes.
        shown: its name in the recording of the first failure; None for no recording.

    Returns:
        The scores; `privileged`, whether it has asked for the true state; `copied`, the shipped
        agent that acts the same; `failure`, the recording, if an episode was no success.

    Raises:
        WorkFailed: it failed, or requires what it may not.
    """
    if assignment.train_s:
        train_work(process, assignment.train_s)
    task, given = _flown(assignment)
    agent = remote_agent(process, made, {"task": task, "options": given})
    check_options_agree(agent, given)
    env = make(task, **{**given, **agent.requires})
    try:
        episodes = [*evaluate_agent(env, agent, seeds, timed=1)]  # no mark is for speed
        scores = score_episodes(episodes)
        failed = [e["seed"] for e in episodes if not e["metrics"]["success"]]
        if shown is not None and failed:
            scores["failure"] = record_episode(env, agent, failed[0], name=shown)
        copied = copied_acts(env, agent.kept)
    finally:
        env.close()
    return {**scores, "privileged": agent.asked, "copied": copied}


def _flown(assignment: Assignment) -> tuple[str, dict[str, Any]]:
    """The task of an assignment, and the options of its environment."""
    setting = EvaluateOptions(**assignment.flown)
    return find_task(setting.task), setting.setting()


def rehearse(assignment: Assignment) -> None:
    """Import, compile and read what the grading of an agent takes, whatever it requires.

    A work that may replace files can then replace none that is still to be read.
    """
    task, given = _flown(assignment)
    for action in ACTIONS:
        for obstacles in (0, 1):
            env = make(task, **{**given, "action": action, "num_obstacles": obstacles})
            batch, recorder = SwarmCore(env.core.task, env.core.config, AT_ONCE), Recorder()
            batch.reset(range(AT_ONCE))
            batch.step(np.zeros((AT_ONCE, env.core.num_drones, env.core.mode.width)))
            env.reset(seed=0)
            env.step(dict.fromkeys(env.agents, np.zeros(env.core.mode.width, np.float32)))
            recorder.take(env)
            copied_acts(env, [(env.core.rows[0], np.zeros((env.core.num_drones, 3)))])
    with tempfile.TemporaryDirectory() as folder:
        write_replay(Path(folder) / "failure.html", recorder.record())
