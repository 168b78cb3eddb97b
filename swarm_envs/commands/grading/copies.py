"""Included agents, recognised in a submission: by its weights, its source, and by what it does."""

from __future__ import annotations

import ast
import hashlib
import tokenize
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import swarm_envs
from swarm_envs.agents import Actions, Observations, Safety, SafetyFilter, load
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.agents.safety import ACTED
from swarm_envs.commands.grading.messages import Array
from swarm_envs.commands.grading.remote import WorkFailed, path_of
from swarm_envs.envs.observation import Float32Array, ObservationField, observation_layout
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions import load as load_forces
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.modelled import modelled_force_g

ALIKE = 0.1  # Difference of actions that are the same but for a disguise, over their size
ALIKE_FORCES = 0.995
"""Correlation of forces from which on a model says what another does. Those that ship, which were
fitted to the same flights in different ways, reach 0.988."""
_FILTER = "SafetyFilter"
_NOBODYS = ("hover", "random")  # whoever does nothing has not copied it
_LARGEST = 1 << 26  # bytes of a file that is looked at
_SHORTEST = 400  # letters of a syntax tree: of less, two people write the same
MOST_SOURCE = 1 << 20  # Bytes of a source; its syntax tree may take six hundred times as many
MOST_CONSTANTS = 2000  # Characters of all constants in a source that holds code, and no weights
MOST_NAMES = 4000  # Characters of all different names in it
_PACKAGE = Path(swarm_envs.__file__).parent
Filter = Callable[[Float32Array, Array], Array]
"""Rows (..., N, row width) and actions (..., N, 3) to the actions that a safety filter allows."""


def check_files(name: str) -> None:
    """Refuse a work that is a file of another user, or that it takes gigabytes to look at.

    Raises:
        WorkFailed: it is a link, a source of more than `MOST_SOURCE` bytes, or no plain file.
    """
    path = path_of(name)
    if path.is_symlink():
        raise WorkFailed("it is a link to another file; hand in the file itself")
    if path.suffix == ".py" and path.exists():
        if not path.is_file():
            raise WorkFailed("it is no plain file")
        if (size := path.stat().st_size) > MOST_SOURCE:
            raise WorkFailed(f"its source has {size} bytes, but may have {MOST_SOURCE}")


def copied_files(name: str) -> str:
    """What ships and is in a work's files: a class, or weights; "" for nothing."""
    path = path_of(name)
    files = sorted((path if path.is_dir() else path.parent).glob("*")) if path.exists() else []
    if path.suffix == ".py" and path.is_file():
        with suppress(SyntaxError, ValueError, OSError, RecursionError, MemoryError):
            classes = _classes(ast.parse(path.read_bytes()))
            shipped = _shipped_classes()
            if found := {own: shipped[said] for said, own in classes.items() if said in shipped}:
                return found.get(name.rpartition(":")[2]) or next(iter(found.values()))
            if _FILTER.encode() in path.read_bytes():
                return f"an agent behind {_FILTER}"
    weights = [file for file in [path, *files] if file.suffix in (".safetensors", ".json")]
    return next(filter(None, map(_shipped_file, weights)), "")


def _shipped_file(file: Path) -> str:
    """Name of the shipped weights that a file has; "" for none."""
    try:  # a pipe may never end, and a device neither
        plain = file.is_file() and 0 < file.stat().st_size < _LARGEST
        return _shipped_weights().get(_digest(file), "") if plain else ""
    except OSError:  # what cannot be read is no copy
        return ""


def copied_forces(predicted: Array, rows: InteractionRows) -> str:
    """Name of the shipped force model that says nearly the same of rows; "" for none.

    Args:
        predicted: (R,) vertical forces of a work, gram-force.
        rows: R of them.
    """
    for name, model in _force_models().items():
        shipped = modelled_force_g(rows, model)[:, 2]
        spread = np.std(shipped) * np.std(predicted)
        if np.mean((shipped - shipped.mean()) * predicted) > ALIKE_FORCES * spread > 0.0:
            return name
    return ""


@cache
def _force_models() -> dict[str, InteractionModel]:
    files = [*_weights("interactions"), *_weights("baselines")]
    return {"wake": load_forces("wake"), **{file.stem: load_forces(file) for file in files}}


