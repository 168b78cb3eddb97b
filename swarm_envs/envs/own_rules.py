"""Rules that a custom task defines by methods in plain NumPy.

The tasks of the package have kernels instead. The methods are called once per decision for all
environments, after the shared rules:

- `success(world)` returns in which environments the team is done;
- `advance(world)` changes goals and scores;
- `reward_terms(world)` returns reward terms by name.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np

from swarm_envs.errors import check_array, check_type, nearest
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import World
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.motion import write_own_goals
from swarm_envs.tasks.rewards import REWARD_NAMES

__all__ = ["apply_own_rules", "has_own_rules", "write_own_terms"]


def has_own_rules(task: Task) -> bool:
    """Return True if a task defines any of these methods.

    Raises:
        ValueError: one of them is a function, but no method.
    """
    for name in ("success", "reward_terms"):
        rule = getattr(task, name)
        if callable(rule) and not inspect.ismethod(rule):
            raise ValueError(
                f"{name} of task {task.name!r} is {rule!r:.60}, but must be a method of its class: "
                f"def {name}(self, world)"
            )
    own = (task.success, task.advance, task.reward_terms)
    return any(map(inspect.ismethod, own))


def apply_own_rules(task: Task, world: World, flown: BoolArray, end_on_success: bool) -> None:
    """Apply the methods `success` and `advance` of a task, where it has them.

    Args:
        task: the task.
        world: the tables, after the shared rules.
        flown: (E,) environments that have made this decision.
        end_on_success: True if success ends an episode.

    Raises:
        ValueError: one of them raised an exception, `success` did not return (E,) booleans, or
            `advance` set a goal or a score that is not finite.
    """
    if inspect.ismethod(task.success):
        done = np.asarray(_call(task, "success", world))
        if done.dtype != np.bool_ or done.shape != flown.shape:
            raise ValueError(
                f"success of task {task.name!r} returned {done.dtype} of shape {done.shape}, but "
                f"must return booleans of shape {flown.shape}, one for each environment"
            )
        _end(world, done & flown, end_on_success)
    if inspect.ismethod(task.advance):
        before = world.drones["goal"].copy()
        _call(task, "advance", world)
        check_array(f"goal after advance of task {task.name!r}", world.drones["goal"], before.shape)
        score = world.environments["score"]
        check_array(f"score after advance of task {task.name!r}", score, score.shape)
        _send(task, world, (world.drones["goal"] != before).any(axis=-1))


def _call(task: Task, name: str, world: World) -> Any:
    """Call a method of a task.

    Raises:
        ValueError: it raised an exception; the message states the shapes of the arrays.
    """
    try:
        return getattr(task, name)(world)
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = frames[min(1, len(frames) - 1)].filename  # the file of the method, below this call
        frame = [each for each in frames if each.filename == own][-1]
        environments, drones = world.drones["position"].shape[:2]
        raise ValueError(
            f"{name} of task {task.name!r} raised {type(error).__name__}: {error} (line "
            f"{frame.lineno} of {frame.filename}); it is called for all environments at once, with "
            f"world.drones of shape (E, N) = ({environments}, {drones}) and world.environments of "
            f"shape (E,) = ({environments},)"
        ) from error


def _end(world: World, done: BoolArray, end_on_success: bool) -> None:
    """Mark environments (E,) as done, unless their episodes were terminated or done before."""
    e, stages = world.environments, world.goals.shape[1]
    new = done & ~e["terminated"] & ~e["held"]
    crash_free = (world.drones["incidents"] == 0.0).all(axis=1)
    e["held"] |= new
    e["reached"] += new
    e["crash_free_stages"] += new & crash_free
    e["achieved"][new] = 1.0 / stages
    whole = new & (e["reached"] == stages)
    e["succeeded"] |= whole & crash_free
    if end_on_success:
        e["terminated"] |= whole
        e["truncated"] &= ~whole
        e["running"] &= ~whole


def _send(task: Task, world: World, sent: BoolArray) -> None:
    """Update distances and references of drones (E, N) with new goals, at unchanged progress."""
    drones = world.drones
    covered = drones["last_distance"] - drones["distance"]
    away = np.linalg.norm(drones["position"] - drones["goal"], axis=-1)
    drones["distance"][sent] = away[sent]
    drones["last_distance"][sent] = (away + covered)[sent]
    drones["arrival"][sent] = np.inf
    if task.write_reference is write_own_goals:
        drones["reference_position"][sent] = drones["goal"][sent]


def write_own_terms(task: Task, world: World, terms: FloatArray) -> None:
    """Write the reward terms of a task's method into terms (T, E, N), in the order of their names.

    Raises:
        ValueError: the method raised an exception, or a term has no weight, is missing or has a
            wrong shape.
    """
    if not inspect.ismethod(task.reward_terms):
        return
    given, names = _call(task, "reward_terms", world), task.reward_names
    check_type(f"the result of reward_terms of task {task.name!r}", given, Mapping)
    for name, term in given.items():
        if name not in names:
            raise ValueError(
                f"reward_terms of task {task.name!r} returns {name!r}, which has no weight; add it "
                f"to default_weights ({nearest(name, names)})"
            )
        terms[names.index(name)] = check_array(
            f"reward term {name!r} of task {task.name!r}", term, terms.shape[1:]
        )
    missing = [name for name in names if name not in given and name not in REWARD_NAMES]
    if missing:
        raise ValueError(
            f"task {task.name!r} has weights for {missing}, but its reward_terms returns only "
            f"{[*given]}; return every term that default_weights names"
        )
