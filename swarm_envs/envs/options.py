"""Options of a task's `parallel_env`, and the environments made from them."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, make_dataclass
from typing import Any, ClassVar, NamedTuple, TypeGuard, cast

from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from swarm_envs import TASKS
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import MOST_DRONES, EnvConfig
from swarm_envs.envs.parallel import RENDER_MODES, SwarmParallelEnv, SwarmTurnEnv
from swarm_envs.errors import check_integer, check_name, check_type, nearest, unknown_name
from swarm_envs.tasks.base import Task, check_rules
from swarm_envs.tasks.obstacles import Obstacle, check_inside, parse_obstacles
from swarm_envs.tasks.rewards import reward_meanings
from swarm_envs.user_files import load_from_file
from swarm_envs.vehicles import Vehicle, parse_team

__all__ = [
    "Blueprint",
    "TaskOptions",
    "batch_of",
    "blueprint_of",
    "options_type",
    "task_class",
    "task_views",
]


class Blueprint(NamedTuple):
    """The arguments of every interface's environment."""

    task: Task
    """The task, with its team."""
    config: EnvConfig
    """The options that all tasks share."""
    render_mode: str | None = None
    """`rgb_array`, `human`, or None for no pictures."""


@dataclass(frozen=True, kw_only=True)
class TaskOptions(EnvConfig):
    """Options of a task's environment: `EnvConfig`, these, and the fields of the task's class."""

    num_drones: int | None = 4
    """N, the number of drones, if no team is given: small ones, unless the task has others. None,
    in tasks with this default: the number of the layout."""
    team: str | Sequence[Vehicle] | None = None
    """The vehicles, or a string such as `"SSLL"`; overrides `num_drones`."""
    obstacles: Sequence[Obstacle] | str = ()
    """Objects `Box` and `Column` of `swarm_envs.tasks.obstacles`, or a string such as
    `buildings=2:2,column=1:1:0.15`."""
    reward_weights: Mapping[str, float] | None = None
    """Weight of each reward term; terms left out keep their default."""
    render_mode: str | None = None
    """`rgb_array` (pictures), `human` (a page in the browser) or None."""
    controller: ControllerConfig | str | None = None  # type: ignore[assignment]  # wider type
    """The tracking controller between actions and rotors, or the name of the shipped agent that
    requires it, such as `downwash-aware`; None for the default."""

    task_type: ClassVar[type[Task]]
    """The class of the task."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        super().__post_init__()
        if self.num_drones is not None:  # the task raises for None unless its layouts have numbers
            check_integer("num_drones", self.num_drones, at_least=1, at_most=MOST_DRONES)
        check_type("reward_weights", self.reward_weights, Mapping | None)
        check_type("obstacles", self.obstacles, Sequence)
        if self.render_mode is not None:
            check_name("render_mode", self.render_mode, RENDER_MODES)

    def make_task(self) -> Task:
        """Return the task with its options.

        Raises:
            ValueError: the options contradict each other, or are invalid for the task.
        """
        kind: Any = self.task_type
        names = [f.name for f in fields(kind) if f.init and hasattr(self, f.name)]
        given = {name: getattr(self, name) for name in names}
        obstacles, team = self.obstacles, self.team
        if isinstance(obstacles, str):
            obstacles = parse_obstacles(obstacles)
        given |= {
            "team": kind.default_team(self) if team is None else parse_team(team),
            "obstacles": tuple(obstacles),
            "reward_weights": {**kind.default_weights, **(self.reward_weights or {})},
        }
        task: Task = kind(**given)
        check_rules(task)
        check_inside(given["obstacles"], task.arena)
        return task

    def blueprint(self) -> Blueprint:
        """Return the arguments of an environment with these options.

        Raises:
            ValueError: the options are invalid for the task.
        """
        given = {field.name: getattr(self, field.name) for field in fields(EnvConfig)}
        if isinstance(self.controller, str):
            # Imported here, since agents import this module
            registry = importlib.import_module("swarm_envs.agents.registry")
            given["controller"] = registry.controller_of(self.controller)
        config = EnvConfig(**given)
        return Blueprint(self.make_task(), config, self.render_mode)


def task_views(
    task: type[Task],
) -> tuple[Callable[..., Blueprint], Callable[..., SwarmParallelEnv], Callable[..., AECEnv]]:
    """Return the functions of a task's module: `blueprint`, `parallel_env` and `env`."""

    def blueprint(*args: object, **options: Any) -> Blueprint:
        """Make the arguments of every interface's environment."""
        if args:
            raise TypeError(f"options have names, such as num_drones=4, but got {args[0]!r:.80}")
        return blueprint_of(task, **options)

    def parallel_env(*args: object, **options: Any) -> SwarmParallelEnv:
        """Make the environment with PettingZoo's parallel interface."""
        return SwarmParallelEnv(*blueprint(*args, **options))

    def env(*args: object, **options: Any) -> AECEnv[str, Any, Any]:
        """Make the environment with PettingZoo's AEC interface."""
        return OrderEnforcingWrapper(SwarmTurnEnv(parallel_env(*args, **options)))

    for view in (blueprint, parallel_env, env):
        _document(view, options_type(task))
    return blueprint, parallel_env, env


