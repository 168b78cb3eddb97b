"""`swarm-envs record`: flights of an agent as a dataset of Minari, for offline learning.

Flights are kept in parts, a file each, while the command runs: killed, it continues after the last
whole part. The dataset is made of them at the end and put in its place in one step.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from swarm_envs.arguments import Count, Seed
from swarm_envs.commands.checks import Misuse, check_folder, command_options
from swarm_envs.commands.fly import EpisodeOptions, check_flies, find_task, prepare

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

    from swarm_envs.agents import Agent
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.envs.parallel import SwarmParallelEnv

Flight = dict[str, np.ndarray[Any, Any]]
"""A flight of T decisions: `rows` (T + 1, N, width), `actions` (T, N, width), `rewards`, `active`
and `ended` (T, N), and `seed`, `success` and `truncated` of the team."""
_ROOT = "MINARI_DATASETS_PATH"
"""Minari's variable for the folder of its datasets."""
_ROWS_AT_ONCE = 200_000
"""Observation rows of a part, about."""
_MOST_AT_ONCE = 64


@command_options
@dataclass(frozen=True, kw_only=True)
class RecordOptions(EpisodeOptions):
    """Fly episodes of an agent and write them as a dataset of Minari, for offline learning.

    `minari.load_dataset(NAME)` loads it. Run again, an interrupted command resumes. The same
    options give the same flights.
    """

    agent: str = "roundabout"
    """the agent: a name as of `fly`, the folder of a trained policy, or path/to/file.py:Class"""
    flights: Count = 64
    """number of flights"""
    seed: Seed = 0
    """the flights' seeds are drawn from it, as those of `evaluate`"""
    rows: Literal["team", "drone"] = "team"
    """an episode of the dataset: of the `team`, as the joint Gymnasium interface has it; or of one
    `drone`, what it observed and did itself: a flight of N drones gives N, one after another"""
    physics: str = "batch"
    """`batch` or `bullet`"""
    force_rate: Count = 240
    """evaluations of the force per second: 240 over an integer"""
    name: str | None = None
    """the dataset's name; TASK-AGENT-v0 if not given"""
    out: Path | None = None
    """folder of datasets; Minari's own if not given, ~/.minari/datasets"""


def run_record(options: RecordOptions) -> None:
    """Fly, and write the dataset.

    Raises:
        BlockingIOError: another process writes the same dataset.
        ImportError: Minari is not installed; nothing was flown.
        Misuse: there is no such task, agent, option or place to write; nothing was flown.
        ValueError: the agent failed in flight, or other options began this dataset.
    """
    if any(importlib.util.find_spec(module) is None for module in ("minari", "h5py")):
        raise ImportError("a dataset needs Minari; install it by: pip install 'swarm-envs[minari]'")
    from minari.dataset.minari_dataset import parse_dataset_id

    from swarm_envs.agents.evaluation import frozen_seeds
    from swarm_envs.files import claimed

    try:
        task = find_task(options.task)
        agent, env = prepare(options.agent, options, task)
        name = options.name or f"{task.partition('_')[0]}-{Path(options.agent).stem}-v0"
        parse_dataset_id(name := name.replace("+", "-"))
        check_flies(options.agent, agent, env, options, frozen_seeds(options.seed, 1)[0])
    except (ValueError, TypeError, FileNotFoundError) as error:
        raise Misuse(str(error)) from error
    root = options.out or Path(os.environ.get(_ROOT, Path.home() / ".minari" / "datasets"))
    check_folder("--out", root)
    if (root / name).exists():
        raise Misuse(f"there is a dataset {name!r} in {str(root)!r}; choose another --name")
    with claimed(kept := root / f"{name}.flights"):
        parts = _fly_parts(env, agent, options, kept)
        _assemble(kept, name, parts, {**options.setting(), **agent.requires}, options)
        (kept / "whole" / name).rename(root / name)
        shutil.rmtree(kept)
    shown = "" if options.out is None else f"{_ROOT}={root} "
    print(f"wrote {root / name}; {shown}python -c \"import minari; minari.load_dataset('{name}')\"")


