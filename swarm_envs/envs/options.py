"""Options of a task's `parallel_env`, and what is made from them."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import textwrap
from abc import ABC
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, make_dataclass
from typing import Any, ClassVar, NamedTuple, ParamSpec, cast

from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from swarm_envs import TASKS
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.parallel import RENDER_MODES, SwarmParallelEnv, SwarmTurnEnv
from swarm_envs.envs.setting import MOST_DRONES
from swarm_envs.errors import check_integer, check_name, check_type, nearest
from swarm_envs.hall import Hall
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.obstacles import Obstacle, parse_obstacles
from swarm_envs.tasks.rewards import reward_meanings
from swarm_envs.user_files import load_from_file
from swarm_envs.vehicles import Team, Vehicle, parse_team

__all__ = [
    "AirTaskOptions",
    "Blueprint",
    "TaskOptions",
    "batch_of",
    "blueprint_of",
    "options_type",
    "task_views",
]

P = ParamSpec("P")


class Blueprint(NamedTuple):
    """What an environment is made from, whatever its interface."""

    task: Task
    """What is flown."""
    config: EnvConfig
    """How it is flown and observed."""
    render_mode: str | None = None
    """`rgb_array`, `human`, or None for no pictures."""


@dataclass(frozen=True, kw_only=True)
class TaskOptions(EnvConfig, ABC):
    """Options of a task's environment: those of every one, `EnvConfig`, and the task's own."""

    num_drones: int
    """N small drones, if no team is given."""
    team: str | Sequence[Vehicle] | None = None
    """The vehicles, or a string such as `"SSLL"`; overrides `num_drones`."""
    obstacles: Sequence[Obstacle] | str = ()
    """Obstacles: `Box` and `Column` of `swarm_envs.tasks.obstacles`, or a string such as
    `buildings=2:2,column=1:1:0.15`."""
    reward_weights: Mapping[str, float] | None = None
    """Weight of each reward term; terms left out keep their default."""
    render_mode: str | None = None
    """`rgb_array` (pictures), `human` (a page in the browser) or None."""
    controller: ControllerConfig | str | None = None  # type: ignore[assignment]  # or its name
    """The tracking controller between actions and rotors, or the shipped agent that requires it,
    such as `air-aware`; None for the default."""

    task_type: ClassVar[type[Task]]
    """What `make_task` makes: a dataclass."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        super().__post_init__()
        if self.num_drones is not None:  # of which `vehicles` says whether it may be
            check_integer("num_drones", self.num_drones, at_least=1, at_most=MOST_DRONES)
        check_type("reward_weights", self.reward_weights, Mapping | None)
        check_type("obstacles", self.obstacles, Sequence)
        if self.render_mode is not None:
            check_name("render_mode", self.render_mode, RENDER_MODES)

    def make_task(self) -> Task:
        """The task that is flown.

        Raises:
            ValueError: the options contradict each other, or the task refuses them.
        """
        return self.task_of()

    def task_of(self, **others: Any) -> Task:
        """A task whose fields have the options of the same names, except those that are None.

        Args:
            **others: fields that no option gives.
        """
        kind: Any = self.task_type
        shared = {f.name for f in fields(self)} & {f.name for f in fields(kind)}
        given = {name: getattr(self, name) for name in shared if getattr(self, name) is not None}
        about = {"reward_weights": self.weights, "obstacles": self.standing}
        task: Task = kind(**{**others, **given, **about, "team": self.vehicles})
        return task

    @property
    def standing(self) -> tuple[Obstacle, ...]:
        """The obstacles."""
        given = self.obstacles
        return parse_obstacles(given) if isinstance(given, str) else tuple(given)

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each reward term."""
        return {**self.task_type.default_weights, **(self.reward_weights or {})}

    @property
    def vehicles(self) -> Team:
        """The team: as given, else `num_drones` small ones."""
        if self.team is not None:
            return parse_team(self.team)
        return parse_team("S" * check_integer("num_drones", self.num_drones, at_least=1))

    def blueprint(self) -> Blueprint:
        """What an environment with these options is made from.

        Raises:
            ValueError: the task refuses its options.
        """
        given = {field.name: getattr(self, field.name) for field in fields(EnvConfig)}
        if isinstance(self.controller, str):
            registry = importlib.import_module("swarm_envs.agents.registry")  # a higher layer
            given["controller"] = registry.controller_of(self.controller)
        config = EnvConfig(**given)
        return Blueprint(self.make_task(), config, self.render_mode)


@dataclass(frozen=True, kw_only=True)
class AirTaskOptions(TaskOptions):
    """Options of a task about downwash: those of every task, with other defaults."""

    num_neighbors: int = 7
    """K, how many neighbours a drone observes."""
    observe_load: bool = True
    """Whether observations include thrust margin, mass and charge of the drone and of its
    neighbors."""
    on_contact: str = "end_pair"
    """Effect of a contact: see `EnvConfig`."""
    world: str | Hall = "hall"
    """`hall`, `ideal` or a custom `swarm_envs.hall.Hall`; see `EnvConfig`."""


def task_views(
    options: Callable[P, TaskOptions],
) -> tuple[
    Callable[P, Blueprint], Callable[P, SwarmParallelEnv], Callable[P, AECEnv[str, Any, Any]]
]:
    """The functions of a task whose options are of a class: `blueprint`, `parallel_env`, `env`."""

    def blueprint(*args: P.args, **given: P.kwargs) -> Blueprint:
        """Make what every interface to the task is made from."""
        if args:
            raise TypeError(f"options have names, such as num_drones=4, but got {args[0]!r:.80}")
        return _blueprint(options, given)

    def parallel_env(*args: P.args, **given: P.kwargs) -> SwarmParallelEnv:
        """Make the environment with PettingZoo's parallel interface."""
        return SwarmParallelEnv(*blueprint(*args, **given))

    def env(*args: P.args, **given: P.kwargs) -> AECEnv[str, Any, Any]:
        """Make the environment with PettingZoo's AEC interface."""
        return OrderEnforcingWrapper(SwarmTurnEnv(parallel_env(*args, **given)))

    for view in (blueprint, parallel_env, env) if __doc__ else ():  # python -OO has no docstrings
        _document(view, options)
    return blueprint, parallel_env, env