_TIME_LIMIT = "the time limit is horizon_s, in seconds: decisions / decision_rate"
_OTHERS_NAMES = {
    "max_cycles": _TIME_LIMIT,
    "max_steps": _TIME_LIMIT,
    "max_episode_steps": _TIME_LIMIT,
    "frameskip": "decision_rate is the number of decisions a second",
    "frame_skip": "decision_rate is the number of decisions a second",
    "continuous": "every action is continuous; action is its mode, such as action='velocity'",
    "autoreset_mode": "give make_vec of Gymnasium vectorization_mode='sync' and "
    "vector_kwargs={'autoreset_mode': ...}",
    "num_agents": "num_drones is the number of agents",
}
"""Hints for names of options in other packages."""

_RAISES = """\
Raises:
    TypeError: an option does not exist (the message names the nearest).
    ValueError: an option has a wrong type or an impossible value, or contradicts another.
    ImportError: `physics="bullet"` without pybullet."""


def _document(view: Any, options: type[TaskOptions]) -> None:
    """Set the signature of a function of a task's module, and its docstring with all options.

    The docstring lists the reward terms, the task's own options and then those of all tasks. The
    signature has no types, which would make it unreadable; they are in the docstring.
    """
    table, meanings = {f.name: f for f in fields(options)}, field_docstrings(options)
    shared = [field.name for field in fields(EnvConfig)]
    names = [*(name for name in table if name not in shared), *shared]
    parameters = inspect.signature(options).parameters
    view.__signature__ = inspect.Signature(
        [parameters[name].replace(annotation=inspect.Parameter.empty) for name in names],
        return_annotation=view.__annotations__["return"],
    )
    view.__module__, view.__qualname__ = f"swarm_envs.{options.task_type.name}", view.__name__
    entries = [_entry(table[name], meanings[name]) for name in names]
    parts = [view.__doc__, *_reward_list(options.task_type), "", "Args:", *entries, "", _RAISES]
    view.__doc__ = "\n".join(parts) if view.__doc__ else None  # python -OO has no docstrings


def _reward_list(task: type[Task]) -> list[str]:
    meanings = reward_meanings(task.write_reward_terms)
    terms = [
        f"- `{name}` ({weight:g}): {meanings.get(name, '')}"
        for name, weight in task.default_weights.items()
    ]
    lines = [textwrap.fill(term, 100, subsequent_indent="  ") for term in terms]
    return ["", "Reward terms, with their default weights:", "", *lines] if lines else []


def _entry(option: Field[Any], meaning: str) -> str:
    text = f"{option.name} ({option.type}): {meaning}"
    if (default := default_of(option)) is not MISSING:
        text += f" Default: {default!r}."
    return textwrap.fill(text, 100, initial_indent=" " * 4, subsequent_indent=" " * 8)


def default_of(option: Field[Any]) -> Any:
    """Return the default of an option; `dataclasses.MISSING` if it has none."""
    return option.default if option.default_factory is MISSING else option.default_factory()


def field_docstrings(settings: type) -> dict[str, str]:
    """Return the docstrings of a dataclass's fields, also inherited ones, each on one line.

    They are empty if the source is not available.
    """
    found = {field.name: "" for field in fields(settings)}
    task = getattr(settings, "task_type", object)  # its fields are options too
    for base in (*reversed(task.__mro__), *reversed(settings.__mro__)):
        if is_dataclass(base):
            own = _own_docstrings(cast(type, base))
            found |= {name: text for name, text in own.items() if name in found}
    return found


@functools.cache
def _own_docstrings(settings: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(settings))
    except (OSError, TypeError):  # defined at a prompt, or its file no longer exists
        return {}
    body = cast(ast.ClassDef, ast.parse(source).body[0]).body
    return {
        ast.unparse(node.target): " ".join(ast.literal_eval(after.value).split())
        for node, after in itertools.pairwise(body)
        if isinstance(node, ast.AnnAssign) and isinstance(after, ast.Expr)
    }