def _fly_parts(
    env: SwarmParallelEnv, agent: Agent, options: RecordOptions, folder: Path
) -> list[Path]:
    """Fly what is not kept yet, with a progress bar; the files of all parts in order."""
    from tqdm import tqdm

    from swarm_envs import __version__
    from swarm_envs.agents.evaluation import frozen_seeds, source_digest
    from swarm_envs.files import parse_note, write_json

    setting = {**options.setting(), "agent": options.agent, "source": source_digest(agent)}
    about = {"task": env.core.task.name, **setting, "seed": options.seed, "version": __version__}
    note = folder / "about.json"
    if note.exists() and parse_note(note.read_text("utf-8")) != about:
        raise ValueError(
            f"{str(folder)!r} holds flights of other options; remove it, or choose another --name"
        )
    write_json(note, about)
    seeds = frozen_seeds(options.seed, options.flights)
    size = _at_once(env)
    chunks = [seeds[first : first + size] for first in range(0, len(seeds), size)]
    files = [folder / f"{first * size:06}.npz" for first in range(len(chunks))]
    core: SwarmCore | None = None
    with tqdm(total=len(seeds), desc=options.agent[-30:], unit="flight", mininterval=0.5) as bar:
        for file, chunk in zip(files, chunks, strict=True):
            if not file.exists() or len(_loaded(file, "seed")["seed"]) != len(chunk):
                core = core or _core(env, agent, seeds[0], size)
                _save(file, _fly(env, agent, core, chunk))
            bar.update(len(chunk))
    return files


