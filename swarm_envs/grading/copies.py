"""The recognition of copies: work of others in a submission, by weights, source and actions.

Known are the agents and force models that ship, and in a checkout the reference solutions of
`tests/solutions`. Two policies are alike if what no simple law of their observations explains of
one is that of the other, turned and scaled: so much two people do not write independently.
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
"""Likeness from which on one policy is a copy of another. Agents and solutions that were written or
trained independently reach 0.65, one that imitates the teacher of another 0.7; a copy that is
turned, scaled or filtered has 0.97, and one with noise of a quarter of the largest action 0.9."""
_LINEAR = 0.05  # share of actions that a law must leave unexplained to be told from others
_BENT = 200  # random features that tell a policy from noise
_PLAIN = ("straight-line",)  # laws that everybody writes
_SHORTEST = 400  # characters of a function's syntax tree: of less, two people write the same
_MOST_READ = 4 << 20  # bytes of files that are looked at as sources
_LONG = 100  # characters of a constant from which on its value is not compared
_NOBODYS = ("hover", "random")  # who does nothing has not copied it
_PACKAGE = Path(swarm_envs.__file__).parent
SOLUTIONS = _PACKAGE.resolve().parent / "tests" / "solutions"
"""Reference solutions, where the package is a checkout."""


def harmless(check: Callable[..., str], *given: Any) -> str:
    """Return what a check finds; "" if it fails, for which no work is to pay."""
    with suppress(Exception):
        return check(*given)
    return ""


def copied_files(home: Path, work: str) -> str:
    """Return what is in the files of a work that others wrote: weights, or a function; or ""."""
    own, left = home / work.rpartition(":")[0], _MOST_READ
    for file in sorted(filter(Path.is_file, home.rglob("*")), key=own.__ne__):  # its own first
        known = _known_weights() if file.suffix in (".safetensors", ".json") else {}
        if known and (name := known.get(_digest(file))):
            return name
        left -= file.stat().st_size
        if left > 0:  # any file may be text that is executed
            others = _known_functions()
            with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
                if found := [others[said] for said in _functions(file) if said in others]:
                    return found[0]
    return ""


def _digest(file: Path) -> str:
    """Return the digest of a file; of safetensors without the header, written in many ways."""
    content = file.read_bytes()
    start = 8 + int.from_bytes(content[:8], "little") if file.suffix == ".safetensors" else 0
    return hashlib.sha256(content[start:]).hexdigest()


@cache
def _known_weights() -> dict[str, str]:
    """Names of shipped weights by their digests."""
    folders = [(_PACKAGE / part).resolve() for part in ("agents", "baselines", "interactions")]
    files = [file for folder in folders for file in folder.rglob("weights/*.safetensors")]
    files.append(_PACKAGE / "interactions" / "weights" / "wake.json")
    return {_digest(file): file.stem for file in files}


@cache
def known_forces() -> dict[str, InteractionModel]:
    """Return the force models that ship, by name."""
    folders = [(_PACKAGE / part).resolve() for part in ("baselines", "interactions")]
    files = [file for folder in folders for file in folder.rglob("weights/*.safetensors")]
    return {"wake": load_forces("wake"), **{file.stem: load_forces(file) for file in files}}


@cache
def _known_functions() -> dict[str, str]:
    """Names of known classes or files by the functions in them, but for those of starters."""
    given = {said for file in (_PACKAGE / "assignments").rglob("*.py") for said in _functions(file)}
    places = [place.partition(":")[0].replace(".", "/") for place in SHIPPED.values()]
    files = [_PACKAGE.parent / f"{place}.py" for place in places]
    files += [*(_PACKAGE / "agents").glob("*.py"), *SOLUTIONS.glob("*.py")]
    found = {said: f for f in filter(Path.is_file, files) for said in _functions(f)}
    return {said: f"{f.parent.name}/{f.name}" for said, f in found.items() if said not in given}


def _functions(file: Path) -> Iterator[str]:
    """Say what each function of a source does: without names of variables, and docstrings.

    Functions in others are said once, alone: else the time would grow with the square of a source.
    """
    for node in [*ast.walk(ast.parse(file.read_bytes()))]:
        if isinstance(node, ast.FunctionDef):
            with suppress(RecursionError):
                body = map(_Nameless().visit, node.body)
                said = "\n".join(ast.dump(line) for line in body if line is not None)
                if len(said) >= _SHORTEST:
                    yield said


class _Nameless(ast.NodeTransformer):
    """Takes names of variables, long constants and docstrings out of a syntax tree."""

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """Forget the name."""
        return ast.Name("name", node.ctx)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """Forget a value that is long."""
        return ast.Constant(node.value if len(repr(node.value)) < _LONG else "long")

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Forget a docstring."""
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Pass(self, node: ast.Pass) -> None:
        """Forget a statement that does nothing."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Forget a function in another."""


