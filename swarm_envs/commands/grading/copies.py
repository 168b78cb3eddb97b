"""Included agents, recognised in a submission: by its weights, its source, and by what it does."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.agents.policy import read_policy
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.commands.grading.messages import Array
from swarm_envs.commands.grading.remote import path_of
from swarm_envs.envs.observation import Float32Array, ObservationField, observation_layout
from swarm_envs.envs.parallel import SwarmParallelEnv

ALIKE = 0.1
"""Difference of actions that are the same but for a disguise, over their size."""
_NOBODYS = ("hover", "random")  # whoever does nothing has not copied it
_LARGEST = 1 << 26  # bytes of a file that is looked at
Twins = dict[str, SwarmParallelEnv]
"""Environments that shipped agents are made for, by their options: many share one."""


def copied_files(name: str) -> str:
    """Name of the shipped agent whose weights or source are in a work's files; "" for none."""
    path = path_of(name)
    if path.suffix == ".py" and path.is_file() and (found := _copied_source(path)):
        return found
    folder = path if path.is_dir() else path.parent
    beside = [path] if path.suffix == ".safetensors" else sorted(folder.glob("*.safetensors"))
    for file in beside:
        if file.is_file() and file.stat().st_size < _LARGEST and (found := _copied_weights(file)):
            return found
    return ""


def copied_acts(env: SwarmParallelEnv, kept: Sequence[tuple[Float32Array, Array]]) -> str:
    """Name of the shipped agent, perhaps behind a safety filter, that acts alike; "" for none.

    Args:
        env: in which the work flew.
        kept: its decisions: rows (N, row width), and actions (N, width).
    """
    if not kept:
        return ""
    rows, acts = (np.stack(part) for part in zip(*kept, strict=True))
    # Those of `swarm_envs.baselines` plan from the true state, and take half of a second to import.
    acting = (name for name, place in SHIPPED.items() if place.startswith("swarm_envs.agents."))
    names = [name for name in acting if name not in _NOBODYS]
    names += [name + FILTER for name in names]
    twins: Twins = {}
    for name in names:
        try:
            own = _shipped_acts(name, env, rows, twins)
        except (ValueError, AttributeError):  # it flies no such episodes, or not by rows
            continue
        if any(_alike(one, acts) for one in own):
            return name
    return ""


def _shipped_acts(
    name: str, env: SwarmParallelEnv, rows: Float32Array, twins: Twins
) -> list[Array]:
    """Actions of a shipped agent's policies; none if it is privileged, or acts otherwise."""
    agent: Any = _shipped(name)
    if agent.privileged or agent.requires.get("action", "") != env.core.mode.name:
        return []
    acting: Any = getattr(agent, "policies", ())
    layouts = [observation_layout(*one.policy.note.form) for one in acting]
    if not acting:
        config = replace(env.core.config, **{**agent.requires, "num_obstacles": 0})
        twin = twins.get(repr(config))
        if twin is None:
            twin = twins[repr(config)] = SwarmParallelEnv(env.core.task, config)
        acting, layouts = [agent], [twin.observation_layout]
        agent.reset(twin, 0)
    return [
        np.asarray(one.act_batch(_observed(rows, env, layout)), np.float64)
        for one, layout in zip(acting, layouts, strict=True)
    ]


def _alike(own: Array, acts: Array) -> bool:
    """Whether half of the actions are another agent's own, or nine tenths but for a factor."""
    size = np.maximum(np.linalg.norm(own, axis=-1), 1e-6)
    factor = np.median(np.sum(own * acts, axis=-1) / size**2)
    for scale, most in ((1.0, 0.5), (factor, 0.9)):
        apart = np.linalg.norm(scale * own - acts, axis=-1)
        if np.mean(apart <= ALIKE * abs(scale) * size) > most:
            return True
    return False


def _observed(
    rows: Float32Array, env: SwarmParallelEnv, layout: Sequence[ObservationField]
) -> Float32Array:
    """Rows (..., width) as another layout has them.

    Of more neighbors the farther are left out; those that nobody observed are not there.
    """
    places = {field.name: field.where for field in env.observation_layout}
    found = np.zeros((*rows.shape[:-1], layout[-1].where.stop), np.float32)
    for field in layout:
        if field.name in places:
            found[..., field.where] = rows[..., places[field.name]]
    return found


@cache
def _shipped(name: str) -> Any:
    return load(name)


@cache
def _shipped_weights() -> dict[str, str]:
    """Names of shipped policies by the digests of their weights."""
    agents = {name: _shipped(name) for name, path in SHIPPED.items() if "agents.policy" in path}
    return {one.digest: name for name, agent in agents.items() for one in agent.policies}


def _copied_weights(file: Path) -> str:
    try:
        return _shipped_weights().get(read_policy(file).digest, "")
    except (ValueError, OSError, RecursionError, MemoryError):
        return ""  # no policy, or none that could fly


@cache
def _shipped_sources() -> dict[str, str]:
    """Names of shipped agents by what their classes say."""
    found: dict[str, str] = {}
    for name, place in SHIPPED.items():
        module, _, path = place.partition(":")
        source = "" if name in _NOBODYS else _source_of(module, path.partition(".")[0])
        for said in _classes(ast.parse(source)):
            found.setdefault(said, name)
    return found


def _source_of(module: str, kind: str) -> str:
    """The file that defines a class; "" for a function. Planners are slow to import: it is read."""
    path = Path(swarm_envs.__file__).parent.joinpath(*module.split(".")[1:])
    for file in sorted(path.glob("*.py")) if path.is_dir() else [path.with_suffix(".py")]:
        if f"\nclass {kind}" in (text := file.read_text("utf-8")):
            return text
    return ""


def _copied_source(file: Path) -> str:
    try:
        classes = [*_classes(ast.parse(file.read_bytes()))]
    except (SyntaxError, ValueError, OSError, RecursionError, MemoryError):
        return ""
    return next((_shipped_sources()[said] for said in classes if said in _shipped_sources()), "")


def _classes(tree: ast.Module) -> Iterator[str]:
    """What each class of a source says, but for its name, comments and docstrings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for part in ast.walk(node):
                if isinstance(part, ast.ClassDef | ast.FunctionDef):
                    part.body = [line for line in part.body if not _is_text(line)]
            yield "\n".join(ast.dump(part) for part in node.body)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