def _blueprint(options: Callable[..., TaskOptions], given: Mapping[str, Any]) -> Blueprint:
    names = inspect.signature(options).parameters
    for name in given:
        if name not in names:
            owner = getattr(options, "__name__", "options")
            said = f"{owner}() got an unexpected keyword argument {name!r}"
            raise TypeError(f"{said}; {_OTHERS_NAMES.get(name) or nearest(name, names)}")
    return options(**given).blueprint()


_TIME_LIMIT = "the time limit is horizon_s, in seconds: decisions / decision_rate"
_OTHERS_NAMES = {
    "max_cycles": _TIME_LIMIT,
    "max_steps": _TIME_LIMIT,
    "max_episode_steps": _TIME_LIMIT,
    "frameskip": "decision_rate is the number of decisions a second",
    "frame_skip": "decision_rate is the number of decisions a second",
    "continuous": "every action is continuous; action is its mode, such as action='velocity'",
    "num_agents": "num_drones is the number of agents",
}
"""Names of options in other packages, and what stands for them here."""


_RAISES = """\
Raises:
    TypeError: an option does not exist (the message names the nearest).
    ValueError: an option has a wrong type or an impossible value, or contradicts another.
    ImportError: `physics="bullet"` without pybullet."""


def _document(view: Callable[P, Any], options: Callable[P, TaskOptions]) -> None:
    """Give a view the options as its signature, and a docstring that explains each of them.

    The reward terms come first, then the task's own options. Types are in the docstring, in words,
    and would make the signature unreadable.
    """
    made: Any = view
    settings = cast(type[TaskOptions], options)
    table, meanings = {f.name: f for f in fields(settings)}, field_docstrings(settings)
    shared = [field.name for field in fields(EnvConfig)]
    names = [*(name for name in table if name not in shared), *shared]
    parameters = inspect.signature(options).parameters
    made.__signature__ = inspect.Signature(
        [parameters[name].replace(annotation=inspect.Parameter.empty) for name in names],
        return_annotation=view.__annotations__["return"],
    )
    made.__module__, made.__qualname__ = options.__module__, view.__name__
    entries = [_entry(table[name], meanings[name]) for name in names]
    parts = [made.__doc__, *_reward_list(options), "", "Args:", *entries, "", _RAISES]
    made.__doc__ = "\n".join(parts)