def _at_once(env: SwarmParallelEnv) -> int:
    """How many flights a part has."""
    decisions = env.view.horizon_s * env.core.config.decision_rate
    return int(np.clip(_ROWS_AT_ONCE // (decisions * env.core.num_drones), 1, _MOST_AT_ONCE))


def _core(env: SwarmParallelEnv, agent: Agent, seed: int, size: int) -> SwarmCore:
    """What flies: many environments if the agent acts on arrays, else the environment itself."""
    from swarm_envs.agents.protocol import flies_batches
    from swarm_envs.envs.core import SwarmCore

    if not flies_batches(env, agent):
        return env.core
    env.reset(seed=seed)
    agent.reset(env, seed)
    return SwarmCore(env.core.task, env.core.config, size)


def _fly(
    env: SwarmParallelEnv, agent: Any, core: SwarmCore, seeds: Sequence[int]
) -> Iterator[Flight]:
    """Fly these seeds, as many at once as the core has environments."""
    for first in range(0, len(seeds), core.num_envs):
        chunk = [*seeds[first : first + core.num_envs]]
        if core is env.core:
            env.reset(seed=chunk[0])
            agent.reset(env, chunk[0])
        else:
            idle = core.num_envs - len(chunk)
            core.reset([*chunk, *[None] * idle], np.arange(core.num_envs) < len(chunk))
        steps = [*_steps(env, agent, core)]
        for e, seed in enumerate(chunk):
            yield _flight(core, e, seed, steps)


def _steps(env: SwarmParallelEnv, agent: Any, core: SwarmCore) -> Iterator[Flight]:
    """Decisions of all environments until none flies: what was seen, done and given."""
    shape = (core.num_envs, core.num_drones, core.mode.width)
    while core.running.any():
        rows, running = core.rows.copy(), core.running.copy()
        actions = np.zeros(shape, np.float32)  # what is flown is what the dataset has
        if core is env.core:
            view = env.view if agent.privileged else None
            actions[0] = np.stack([*agent.act(env.split(rows), view).values()])
        else:
            actions[running] = agent.act_batch(rows[running])
        flown = core.step(actions)
        after = core.rows.copy()
        given = {"rewards": flown.rewards, "active": flown.active, "ended": flown.ended}
        yield {"rows": rows, "after": after, "actions": actions, "running": running, **given}


def _flight(core: SwarmCore, e: int, seed: int, steps: Sequence[Flight]) -> Flight:
    """What environment `e` has flown."""
    mine = [step for step in steps if step["running"][e]]
    names = ("actions", "rewards", "active", "ended")
    flight = {name: np.stack([step[name][e] for step in mine]) for name in names}
    rows = [*(step["rows"][e] for step in mine), mine[-1]["after"][e]]
    about = {"seed": np.array(seed), "success": np.array(core.metrics(e)["success"])}
    truncated = np.array(core.world.environments["truncated"][e])
    return {**flight, "rows": np.stack(rows), **about, "truncated": truncated}


def _save(file: Path, flights: Iterator[Flight]) -> None:
    """Write flights into one file, one after another, whole or not at all."""
    from swarm_envs.files import written_whole

    found = [*flights]
    content: dict[str, Any] = {
        name: np.stack([f[name] for f in found])
        if found[0][name].ndim == 0
        else np.concatenate([f[name] for f in found])
        for name in found[0]
    }
    lengths = np.array([len(flight["actions"]) for flight in found])
    with written_whole(file) as partial:
        np.savez(partial, **content, lengths=lengths)


def _loaded(file: Path, *names: str) -> Flight:
    with np.load(file, allow_pickle=False) as content:
        return {name: content[name] for name in names or content.files}


def _flights(file: Path) -> Iterator[Flight]:
    """The flights of a part."""
    held = _loaded(file)
    ends = np.cumsum(held["lengths"])
    for k, (end, length) in enumerate(zip(ends, held["lengths"], strict=True)):
        steps, rows = slice(end - length, end), slice(end - length + k, end + k + 1)
        flight = {n: held[n][steps] for n in ("actions", "rewards", "active", "ended")}
        yield {**flight, "rows": held["rows"][rows], **{n: held[n][k] for n in _OF_TEAM}}


_OF_TEAM = ("seed", "success", "truncated")


def _assemble(
    folder: Path,
    name: str,
    parts: Sequence[Path],
    setting: Mapping[str, Any],
    options: RecordOptions,
) -> None:
    """Make the dataset of all parts in a folder of its own."""
    import gymnasium
    import minari
    from tqdm import tqdm

    shutil.rmtree(folder / "whole", ignore_errors=True)
    (folder / "whole").mkdir()
    kind = "" if options.rows == "team" else "Solo"
    family, _, version = find_task(options.task).partition("_")
    task = f"swarm_envs/{family.capitalize()}{kind}-{version}"
    env = gymnasium.make(task, disable_env_checker=True, **setting)
    plain = all(isinstance(value, str | int | float | list) for value in setting.values())
    about = {
        "env": env if plain else None,  # JSON does not hold a controller, which some agents require
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "algorithm_name": options.agent,
        "requirements": ["swarm-envs"],
    }
    made: Any = None
    bar = tqdm(total=len(parts), desc="dataset", unit="part", mininterval=0.5)
    with warnings.catch_warnings(), _minari_in(folder / "whole"), bar:
        warnings.filterwarnings("ignore", module="minari")  # it would like an author's address
        for part in parts:
            episodes = [e for flight in _flights(part) for e in _episodes(flight, options.rows)]
            if made is None:
                made = minari.create_dataset_from_buffers(name, episodes, **about)
            else:
                made.update_dataset_from_buffer(episodes)
            bar.update()


@contextmanager
def _minari_in(folder: Path) -> Iterator[None]:
    """Have Minari keep its datasets in a folder."""
    before = os.environ.get(_ROOT)
    os.environ[_ROOT] = str(folder)
    try:
        yield
    finally:
        del os.environ[_ROOT]
        if before is not None:
            os.environ[_ROOT] = before


def _episodes(flight: Flight, rows: str) -> Iterator[EpisodeBuffer]:
    """The episodes of a flight: of each drone, or of the team."""
    count, drones, _ = flight["actions"].shape
    if rows == "team":
        joint = {n: flight[n].reshape(len(flight[n]), -1) for n in ("rows", "actions")}
        ended = np.zeros(count, np.bool_)
        ended[-1] = not flight["truncated"]
        yield _episode(flight, joint, flight["rewards"].mean(axis=1), ended)
        return
    for i in range(drones):
        lived = int(flight["active"][:, i].sum())
        own = {"rows": flight["rows"][: lived + 1, i], "actions": flight["actions"][:lived, i]}
        yield _episode(flight, own, flight["rewards"][:lived, i], flight["ended"][:lived, i])


def _episode(
    flight: Flight,
    seen: Flight,
    rewards: np.ndarray[Any, Any],
    ended: np.ndarray[Any, Any],
) -> EpisodeBuffer:
    """One episode as Minari takes it."""
    from minari.data_collector import EpisodeBuffer

    cut = np.zeros(len(ended), np.bool_)
    cut[-1] = not ended[-1]
    return EpisodeBuffer(
        seed=int(flight["seed"]),
        observations=seen["rows"],
        actions=seen["actions"],
        rewards=list(rewards),
        terminations=list(ended),
        truncations=list(cut),
        infos={"success": np.full(len(ended) + 1, flight["success"])},
    )