def copied_acts(env: SwarmParallelEnv, kept: Sequence[tuple[Float32Array, Array]]) -> str:
    """Name of the shipped agent, perhaps behind a safety filter, that acts alike; "" for none.

    Args:
        env: in which the work flew.
        kept: its decisions: rows (N, row width), and actions (N, width).
    """
    if not kept:
        return ""
    rows, acts = (np.stack(part) for part in zip(*kept, strict=True))
    filtered = _filter_of(env)
    # Those of `swarm_envs.baselines` plan from the true state, and take half of a second to import.
    acting = [name for name, place in SHIPPED.items() if place.startswith("swarm_envs.agents.")]
    for name in acting:
        if name in _NOBODYS:
            continue
        try:
            own = _shipped_acts(name, env, rows)
        except (ValueError, AttributeError):  # it flies no such episodes, or not by rows
            continue
        if own is None:
            continue
        if _alike(own, acts):
            return name
        if filtered is not None and _alike(filtered(rows, own), acts):
            return name + FILTER
    if filtered is not None and _ends_at_filter(env, filtered, rows, acts):
        return f"an agent behind {_FILTER}"
    return ""


def _filter_of(env: SwarmParallelEnv, room_m: float = 0.0) -> Filter | None:
    """What a safety filter that ships makes of rows and actions; None where it filters none.

    Args:
        env: in which they were observed and asked for.
        room_m: by how much further it keeps drones apart than usual, m.
    """
    if env.core.mode.name != "acceleration":
        return None
    k = env.core.config.num_neighbors
    given = _Given({"num_neighbors": k})
    safety: Any = SafetyFilter(given, Safety(num_neighbors=k, margin_m=Safety.margin_m + room_m))
    safety.reset(SwarmParallelEnv(env.core.task, replace(env.core.config, observation="flat")), 0)

    def act(rows: Float32Array, asked: Array) -> Array:
        given.asked = asked.astype(np.float32)
        return np.asarray(safety.act_batch(rows), np.float64)

    return act


class _Given:
    """An agent that asks for actions it was given."""

    privileged = False
    asked: Float32Array

    def __init__(self, requires: Mapping[str, Any]) -> None:
        self.requires = requires

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Nothing to prepare."""

    def act(self, observations: Observations, view: View | None) -> Actions:
        """The actions it was given."""
        return dict(zip(observations, self.asked, strict=True))

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """The actions it was given."""
        return self.asked


def _ends_at_filter(
    env: SwarmParallelEnv, filtered: Filter, rows: Float32Array, acts: Array
) -> bool:
    """Whether actions lie exactly where a safety filter that ships ends to change them.

    Then a filter that keeps 3 mm more between drones changes many more of them.
    """
    wider = _filter_of(env, 0.003)
    assert wider is not None
    usual, more = (
        np.mean(np.abs(act(rows, acts) - acts).max(axis=-1) > ACTED) for act in (filtered, wider)
    )
    return bool(20.0 * usual < more)


def _shipped_acts(name: str, env: SwarmParallelEnv, rows: Float32Array) -> Array | None:
    """Actions of a shipped agent; None if it is privileged, or acts otherwise."""
    agent: Any = _shipped(name)
    if agent.privileged or agent.requires.get("action", "") != env.core.mode.name:
        return None
    if isinstance(agent, PolicyAgent):
        layout = observation_layout(*agent.policy.note.form)
    else:
        config = replace(env.core.config, **{**agent.requires, "num_obstacles": 0})
        twin = SwarmParallelEnv(env.core.task, config)
        layout = twin.observation_layout
        agent.reset(twin, 0)
    return np.asarray(agent.act_batch(_observed(rows, env, layout)), np.float64)


def _alike(own: Array, acts: Array) -> bool:
    """Whether half of the actions are another agent's own, or nine tenths but for a factor."""
    size = np.maximum(np.linalg.norm(own, axis=-1), 1e-6)
    factor = np.median(np.sum(own * acts, axis=-1) / size**2)
    for scale, most in ((1.0, 0.5), (factor, 0.9)):
        apart = np.linalg.norm(scale * own - acts, axis=-1)
        if scale > ALIKE and np.mean(apart <= ALIKE * scale * size) > most:
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