def _reward_list(options: object) -> list[str]:
    task: Any = getattr(options, "task_type", Task)  # a custom class may have none
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
    """The value that an option has if it is not given; `dataclasses.MISSING` if it must be."""
    return option.default if option.default_factory is MISSING else option.default_factory()


def field_docstrings(settings: type) -> dict[str, str]:
    """The docstring below each field of a dataclass on one line, its base classes' included.

    They are empty where the source is not there.
    """
    found = {field.name: "" for field in fields(settings)}
    task = getattr(settings, "task_type", None)  # whose fields may be options, and explain them
    for base in (*([task] if task else []), *reversed(settings.__mro__)):
        if is_dataclass(base):
            own = _own_docstrings(cast(type, base))
            found |= {name: text for name, text in own.items() if name in found}
    return found


@functools.cache
def _own_docstrings(settings: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(settings))
    except (OSError, TypeError):  # made at a prompt, or of a file that is gone
        return {}
    body = cast(ast.ClassDef, ast.parse(source).body[0]).body
    return {
        ast.unparse(node.target): " ".join(ast.literal_eval(after.value).split())
        for node, after in itertools.pairwise(body)
        if isinstance(node, ast.AnnAssign) and isinstance(after, ast.Expr)
    }


def options_type(task: str | type[Task]) -> type[TaskOptions]:
    """Return the options of a task.

    Args:
        task: its name, such as `swap_v1`; or a class of one's own, also as `my_task.py:MyTask`.

    Raises:
        ValueError: there is no such task.
        ImportError: the file of one's own cannot be imported.
    """
    if isinstance(task, str) and ".py:" in task:
        task = load_from_file(task)
    if not isinstance(task, str):
        return own_options(own_task(task))
    check_name("task", task, TASKS)
    module = importlib.import_module(f"swarm_envs.{task}")
    own = (c for c in vars(module).values() if getattr(c, "__module__", "") == module.__name__)
    return next(c for c in own if inspect.isclass(c) and issubclass(c, TaskOptions))


def own_task(task: object) -> type[Task]:
    """Return a task of one's own if it is one.

    Raises:
        ValueError: it is no task, no dataclass, or has no `draw`.
    """
    kind = isinstance(task, type) and issubclass(task, Task)
    if not kind or "__dataclass_fields__" not in vars(task) or inspect.isabstract(task):
        raise ValueError(
            f"task is {task!r:.80}, but must be a name such as 'swap_v1', or a class with "
            "@dataclass(frozen=True) that inherits from swarm_envs.tasks.base.Task and has a "
            "method draw"
        )
    return cast(type[Task], task)


@functools.cache
def own_options(task: type[Task]) -> type[TaskOptions]:
    """Return options of a task of one's own: those of every task, and the fields of its class."""
    taken = {field.name for field in fields(TaskOptions)} | {"success"}
    own = [
        (f.name, f.type, field(default=f.default, default_factory=f.default_factory))
        for f in fields(task)
        if f.name not in taken
    ]
    drones: list[Any] = [("num_drones", int, 4)]
    made = make_dataclass(
        f"{task.__name__}Options",
        [*drones, *own],
        bases=(TaskOptions,),
        namespace={"task_type": task, "__doc__": task.__doc__},
        frozen=True,
        kw_only=True,
    )
    return cast(type[TaskOptions], made)


def blueprint_of(task: str | type[Task], **options: Any) -> Blueprint:
    """Make what the task's `parallel_env(**options)` is made from; see `options_type`.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, or an option has an impossible value.
    """
    return _blueprint(options_type(task), options)


def batch_of(task: str | type[Task], **options: Any) -> Blueprint:
    """The same for many environments at once: the batch engine is the default.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, an option has an impossible value, or pictures are
            asked for.
    """
    found = blueprint_of(task, **{"physics": "batch", **options})
    if found.render_mode is not None:
        raise ValueError(
            f"render_mode is {found.render_mode!r}, but environments for training are not "
            "drawn; render a single one: parallel_env(render_mode='rgb_array')"
        )
    return found
