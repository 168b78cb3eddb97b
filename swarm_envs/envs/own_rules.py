"""Rules that a task writes in plain NumPy: its own success, goals and reward terms.

Tasks of the package have kernels for these. A task of one's own has methods, which are called once
a decision for all environments, after the shared rules:

- `success(world)` says in which environments the team is done;
- `advance(world)` changes goals, and scores;
- `reward_terms(world)` gives reward terms by name.
"""

from __future__ import annotations

import inspect

import numpy as np

from swarm_envs.errors import check_array, check_name
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import World
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.rewards import REWARD_NAMES

__all__ = ["apply_own_rules", "has_own_rules", "write_own_terms"]


def has_own_rules(task: Task) -> bool:
    """Return whether a task has any of the methods of this module.

    Raises:
        ValueError: one of them is a function that is no method.
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
    """Let a task end episodes that are done, and send drones to other goals.

    Args:
        task: has the methods `success` and `advance`, or one of them.
        world: the tables, after the shared rules.
        flown: (E,) environments that have made this decision.
        end_on_success: whether success ends an episode.

    Raises:
        ValueError: `success` returned something else than (E,) booleans, or `advance` set a goal or
            a score that is not finite.
    """
    if inspect.ismethod(task.success):
        done = np.asarray(task.success(world))
        if done.dtype != np.bool_ or done.shape != flown.shape:
            raise ValueError(
                f"success of task {task.name!r} returned {done.dtype} of shape {done.shape}, but "
                f"must return booleans of shape {flown.shape}, one for each environment"
            )
        _end(world, done & flown, end_on_success)
    if inspect.ismethod(task.advance):
        before = world.drones["goal"].copy()
        task.advance(world)
        check_array(f"goal after advance of task {task.name!r}", world.drones["goal"], before.shape)
        score = world.environments["score"]
        check_array(f"score after advance of task {task.name!r}", score, score.shape)
        _send(world, (world.drones["goal"] != before).any(axis=-1))


def _end(world: World, done: BoolArray, end_on_success: bool) -> None:
    """Mark environments (E,) as done, unless they have crashed or were done before."""
    e, stages = world.environments, world.goals.shape[1]
    new = done & ~e["terminated"] & ~e["held"]
    unhurt = (world.drones["hurt"] == 0.0).all(axis=1)
    e["held"] |= new
    e["reached"] += new
    e["unhurt"] += new & unhurt
    e["achieved"][new] = 1.0 / stages
    whole = new & (e["reached"] == stages)
    e["succeeded"] |= whole & unhurt
    if end_on_success:
        e["terminated"] |= whole
        e["truncated"] &= ~whole
        e["running"] &= ~whole


def _send(world: World, sent: BoolArray) -> None:
    """Send drones (E, N) to the goals that they have now; that is no progress of this decision."""
    drones = world.drones
    covered = drones["last_distance"] - drones["distance"]
    away = np.linalg.norm(drones["position"] - drones["goal"], axis=-1)
    drones["distance"][sent] = away[sent]
    drones["last_distance"][sent] = (away + covered)[sent]
    drones["arrival"][sent] = np.inf
    drones["reference_position"][sent] = drones["goal"][sent]


def write_own_terms(task: Task, world: World, terms: FloatArray) -> None:
    """Write the reward terms of a task's own into terms (T, E, N), in the order of their names.

    Raises:
        ValueError: a term has no weight or no value, or a wrong shape.
    """
    if not inspect.ismethod(task.reward_terms):
        return
    given, names = task.reward_terms(world), task.reward_names
    for name, term in given.items():
        check_name(f"reward term of task {task.name!r}", name, names)
        terms[names.index(name)] = check_array(f"reward term {name!r}", term, terms.shape[1:])
    missing = [name for name in names if name not in given and name not in REWARD_NAMES]
    if missing:
        raise ValueError(
            f"task {task.name!r} has weights for {missing}, but its reward_terms returns only "
            f"{[*given]}; return every term that default_weights names"
        )
