"""Options of environment constructors: those that every task takes, and how they are checked."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypedDict

from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from swarm_envs import TASKS
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.randomization import Randomization
from swarm_envs.envs.turns import SwarmTurnEnv
from swarm_envs.errors import check_integer, check_kind, check_name, unknown_name
from swarm_envs.interactions import InteractionModel
from swarm_envs.motors import BatteryModel
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.obstacles import Obstacle
from swarm_envs.vehicles import Team, Vehicle, parse_team

P = ParamSpec("P")

MOST_DRONES = 100_000
"""Of `num_drones`: a batch of environments shares the memory."""


class EnvOptions(TypedDict, total=False):
    """Options that every task's `parallel_env` takes; `EnvConfig` says what each means."""

    physics: str | None
    interactions: str | Path | InteractionModel
    action: str
    decision_rate: int
    force_rate: int
    precision: str
    controller: ControllerConfig | None
    threads: int | None
    observation: str
    num_neighbors: int
    num_obstacles: int | None
    horizon_s: float | None
    end_on_success: bool
    battery: BatteryModel | None
    randomization: Randomization | None
    deterministic: bool
    force_bounds_g: Mapping[str, float]


class Blueprint(NamedTuple):
    """What an environment is made from, whatever its interface."""

    task: Task
    """What is flown."""
    config: EnvConfig
    """How it is flown and observed."""
    render_mode: str | None = None
    """`rgb_array`, `human`, or None for no pictures."""


def parallel_view(blueprint: Callable[P, Blueprint]) -> Callable[P, SwarmParallelEnv]:
    """The function that makes a task's environment with PettingZoo's parallel interface."""

    @functools.wraps(blueprint)
    def parallel_env(*args: P.args, **options: P.kwargs) -> SwarmParallelEnv:
        return SwarmParallelEnv(*blueprint(*args, **options))

    parallel_env.__name__ = parallel_env.__qualname__ = "parallel_env"
    return parallel_env


def aec_view(blueprint: Callable[P, Blueprint]) -> Callable[P, AECEnv[str, Any, Any]]:
    """The function that makes a task's environment with PettingZoo's AEC interface."""

    @functools.wraps(blueprint)
    def env(*args: P.args, **options: P.kwargs) -> AECEnv[str, Any, Any]:
        turns = SwarmTurnEnv(SwarmParallelEnv(*blueprint(*args, **options)))
        return OrderEnforcingWrapper(turns)

    env.__name__ = env.__qualname__ = "env"
    return env


def refuse_unknown(constructor: Callable[..., object], options: Mapping[str, object]) -> None:
    """Refuse keyword arguments that neither a constructor nor `EnvConfig` has.

    Raises:
        TypeError: there is one; the message names the nearest that exists.
    """
    own = [name for name in inspect.signature(constructor).parameters if name != "options"]
    shared = [field.name for field in fields(EnvConfig)]
    for name in options:
        if name not in shared:
            raise TypeError(unknown_name("option", name, own + shared))


def check_common(
    reward_weights: Mapping[str, float] | None, obstacles: Sequence[Obstacle]
) -> tuple[dict[str, float], tuple[Obstacle, ...]]:
    """Check the types of options that tasks share, and return them in the form that tasks take.

    Raises:
        TypeError: one is of a wrong type.
    """
    if reward_weights is not None:
        check_kind("reward_weights", reward_weights, Mapping, "{'success': 5.0}")
    check_kind("obstacles", obstacles, Sequence, "(Column(center=(0.0, 0.0), radius=0.2),)")
    return dict(reward_weights or {}), tuple(obstacles)


def team_of(team: str | Sequence[Vehicle] | None, num_drones: int) -> Team:
    """The team that was asked for: as given, else `num_drones` small ones.

    Raises:
        ValueError: there would be no drone, or a token is unknown.
    """
    if team is not None:
        return parse_team(team)
    return parse_team("S" * check_integer("num_drones", num_drones, 1, MOST_DRONES))


def blueprint_of(task: str, **options: Any) -> Blueprint:
    """What the task's `parallel_env(**options)` is made from.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, or an option has an impossible value.
    """
    check_name("task", task, TASKS)
    found: Blueprint = importlib.import_module(f"swarm_envs.{task}").blueprint(**options)
    return found


def batch_of(task: str, **options: Any) -> Blueprint:
    """The same for many environments at once: the batch engine is the default.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, an option has an impossible value, or pictures are
            asked for.
    """
    found = blueprint_of(task, **{"physics": "batch", **options})
    if found.render_mode is not None:
        raise ValueError(
            f"render_mode is {found.render_mode!r}, but environments that fly at once are not "
            "drawn; render a single one: parallel_env(render_mode='rgb_array')"
        )
    return found
