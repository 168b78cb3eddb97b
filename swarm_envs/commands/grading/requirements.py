"""What a work requires of the environment, as plain data: said in its process, checked outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.control.config import (
    ControllerConfig,
    Indi,
    MomentumObserver,
    NeuralFly,
    PositionGains,
)
from swarm_envs.errors import check_integer, check_name

OPTIONS = (
    "action",
    "decision_rate",
    "observation",
    "num_neighbors",
    "num_obstacles",
    "observe_load",
    "controller",
)
"""Options that a work may choose. All others say what is flown and when it is a success."""
MOST_SEEN = 64
"""Neighbours, or obstacles, that it may ask to observe."""
_ADAPTATIONS = {kind.__name__: kind for kind in (MomentumObserver, Indi, NeuralFly)}
_BELIEF = "belief"


def to_plain(requires: Mapping[str, Any]) -> dict[str, Any]:
    """What an agent requires, as JSON can say it.

    Raises:
        ValueError: it requires what it may not choose, or a force model that does not ship.
    """
    found = {}
    for name, value in requires.items():
        if name not in OPTIONS:
            raise ValueError(
                f"it requires {name!r}, but may choose only {', '.join(OPTIONS)}; the rest is the "
                "assignment's"
            )
        if name == "controller" and value is not None:
            value = _controller_to_plain(value)
        found[name] = value.item() if isinstance(value, np.generic) else value
    return found


def _controller_to_plain(config: Any) -> dict[str, Any]:
    if not isinstance(config, ControllerConfig):
        raise ValueError(f"it requires controller={config!r:.80}, but must a ControllerConfig")
    plain = {field.name: getattr(config, field.name) for field in fields(config)}
    plain["gains"] = _numbers(config.gains)
    if config.adaptation is not None:
        kind = type(config.adaptation).__name__
        plain["adaptation"] = {"kind": kind, **_numbers(config.adaptation)}
    if config.feedforward is not None:
        if config.feedforward is not load_belief():
            raise ValueError(
                "its controller compensates a force model of its own, which the grader does not "
                "read; compensate in act(), or take swarm_envs.baselines.neural_swarm.load_belief()"
            )
        plain["feedforward"] = _BELIEF
    return plain


def _numbers(settings: Any) -> dict[str, float]:
    return {field.name: float(getattr(settings, field.name)) for field in fields(settings)}


def from_plain(plain: Any) -> dict[str, Any]:
    """What `to_plain` gave, as options of an environment.

    Raises:
        ValueError: it is something else, or an option that no work may choose.
        TypeError: a value is of the wrong kind.
    """
    if not isinstance(plain, dict):
        raise ValueError(f"requires is {plain!r:.80}, but must be a mapping of options")
    found = {}
    for name, value in plain.items():
        check_name("required option", name, OPTIONS)
        if name.startswith("num_") and value is not None:
            check_integer(name, value, 0, MOST_SEEN)
        elif name == "controller" and value is not None:
            value = _controller_from_plain(value)
        found[name] = value
    return found


def _controller_from_plain(plain: Any) -> ControllerConfig:
    if not isinstance(plain, dict):
        raise ValueError(f"controller is {plain!r:.80}, but must be a mapping of settings")
    given = dict(plain)
    given["gains"] = PositionGains(**_mapping(given.get("gains")))
    adaptation, feedforward = given.get("adaptation"), given.get("feedforward")
    if adaptation is not None:
        numbers = dict(_mapping(adaptation))
        kind = check_name("adaptation", numbers.pop("kind", None), _ADAPTATIONS)
        given["adaptation"] = _ADAPTATIONS[kind](**numbers)
    if feedforward is not None:
        check_name("feedforward", feedforward, (_BELIEF,))
        given["feedforward"] = load_belief()
    return ControllerConfig(**given)


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{value!r:.80} should be a mapping of numbers")
    return value