def basis(columns: Array) -> Array:
    """Return an orthonormal basis (S, B) of columns (S, C)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    there = values > 1e-9 * values[-1]
    found: Array = columns @ (vectors[:, there] / np.sqrt(values[there]))
    return found


def unexplained(laws: Array, acts: Array) -> Array:
    """Return (S, A) what a basis of laws leaves of actions (S, A); zeros if that is little."""
    left: Array = acts - laws @ (laws.T @ acts)
    little = len(laws) < 4 * laws.shape[1] or norm(left) < _LINEAR * norm(acts)
    return np.zeros_like(left) if little else left


def likenesses(rows: Array, acts: Array, known: dict[str, Array]) -> dict[str, float]:
    """Return how alike actions (S, A) are to those of known agents in the same situations.

    What linear laws of the rows explain, or the saturated law of `straight-line`, everybody writes.
    Of the rest noise is taken away: only what known agents and bent features of the rows explain of
    it counts. The likeness is its correlation with the other's, turned and scaled at best.
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
    mixed = np.random.default_rng(0).normal(size=(rows.shape[1], _BENT)) / np.sqrt(rows.shape[1])
    bent = np.maximum(rows @ mixed, 0.0)
    shown = basis(np.concatenate([bent - laws @ (laws.T @ bent), *others.values()], axis=1))
    left = shown @ (shown.T @ left)
    return {name: _correlation(left, other) for name, other in others.items()}


def _correlation(one: Array, other: Array) -> float:
    """Return the correlation of two policies (S, A), one turned and scaled."""
    turned = np.linalg.svd(one.T @ other, compute_uv=False).sum()
    return float(turned / max(norm(one) * norm(other), 1e-9))


def copied_acts(env: SwarmParallelEnv, kept: Sequence[tuple[Float32Array, Array]]) -> str:
    """Return the name of the known agent that acts alike, or "".

    Args:
        env: in which the work flew.
        kept: its decisions: rows (N, row width) of the environment, and actions (N, width).
    """
    rows, acts = (np.stack(part) for part in zip(*kept, strict=True))
    known = {}
    for name in _known_agents():
        with suppress(Exception):  # it flies no such episodes, or not by rows
            known[name] = _flat(_acts_of(name, env, rows))
    alike = {"": ALIKE, **likenesses(_flat(rows), _flat(acts), known)}
    name = max(alike, key=alike.__getitem__)
    return Path(name.partition(":")[0]).name if ":" in name else name


def _flat(array: Array) -> Array:
    return array.reshape(-1, array.shape[-1])


def _known_agents() -> list[str]:
    """Names of agents that act on rows; those of `baselines` plan from the true state."""
    own = [name for name, place in SHIPPED.items() if place.startswith("swarm_envs.agents.")]
    files = [f"{file}:{name}" for file in SOLUTIONS.glob("*.py") for name in _classes(file)]
    return [*(name for name in own if name not in _NOBODYS), *files]


def _classes(file: Path) -> list[str]:
    return [n.name for n in ast.parse(file.read_bytes()).body if isinstance(n, ast.ClassDef)]


def _acts_of(name: str, env: SwarmParallelEnv, rows: Float32Array) -> Array:
    """Return the actions of a known agent for the rows of another.

    Raises:
        ValueError: it acts otherwise.
    """
    agent = _loaded(name)
    if agent.privileged or agent.requires.get("action", "") != env.core.mode.name:
        raise ValueError(f"{name} acts otherwise")
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
    """Return rows (..., width) as another layout has them, without neighbors that nobody saw."""
    places = {field.name: field.where for field in env.observation_layout}
    found = np.zeros((*rows.shape[:-1], layout[-1].where.stop), np.float32)
    for field in layout:
        if field.name in places:
            found[..., field.where] = rows[..., places[field.name]]
    return found