def task_class(task: str | type[Task]) -> type[Task]:
    """Return the class of a task.

    Args:
        task: a name such as `swap_v1`; or a custom class, also as `my_task.py:MyTask`.

    Raises:
        ValueError: there is no such task; or the class is no task, no dataclass, or lacks `draw`.
        ImportError: the file of a custom class cannot be imported.
    """
    found: object = load_from_file(task) if isinstance(task, str) and ".py:" in task else task
    if isinstance(found, str):
        if found not in TASKS:
            raise ValueError(
                f"{unknown_name('task', found, TASKS)}; a custom task is given as its class, or as "
                "'my_task.py:MyTask'"
            )
        return next(filter(_is_task, vars(importlib.import_module(f"swarm_envs.{found}")).values()))
    if not _is_task(found):
        raise ValueError(_not_a_task(found))
    return found


def _not_a_task(found: object) -> str:
    """Return which rule of a task's class an object breaks."""
    if not (isinstance(found, type) and issubclass(found, Task)):
        return (
            f"task is {found!r:.80}, but must be a name such as 'swap_v1', or a class that "
            "inherits from swarm_envs.tasks.base.Task"
        )
    name = found.__name__
    if "__dataclass_fields__" not in vars(found):
        return f"task class {name} is no dataclass; decorate it by @dataclass(frozen=True)"
    return f"task class {name} lacks {', '.join(sorted(found.__abstractmethods__))}; add the method"


def _is_task(kind: object) -> TypeGuard[type[Task]]:
    own = isinstance(kind, type) and issubclass(kind, Task)
    return own and "__dataclass_fields__" in vars(kind) and not inspect.isabstract(kind)


def options_type(task: str | type[Task]) -> type[TaskOptions]:
    """Return the options of a task, a dataclass made from its class; for `task` see `task_class`.

    Raises:
        ValueError: there is no such task, one of its `defaults` is not an option of all tasks, or
            one of its fields has the name of another attribute of `TaskOptions`.
        ImportError: the file of a custom class cannot be imported.
    """
    return _options_of(task_class(task))


@functools.cache
def _options_of(task: type[Task]) -> type[TaskOptions]:
    shared = {f.name: f.type for f in fields(TaskOptions)}
    for name in task.defaults:
        check_name(f"option in defaults of {task.__name__}", name, shared)
    given = [(name, shared[name], field(default=value)) for name, value in task.defaults.items()]
    own = [
        (f.name, f.type, field(default=f.default, default_factory=f.default_factory))
        for f in fields(task)
        if f.init and f.name not in (*shared, "success")
    ]
    for name, *_ in own:
        if hasattr(TaskOptions, name):
            raise ValueError(
                f"{task.__name__} has a field {name!r}, but environments already have an attribute "
                "of this name; rename the field"
            )
    made = make_dataclass(
        f"{task.__name__.removesuffix('Task')}Options",
        [*given, *own],
        bases=(TaskOptions,),
        namespace={"task_type": task, "__doc__": task.__doc__},
        frozen=True,
        kw_only=True,
    )
    return cast(type[TaskOptions], made)


def blueprint_of(task: str | type[Task], **options: Any) -> Blueprint:
    """Return the arguments of the task's environments with these options; see `task_class`.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, or an option has an impossible value.
    """
    kind = options_type(task)
    names = inspect.signature(kind).parameters
    for name in options:
        if name not in names:
            hint = _OTHERS_NAMES.get(name) or nearest(name, names)
            raise TypeError(f"{kind.task_type.name} has no option {name!r}; {hint}")
    given = {name: _as_record(name, value, names[name].default) for name, value in options.items()}
    return kind(**given).blueprint()


def _as_record(name: str, value: Any, default: Any) -> Any:
    """Return a mapping, as commands give it, as the dataclass of the option's default, if it is."""
    if not isinstance(value, Mapping) or not is_dataclass(default) or isinstance(default, type):
        return value
    for key in value:
        check_name(f"field of {name}", key, [each.name for each in fields(default)])
    tuples = {key: tuple(v) if isinstance(v, list) else v for key, v in value.items()}
    return type(default)(**tuples)


def batch_of(task: str | type[Task], **options: Any) -> Blueprint:
    """Return the arguments of a batch of environments; the batch engine is the default.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, an option has an impossible value, or `render_mode` is
            given.
    """
    found = blueprint_of(task, **{"physics": "batch", **options})
    if found.render_mode is not None:
        raise ValueError(
            f"render_mode is {found.render_mode!r}, but environments for training are not "
            "drawn; render a single one: parallel_env(render_mode='rgb_array')"
        )
    return found
