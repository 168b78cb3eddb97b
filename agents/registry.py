"""Agents by name: the included agents, and classes and functions in a user's file."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from swarm_envs.agents.protocol import Agent
from swarm_envs.control.config import ControllerConfig
from swarm_envs.errors import check_type
from swarm_envs.interactions import InteractionModel
from swarm_envs.user_files import find_in, import_file

__all__ = ["FILTER", "SHIPPED", "controller_of", "load_agent"]

POLICIES = (
    *("swap-dagger", "gates-dagger", "pursuit-dagger", "crowd-dagger"),
    *("stack-dagger", "mixed-dagger", "sprint-dagger", "delivery-dagger"),
    *("ring-dagger", "swap-ppo"),
)
"""The included agents that are trained policies: files of these names in `weights`."""
SHIPPED: Mapping[str, str] = MappingProxyType(
    {
        "hover": "swarm_envs.agents.scripted:HoverAgent",
        "random": "swarm_envs.agents.scripted:RandomAgent",
        "straight-line": "swarm_envs.agents.scripted:StraightLineAgent",
        "fast-line": "swarm_envs.agents.avoiding:fast_line",
        "orca": "swarm_envs.agents.avoiding:orca",
        "roundabout": "swarm_envs.agents.avoiding:roundabout",
        "tracking": "swarm_envs.baselines.neural_swarm.agent:TrackingAgent",
        "tracking+compensated": (
            "swarm_envs.baselines.neural_swarm.agent:TrackingAgent.compensated"
        ),
        "tracking+adaptive": "swarm_envs.baselines.neural_swarm.agent:TrackingAgent.adaptive",
        "tracking+compensated+adaptive": (
            "swarm_envs.baselines.neural_swarm.agent:TrackingAgent.compensated_adaptive"
        ),
        "detour": "swarm_envs.agents.scripted:DetourAgent",
        "detour+compensated": "swarm_envs.baselines.neural_swarm.agent:compensated_detour",
        **dict.fromkeys(POLICIES, "swarm_envs.agents.policy:shipped_policy"),
        "pid": "swarm_envs.baselines.neural_swarm.downwash:pid",
        "pid+adaptive": "swarm_envs.baselines.neural_swarm.downwash:pid_adaptive",
        "downwash-aware": "swarm_envs.baselines.neural_swarm.downwash:downwash_aware",
        "heavy-on-top": "swarm_envs.baselines.neural_swarm.downwash:heavy_on_top",
        "neural-swarm-planner": "swarm_envs.baselines.neural_swarm.agent:PlanAgent",
        "mlr-dmpc": "swarm_envs.baselines.mlr_dmpc:MlrDmpcAgent",
        "mlr-dmpc+compensated": "swarm_envs.baselines.mlr_dmpc:MlrDmpcAgent.compensated",
        "rth3d": "swarm_envs.baselines.rth3d.grid_agent:GridAgent",
        "rth3d+compensated": "swarm_envs.baselines.rth3d.grid_agent:GridAgent.compensated",
    }
)
"""The included agents as `"module:Class"`, imported when they are loaded. The class, or function,
after the colon is called without arguments, except for policies, which are loaded by their name.

Suffixes of a name change the tracking controller: `+compensated` feeds forward the force that the
agent's force model predicts, `+adaptive` compensates an estimate of the force (INDI). Every
supported combination is a key."""

FILTER = "+filter"
"""The last suffix of an agent's name, which adds a `swarm_envs.agents.SafetyFilter`."""


def load_agent(name: str | os.PathLike[str]) -> Agent:
    """Return an agent by its name.

    Args:
        name: an included agent (a key of `SHIPPED`) with its suffixes, such as
            `detour+compensated`; a trained policy, as the folder of its training run or its
            .safetensors file; a class in a file, `path/to/file.py:Class`, which is called without
            arguments; or a function of observation rows in a file, `path/to/file.py:function` (see
            `from_model`). The last suffix, `+filter`, adds a safety filter, with the policy's own
            parameters if its file has any.

    Raises:
        ValueError: no agent has this name or supports a suffix, or the file defines no agent; the
            message names the missing attribute.
        FileNotFoundError: there is no such file.
        ImportError: the file cannot be imported.
    """
    check_type("name", name, str | os.PathLike)
    name = os.fspath(name)
    if not name:
        raise ValueError("name is '', but must be an agent's, such as 'swap-dagger'")
    if name.endswith(FILTER):
        return _load_filtered(name)
    if name in POLICIES:
        from swarm_envs.agents.policy import shipped_policy

        return shipped_policy(name)
    if name in SHIPPED:
        module, _, path = SHIPPED[name].partition(":")
        return _make(name, importlib.import_module(module), path)
    file, colon, path = name.rpartition(":")
    if not colon and _names_policy(name):
        from swarm_envs.agents.policy import PolicyAgent

        return PolicyAgent.load(Path(name))
    if not colon:
        if "/" in name and not Path(name).exists():
            raise FileNotFoundError(
                f"there is no {name!r}; a trained policy is given by the folder of its run, and a "
                "class by path/to/file.py:Class"
            )
        raise ValueError(_unknown_agent(name))
    return _make(name, import_file(Path(file)), path)


