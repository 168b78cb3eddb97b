"""Detection of copies in a submission, by weights, source code and actions.

Submissions are compared with the included agents and force models, and in a checkout with the
reference solutions of `tests/solutions`. The similarity of two policies is the correlation, up to
rotation and scale, of their actions without the part that simple control laws explain.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.linalg import norm

import swarm_envs
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.registry import SHIPPED, load_agent
from swarm_envs.envs.observation import Float32Array, ObservationField, observation_layout
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.grading.pipes import Array
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions import load as load_forces

ALIKE = 0.88
"""Similarity at which a policy counts as a copy. Agents and solutions that were written or trained
independently reach 0.65, and students of the same teacher 0.7; a copy that is rotated, scaled or
filtered has 0.97, and one with noise of a quarter of the largest action 0.9."""
_LINEAR = 0.05  # Least fraction of actions that simple laws must leave unexplained for a comparison
_NUM_FEATURES = 200  # Number of random nonlinear features that separate a policy from noise
_PLAIN = ("straight-line",)  # Control laws that anybody may write
_SHORTEST = 400  # Length of a function's syntax tree below which functions are not compared
_MOST_READ = 4 << 20  # Bytes of files that are parsed as source code
_LONG = 100  # Length of a constant from which its value is not compared
_TRIVIAL = ("hover", "random")  # Trivial agents, which are not compared
_PACKAGE = Path(swarm_envs.__file__).parent
SOLUTIONS = _PACKAGE.resolve().parent / "tests" / "solutions"
"""Folder of the reference solutions, in a checkout of the repository."""


def harmless(check: Callable[..., str], *given: Any) -> str:
    """Return the result of a check, or "" if it raises, so that no submission suffers from it."""
    with suppress(Exception):
        return check(*given)
    return ""


def copied_files(home: Path, work: str) -> str:
    """Return the name of copied weights or source code in the files of a submission, or ""."""
    own, left = home / work.rpartition(":")[0], _MOST_READ
    for file in sorted(filter(Path.is_file, home.rglob("*")), key=own.__ne__):  # `own` first
        known = _known_weights() if file.suffix in (".safetensors", ".json") else {}
        if known and (name := known.get(_digest(file))):
            return name
        left -= file.stat().st_size
        if left > 0:  # any file may be text that is executed
            others = _known_functions()
            with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
                if found := [others[source] for source in _functions(file) if source in others]:
                    return found[0]
    return ""


def _digest(file: Path) -> str:
    """Return the digest of a file; of safetensors without the header, which may vary."""
    content = file.read_bytes()
    start = 8 + int.from_bytes(content[:8], "little") if file.suffix == ".safetensors" else 0
    return hashlib.sha256(content[start:]).hexdigest()


@cache
def _known_weights() -> dict[str, str]:
    """Return the names of included weights by their digests."""
    folders = [(_PACKAGE / part).resolve() for part in ("agents", "baselines", "interactions")]
    files = [file for folder in folders for file in folder.rglob("weights/*.safetensors")]
    files.append(_PACKAGE / "interactions" / "weights" / "wake.json")
    return {_digest(file): file.stem for file in files}


@cache
def known_forces() -> dict[str, InteractionModel]:
    """Return the included force models by name."""
    folders = [(_PACKAGE / part).resolve() for part in ("baselines", "interactions")]
    files = [file for folder in folders for file in folder.rglob("weights/*.safetensors")]
    return {"wake": load_forces("wake"), **{file.stem: load_forces(file) for file in files}}


@cache
def _known_functions() -> dict[str, str]:
    """Return the names of known files by the functions in them, except those of starters."""
    given = {
        source for file in (_PACKAGE / "assignments").rglob("*.py") for source in _functions(file)
    }
    places = [place.partition(":")[0].replace(".", "/") for place in SHIPPED.values()]
    files = [_PACKAGE.parent / f"{place}.py" for place in places]
    files += [*(_PACKAGE / "agents").glob("*.py"), *SOLUTIONS.glob("*.py")]
    found = {source: f for f in filter(Path.is_file, files) for source in _functions(f)}
    return {
        source: f"{f.parent.name}/{f.name}" for source, f in found.items() if source not in given
    }


def _functions(file: Path) -> Iterator[str]:
    """Yield the syntax tree of each function of a file, without names of variables and docstrings.

    Nested functions are yielded separately, so that the time does not grow quadratically.
    """
    for node in [*ast.walk(ast.parse(file.read_bytes()))]:
        if isinstance(node, ast.FunctionDef):
            with suppress(RecursionError):
                body = map(_Nameless().visit, node.body)
                source = "\n".join(ast.dump(line) for line in body if line is not None)
                if len(source) >= _SHORTEST:
                    yield source


class _Nameless(ast.NodeTransformer):
    """Transformer that removes names of variables, long constants and docstrings."""

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """Remove the name."""
        return ast.Name("name", node.ctx)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """Remove a long value."""
        return ast.Constant(node.value if len(repr(node.value)) < _LONG else "long")

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Remove a docstring."""
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Pass(self, node: ast.Pass) -> None:
        """Remove a `pass` statement."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Remove a nested function."""


