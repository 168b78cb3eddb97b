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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from swarm_envs.arguments import Count, Divides, Seed
from swarm_envs.commands.checks import Misuse, check_folder, command_options
from swarm_envs.commands.fly import EpisodeOptions, best_agent, check_flies, find_task, prepare
from swarm_envs.physics.rigid_body import PHYSICS_RATE

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

    from swarm_envs.agents import Agent
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.envs.parallel import SwarmParallelEnv

Part = dict[str, Any]
"""E flights of T decisions at most: `rows` (T + 1, E, N, width), `actions` (T, E, N, width),
`rewards`, `active` and `ended` (T, E, N), `running` (T, E): which flights made a decision; and
`seed`, `success` and `truncated` (E,) of their teams."""
_ROOT = "MINARI_DATASETS_PATH"  # Minari's variable for the folder of its datasets
_ROWS_AT_ONCE = 200_000  # Observation rows of a part, about
_MOST_AT_ONCE = 64


@command_options
@dataclass(frozen=True, kw_only=True)
class RecordOptions(EpisodeOptions):
    """Fly episodes of an agent and write them as a dataset of Minari, for offline learning.

    `minari.load_dataset(NAME)` loads it. Run again, an interrupted command resumes. The same
    options give the same flights.
    """

    agent: str | None = None
    """the agent, by default the best for the task by the benchmark: a name as of `fly`, the folder
    of a trained policy, or path/to/file.py:Class"""
    flights: Count = 64
    """number of flights"""
    seed: Seed = 0
    """the flights' seeds are drawn from it, as those of `evaluate`"""
    rows: Literal["team", "drone"] = "team"
    """an episode of the dataset: of the `team`, as the joint Gymnasium interface has it; or of one
    `drone`, what it observed and did itself: a flight of N drones gives N, one after another"""
    physics: str = "batch"
    """`batch` or `bullet`"""
    force_rate: Annotated[int, Divides(PHYSICS_RATE)] = 240
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
        options = replace(options, agent=options.agent or best_agent(options, task))
        assert options.agent is not None
        agent, env = prepare(options.agent, options, task)
        name = options.name or f"{task.partition('_')[0]}-{Path(options.agent).stem}-v0"
        parse_dataset_id(name := name.replace("+", "-"))
        check_flies(options.agent, agent, env, options, frozen_seeds(options.seed, 1)[0])
    except (ValueError, TypeError, FileNotFoundError) as error:
        raise Misuse(str(error)) from error
    root = options.out or Path(os.environ.get(_ROOT, Path.home() / ".minari" / "datasets"))
    root = root.absolute()  # Minari joins its own folder and a relative one
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
    from swarm_envs.agents.protocol import flies_batches
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.files import parse_note, write_json, written_whole

    assert options.agent is not None
    setting = {**options.setting(), "agent": options.agent, "source": source_digest(agent)}
    about = {"task": env.core.task.name, **setting, "seed": options.seed, "version": __version__}
    note = folder / "about.json"
    if note.exists() and parse_note(note.read_text("utf-8")) != about:
        raise ValueError(
            f"{str(folder)!r} holds flights of other options; remove it, or choose another --name"
        )
    write_json(note, about)
    seeds = frozen_seeds(options.seed, options.flights)
    files, core, size = [], env.core, 1
    if flies_batches(env, agent):
        rows = env.view.horizon_s * core.config.decision_rate * core.num_drones
        size = min(int(np.clip(_ROWS_AT_ONCE // rows, 1, _MOST_AT_ONCE)), len(seeds))
    with tqdm(total=len(seeds), desc=options.agent[-30:], unit="flight", mininterval=0.5) as bar:
        for first in range(0, len(seeds), size):
            chunk = seeds[first : first + size]
            files.append(file := folder / f"{first:06}-{len(chunk)}.npz")
            if not file.exists():
                if size > 1 and core is env.core:
                    core = SwarmCore(env.core.task, env.core.config, size)
                with written_whole(file) as partial:
                    np.savez(partial, **_fly(env, agent, core, chunk))
            bar.update(len(chunk))
    return files


def _fly(env: SwarmParallelEnv, agent: Any, core: SwarmCore, seeds: Sequence[int]) -> Part:
    """Fly these seeds: one in the environment itself, or all of them at once in a larger core."""
    env.reset(seed=seeds[0])
    agent.reset(env, seeds[0])
    count = len(seeds)
    if core is not env.core:
        idle = core.num_envs - count
        core.reset([*seeds, *[None] * idle], np.arange(core.num_envs) < count)
    steps: list[Part] = []
    while core.running.any():
        rows, running = core.rows.copy(), core.running.copy()
        actions = np.zeros((*rows.shape[:2], core.mode.width), np.float32)
        if core is env.core:
            view = env.view if agent.privileged else None
            actions[0] = np.stack([*agent.act(env.split(rows), view).values()])
        else:
            actions[running] = agent.act_batch(rows[running])
        flown = core.step(actions)  # what is flown is what the dataset has
        given = {"rewards": flown.rewards, "active": flown.active, "ended": flown.ended}
        steps.append({"rows": rows, "actions": actions, "running": running, **given})
    made = {name: np.stack([step[name][:count] for step in steps]) for name in steps[0]}
    made["rows"] = np.concatenate([made["rows"], core.rows[None, :count]])
    success = np.array([core.metrics(e)["success"] for e in range(count)])
    truncated = core.world.environments["truncated"][:count].copy()
    return {**made, "seed": np.array(seeds), "success": success, "truncated": truncated}


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
    given = {**setting, "controller": options.agent} if "controller" in setting else setting
    env = gymnasium.make(task, disable_env_checker=True, **setting)
    about = {
        "env": _recoverable(task, given, env),
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
            with np.load(part, allow_pickle=False) as held:
                episodes = [*_episodes(dict(held), options.rows)]
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


def _recoverable(task: str, given: Mapping[str, Any], env: Any) -> Any:
    """The environment with options that JSON holds, if they make the same; None if none do.

    JSON does not hold a controller, but the name of the shipped agent that requires it.
    """
    import gymnasium

    if not all(isinstance(value, str | int | float | list) for value in given.values()):
        return None
    try:
        found: Any = gymnasium.make(task, disable_env_checker=True, **given)
    except ValueError:  # an agent that does not ship
        return None
    ours, theirs = (made.unwrapped.parallel.core.config.controller for made in (env, found))
    return found if ours == theirs else None


def _episodes(part: Part, rows: str) -> Iterator[EpisodeBuffer]:
    """The episodes of each flight: of each of its drones, or of its team."""
    for e, count in enumerate(part["running"].sum(axis=0).tolist()):
        seen, acts, given = part["rows"][:, e], part["actions"][:, e], part["rewards"][:, e]
        about = int(part["seed"][e]), bool(part["success"][e])
        if rows == "team":
            ended = np.zeros(count, np.bool_)
            ended[-1] = not part["truncated"][e]
            joint = seen[: count + 1].reshape(count + 1, -1), acts[:count].reshape(count, -1)
            yield _episode(*joint, given[:count].mean(axis=1), ended, *about)
            continue
        for i, lived in enumerate(part["active"][:count, e].sum(axis=0).tolist()):
            own = seen[: lived + 1, i], acts[:lived, i], given[:lived, i]
            yield _episode(*own, part["ended"][:lived, e, i], *about)


def _episode(
    seen: Any, acts: Any, rewards: Any, ended: Any, seed: int, success: bool
) -> EpisodeBuffer:
    """One episode as Minari takes it."""
    from minari.data_collector import EpisodeBuffer

    cut = np.zeros(len(ended), np.bool_)
    cut[-1] = not ended[-1]
    return EpisodeBuffer(
        seed=seed,
        observations=seen,
        actions=acts,
        rewards=rewards.tolist(),
        terminations=ended.tolist(),
        truncations=cut.tolist(),
        infos={"success": np.full(len(ended) + 1, success)},
    )
