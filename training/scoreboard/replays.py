"""For each cell of a scoreboard one episode to look at: chosen by a rule, flown again, recorded."""

from __future__ import annotations

import hashlib
import re
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs.agents import load, record_episode
from swarm_envs.training.scale_out.jobs import Job
from swarm_envs.training.scale_out.options import ScaleOptions
from swarm_envs.training.scoreboard.board import Board, read
from swarm_envs.training.scoreboard.tasks import make_scored
from swarm_envs.viewing.replay import write_replay

__all__ = ["record_replays"]

FOLDER = "replays"  # Of the pages, in a scoreboard's folder
FUNCTION = f"{__name__}:record_one"  # What a job calls, as `module:function`
MOST_SAMPLES = 6_000  # Drones times frames in a page: 16 drones for 8 s are shown 47 times a second


def choose_episode(
    task: str, agent: str, episodes: Sequence[Mapping[str, Any]]
) -> dict[str, Any] | None:
    """What `scores.json` says of the episode of a cell that teaches most; None if none was flown.

    If some succeed and some fail, the first that failed, with a collision if any did; if all
    succeed, the one in which two drones came nearest; if all fail, the first. Episodes are rows in
    the order of the seeds; `refused` ones, which were not flown, are passed over.
    """
    flown = [(k, each) for k, each in enumerate(episodes) if not each.get("refused")]
    if not flown:
        return None
    index, why = _chosen(flown)
    chosen = episodes[index]
    return {
        "seed": int(chosen["seed"]),
        "episode": index,
        "success": bool(chosen["success"]),
        "file": file_of(task, agent),
        "why": why,
    }


def _chosen(flown: Sequence[tuple[int, Mapping[str, Any]]]) -> tuple[int, str]:
    failed = [(k, each) for k, each in flown if not each["success"]]
    if len(failed) == len(flown):
        return flown[0][0], "the first; all fail"
    if failed:
        crashed = [k for k, each in failed if each["collided"]]
        how = "the first failure with a collision" if crashed else "the first failure"
        return (crashed or [failed[0][0]])[0], f"{how}, of {len(failed)} failures"
    apart = [(each["minimum_separation_m"], k) for k, each in flown]
    known = [(distance, k) for distance, k in apart if distance is not None]
    if not known:
        return flown[0][0], "the first; all succeed"
    return min(known)[1], "where two drones come nearest; all succeed"


def file_of(task: str, agent: str) -> str:
    """A cell's page, from the scoreboard's folder: readable, and no two agents share one."""
    short = re.sub(r"[^A-Za-z0-9._+-]+", "-", agent).strip("-.")[-60:]
    if short != agent:
        short += "-" + hashlib.sha256(agent.encode()).hexdigest()[:8]
    return f"{FOLDER}/{task}--{short}.html"


def record_replays(folder: Path, workers: int = 1) -> list[str]:
    """Record every replay that a scoreboard's folder names and lacks, with a progress bar.

    Interrupted and run again, it continues with those that are not there. A page of another episode
    than the one that is named now is rewritten.

    Args:
        folder: holds `scores.json`.
        workers: processes that share the work.

    Returns:
        What went wrong, a line each; the other replays are there.

    Raises:
        FileNotFoundError: there is no `scores.json`.
        OSError: a page cannot be written.
        ValueError: `scores.json` is damaged, or there is to be less than one worker.
    """
    scale, board = ScaleOptions(workers=workers), read(folder)
    jobs = deque(_jobs(folder, board))
    if not jobs:
        return []
    problems = []
    with scale.open() as pool, tqdm(total=len(jobs), desc="replays", unit="page") as bar:
        for outcome in pool.run(jobs):
            problem = outcome.result if outcome.error is None else outcome.error
            if problem is not None:
                problems.append(f"{outcome.job.label}: {problem}")
            bar.update()
    return sorted(problems)


def _jobs(folder: Path, board: Board) -> list[Job]:
    """Those that cost most first: at the end all workers are busy."""
    tasks = {task.id: task for task in board.tasks}
    found: list[tuple[float, Job]] = []
    for cell in board.cells:
        replay = cell["replay"]
        if replay is None or _is_there(folder / replay["file"], replay["seed"]):
            continue
        arguments = {
            "file": str(folder / replay["file"]),
            "environment": tasks[cell["task"]].environment,
            "options": dict(tasks[cell["task"]].options),
            "agent": cell["agent"],
            "seed": replay["seed"],
            "success": replay["success"],
        }
        cost = cell["values"].get("act_us_p99", {}).get("value") or 0.0
        found.append((cost, Job(FUNCTION, arguments, f"{cell['agent']} on {cell['task']}")))
    return [job for _, job in sorted(found, key=lambda pair: -pair[0])]


def _is_there(page: Path, seed: int) -> bool:
    return page.is_file() and f", seed {seed};" in page.read_text(encoding="utf-8")


def record_one(
    file: str,
    environment: str,
    options: Mapping[str, Any],
    agent: str,
    seed: int,
    success: bool | None,
) -> str | None:
    """Fly an episode of an agent again, and write its page: a job of `record_replays`.

    Returns:
        A warning, if it now ends in another way than when it was scored, where that is known.
    """
    loaded = load(agent)
    env = make_scored(environment, {**options, **loaded.requires})
    try:
        recording = record_episode(env, loaded, seed, name=agent)
    finally:
        env.close()
    write_replay(Path(file), recording, most_samples=MOST_SAMPLES)
    if success is None or bool(recording.about.metrics["success"]) == success:
        return None
    ended = "fails" if success else "succeeds"
    return f"the episode of seed {seed} {ended} now, unlike when it was scored"