def _load_filtered(name: str) -> Agent:
    """Return the agent of a name with the suffix `+filter`, with its safety filter."""
    from swarm_envs.agents.policy import PolicyAgent
    from swarm_envs.agents.safety import SafetyFilter

    inner = name.removesuffix(FILTER)
    agent = load_agent(inner)
    if isinstance(agent, SafetyFilter):
        raise ValueError(
            f"agent is {name!r}, but {inner!r} already has a filter; leave out '+filter'"
        )
    return SafetyFilter(agent, agent.policy.note.safety if isinstance(agent, PolicyAgent) else None)


def controller_of(name: str) -> ControllerConfig:
    """Return the tracking controller that an included agent requires, such as `downwash-aware`.

    Raises:
        ValueError: no included agent has this name, or it requires no controller.
    """
    found = _own_controller(name) if name in SHIPPED else None
    if found is None:
        known = difflib.get_close_matches(name.lower(), SHIPPED, n=3)
        near = next(filter(_own_controller, known), None)
        hint = f"; did you mean {near!r}?" if near else ""
        raise ValueError(
            f"controller is {name!r}, but must be an included agent with its own controller, "
            f"such as 'downwash-aware' or 'tracking+compensated'{hint}"
        )
    return found


def _own_controller(name: str) -> ControllerConfig | None:
    """Return the controller that an included agent requires, or None."""
    found = load_agent(name).requires.get("controller")
    return found if isinstance(found, ControllerConfig) else None


def shipped_belief() -> InteractionModel:
    """Return the included force model of controllers, fitted to flights in `learned` forces."""
    baseline = importlib.import_module("swarm_envs.baselines.neural_swarm.agent")
    model: InteractionModel = baseline.load_belief()
    return model


def _unknown_agent(name: str) -> str:
    """Return the message for an unknown agent: the most similar name, and where to find all."""
    if name.endswith(".py"):
        wanted = f"write {name + ':Class'!r} or {name + ':function'!r}"
        return f"agent {name!r} names no class or function; {wanted}"
    if "," in name:
        return f"unknown agent {name!r}; separate names by spaces"
    base, suffixed, _ = name.partition("+")
    if suffixed and base in SHIPPED:
        supported = ", ".join(_suffixes_of(base)) or "no suffix"
        return f"unknown agent {name!r}; {base!r} supports {supported}"
    near = difflib.get_close_matches(name.lower(), SHIPPED, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return (
        f"unknown agent {name!r}; {hint}`swarm-envs fly --help` lists the included agents; others "
        "are 'path/to/file.py:Class', 'path/to/file.py:function' and folders of training runs, "
        "each optionally with +filter"
    )


def _suffixes_of(name: str) -> list[str]:
    """Return the suffixes of an included agent, `+filter` last."""
    found = [known.removeprefix(name) for known in SHIPPED if known.startswith(f"{name}+")]
    try:
        load_agent(name + FILTER)
    except ValueError:
        return found
    return [*found, FILTER]


def _names_policy(name: str) -> bool:
    """Return True if a name is a folder, or a file with a suffix of trained weights."""
    weights = (".safetensors", ".pt", ".pth", ".pkl", ".zip", ".npz", ".onnx")
    return Path(name).is_dir() or Path(name).suffix in weights or name.endswith("/")


def _make(name: str, module: ModuleType, path: str) -> Agent:
    made = find_in(name, module, path)
    if not callable(made):
        raise ValueError(f"{name!r} is {made!r:.60}, but must be a class or a function")
    if inspect.isfunction(made) and _takes_rows(made):
        from swarm_envs.agents.models import ModelAgent

        return ModelAgent(made)
    try:
        agent = made()
    except TypeError as error:
        raise ValueError(f"{name!r} cannot be made without arguments: {error}") from error
    return check_agent(name, agent)


def _takes_rows(function: Callable[..., Any]) -> bool:
    """Return True if a function has a required argument: then it maps rows to actions."""
    parameters = inspect.signature(function).parameters.values()
    return any(p.default is p.empty and p.kind <= p.POSITIONAL_OR_KEYWORD for p in parameters)


def check_agent(name: str, agent: Any) -> Agent:
    """Return an object that satisfies the agent protocol; raise ValueError if it does not."""
    rules = (
        ("requires", "a mapping of environment options, {} for none", Mapping),
        ("privileged", "True or False: whether it needs the true state", bool),
    )
    for attribute, rule, kind in rules:
        if not isinstance(getattr(agent, attribute, None), kind):
            raise ValueError(f"agent {name!r} lacks `{attribute}`, which must be {rule}")
    for method, arguments in (("reset", "(env, seed)"), ("act", "(observations, view)")):
        if not callable(getattr(agent, method, None)):
            raise ValueError(f"agent {name!r} lacks the method `{method}{arguments}`")
    checked: Agent = agent
    return checked