def basis(columns: Array) -> Array:
    """Return an orthonormal basis (S, B) of columns (S, C)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    there = values > 1e-9 * values[-1]
    found: Array = columns @ (vectors[:, there] / np.sqrt(values[there]))
    return found


def unexplained(laws: Array, acts: Array) -> Array:
    """Return the residual (S, A) of actions (S, A) after a basis of laws; zeros if it is small."""
    left: Array = acts - laws @ (laws.T @ acts)
    little = len(laws) < 4 * laws.shape[1] or norm(left) < _LINEAR * norm(acts)
    return np.zeros_like(left) if little else left


def similarities(rows: Array, acts: Array, known: dict[str, Array]) -> dict[str, float]:
    """Return the similarity of actions (S, A) to those of known agents in the same situations.

    The part of the actions that linear laws of the rows or `straight-line` explain is removed. The
    rest is projected onto the known agents' actions and random nonlinear features of the rows,
    which removes noise. The similarity is its correlation with the rest of another agent's actions
    after the best rotation and scaling.
    """
    rows = np.asarray(rows, np.float64)
    rows = rows[:, rows.std(axis=0) > 1e-6]
    rows = (rows - rows.mean(axis=0)) / rows.std(axis=0)
    plain = [known[name] for name in _PLAIN if name in known]
    laws = basis(np.concatenate([rows, np.ones((len(rows), 1)), *plain], axis=1))
    others = {n: unexplained(laws, each) for n, each in known.items() if n not in _PLAIN}
    left = unexplained(laws, acts)
    if not others or not left.any():
        return {}
    mixed = np.random.default_rng(0).normal(size=(rows.shape[1], _NUM_FEATURES)) / np.sqrt(
        rows.shape[1]
    )
    features = np.maximum(rows @ mixed, 0.0)
    features -= laws @ (laws.T @ features)
    shared = basis(np.concatenate([features, *others.values()], axis=1))
    left = shared @ (shared.T @ left)
    return {name: _correlation(left, other) for name, other in others.items()}


def _correlation(one: Array, other: Array) -> float:
    """Return the correlation of two policies (S, A) after the best rotation and scaling of one."""
    turned = np.linalg.svd(one.T @ other, compute_uv=False).sum()
    return float(turned / max(norm(one) * norm(other), 1e-9))


def copied_acts(env: SwarmParallelEnv, kept: Sequence[tuple[Float32Array, Array]]) -> str:
    """Return the name of the known agent with similar actions, or "".

    Args:
        env: the environment of the decisions.
        kept: decisions: rows (N, row width) of the environment, and actions (N, width).
    """
    rows, acts = (np.stack(part) for part in zip(*kept, strict=True))
    known = {}
    for name in _known_agents():
        with suppress(Exception):  # it may not support the task or the action
            known[name] = _flat(_acts_of(name, env, rows))
    alike = {"": ALIKE, **similarities(_flat(rows), _flat(acts), known)}
    name = max(alike, key=alike.__getitem__)
    return Path(name.partition(":")[0]).name if ":" in name else name


def _flat(array: Array) -> Array:
    return array.reshape(-1, array.shape[-1])


def _known_agents() -> list[str]:
    """Return the names of agents that act on rows; those of `baselines` need the true state."""
    own = [name for name, place in SHIPPED.items() if place.startswith("swarm_envs.agents.")]
    files = [f"{file}:{name}" for file in SOLUTIONS.glob("*.py") for name in _classes(file)]
    return [*(name for name in own if name not in _TRIVIAL), *files]


def _classes(file: Path) -> list[str]:
    return [n.name for n in ast.parse(file.read_bytes()).body if isinstance(n, ast.ClassDef)]


def _acts_of(name: str, env: SwarmParallelEnv, rows: Float32Array) -> Array:
    """Return the actions of a known agent for the rows of another agent.

    Raises:
        ValueError: it needs the true state or has another action space.
    """
    agent = _loaded(name)
    if agent.privileged or agent.requires.get("action", "") != env.core.mode.name:
        raise ValueError(f"{name} has other observations or actions")
    if isinstance(agent, PolicyAgent):
        layout = observation_layout(*agent.policy.note.form)
    else:
        config = replace(env.core.config, **{**agent.requires, "num_obstacles": 0})
        twin = SwarmParallelEnv(env.core.task, config)
        layout = twin.observation_layout
        agent.reset(twin, 0)
    seen = _observed(rows, env, layout)
    return np.stack([np.asarray(agent.act_batch(team), np.float64) for team in seen])


@cache
def _loaded(name: str) -> Any:
    return load_agent(name)


def _observed(
    rows: Float32Array, env: SwarmParallelEnv, layout: Sequence[ObservationField]
) -> Float32Array:
    """Return rows (..., width) in another layout, with zeros for fields that they lack."""
    columns = {field.name: field.where for field in env.observation_layout}
    found = np.zeros((*rows.shape[:-1], layout[-1].where.stop), np.float32)
    for field in layout:
        if field.name in columns:
            found[..., field.where] = rows[..., columns[field.name]]
    return found