def _weights(folder: str) -> list[Path]:
    return sorted((_PACKAGE / folder).resolve().rglob("weights/*.safetensors"))


@cache
def _shipped_weights() -> dict[str, str]:
    """Names of shipped weights by their digests."""
    files = [file for part in ("agents", "baselines", "interactions") for file in _weights(part)]
    files.append(_PACKAGE / "interactions" / "weights" / "wake.json")
    return {_digest(file): file.stem for file in files}


def _digest(file: Path) -> str:
    """Of a file; of safetensors without the header, which can be written in many ways."""
    content = file.read_bytes()
    start = 8 + int.from_bytes(content[:8], "little") if file.suffix == ".safetensors" else 0
    return hashlib.sha256(content[start:]).hexdigest()


@cache
def _shipped_classes() -> dict[str, str]:
    """Names of the classes of shipped agents, and of those beside them, by what they say."""
    modules = {place.partition(":")[0].partition(".")[2] for place in SHIPPED.values()}
    named = {_PACKAGE / f"{module.replace('.', '/')}.py" for module in modules}
    found: dict[str, str] = {}
    for file in sorted({*named, *(_PACKAGE / "agents").glob("*.py")}):
        if file.is_file():
            found |= _classes(ast.parse(file.read_bytes()))
    return {said: name for said, name in found.items() if len(said) >= _SHORTEST}


def bare_source(file: Path) -> str:
    """A source without comments and docstrings, which could hold weights; lines keep their numbers.

    Raises:
        SyntaxError: it is no Python.
        ValueError: likewise.
        OSError: it cannot be read.
    """
    try:
        with tokenize.open(file) as source:
            lines = source.read().split("\n")
        tokens = [*tokenize.generate_tokens(iter([f"{line}\n" for line in lines]).__next__)]
    except tokenize.TokenError as error:
        raise SyntaxError(str(error)) from error
    comments = [(token, "") for token in tokens if token.type == tokenize.COMMENT]
    code = [token for token in tokens if token.type not in (tokenize.COMMENT, tokenize.NL)]
    docstrings = [
        (token, "0")
        for before, token, after in zip([None, *code], code, code[1:], strict=False)
        if token.type == tokenize.STRING and after.type == tokenize.NEWLINE
        if before is None or before.type in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    ]
    for token, instead in sorted(comments + docstrings, key=lambda each: each[0].start)[::-1]:
        (first, begin), (last, end) = token.start, token.end
        rest = lines[last - 1][end:]
        lines[first - 1] = lines[first - 1][:begin] + instead + (rest if first == last else "")
        if first < last:
            lines[first:last] = [*[""] * (last - first - 1), rest]
    return "\n".join(lines)


def check_room(source: str) -> None:
    """Refuse a source that has room for weights, in its constants or in its names.

    Raises:
        WorkFailed: its constants or names have too many characters.
        SyntaxError: it is no Python.
    """
    parts = [*ast.walk(ast.parse(source))]
    constants = [repr(part.value) for part in parts if isinstance(part, ast.Constant)]
    said = [vars(part).values() for part in parts if not isinstance(part, ast.Constant)]
    names = {each for values in said for each in _texts(values)}
    for what, texts, most in (
        ("constants", constants, MOST_CONSTANTS),
        ("different names", names, MOST_NAMES),
    ):
        if (size := sum(map(len, texts))) > most:
            raise WorkFailed(
                f"its {what} are {size} characters, but may be {most}: what counts is learned in "
                "train()"
            )


def _texts(values: Iterable[Any]) -> Iterator[str]:
    """Texts, and those in lists, among what a node of a syntax tree says."""
    for value in values:
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, str):
                yield each


def _classes(tree: ast.Module) -> dict[str, str]:
    """Names of a source's classes by what each says, but for its name, comments, docstrings."""
    found: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for part in ast.walk(node):
                if isinstance(part, ast.ClassDef | ast.FunctionDef):
                    part.body = [line for line in part.body if not _is_text(line)]
            found["\n".join(ast.dump(part) for part in node.body)] = node.name
    return found


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
