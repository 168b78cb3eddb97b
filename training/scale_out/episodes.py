"""Episodes of agents by any workers: each is kept once, and is as if flown here.

Workers fly chunks of seeds and give their episodes back; only the driver keeps any. A chunk that
takes long gives what it has, and the rest is handed out again, so that little is lost by a kill.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import json
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from swarm_envs.agents import Agent
from swarm_envs.agents.evaluation import TIMED, Episode, EpisodeFile, evaluate_agent, source_digest
from swarm_envs.agents.policy import FILE
from swarm_envs.agents.protocol import AT_ONCE
from swarm_envs.agents.registry import FILTER, SHIPPED, load_agent
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.files import written_whole
from swarm_envs.training.scale_out.jobs import Job, WorkerPool
from swarm_envs.training.scoreboard.tasks import make_scored

__all__ = ["AgentEpisodes", "EvaluationSpec", "evaluate_distributed"]

FUNCTION = f"{__name__}:fly_chunk"  # What a job calls, as `module:function`
PATIENCE_S = 5.0  # After so long a chunk begins no further episode
_CHUNKS, _LARGEST = 4, 256
"""Chunks for each worker, so that all end at about the same time; and seeds in one, at most."""
LARGEST_BYTES = 64 * 2**20  # Of a file that is sent: it goes along with every job
SentFile = dict[str, str]
"""A file, ready for JSON: its absolute `path`, the `sha256` of its content, and that in base64."""


@dataclass
class AgentEpisodes:
    """An agent to be evaluated, and what came out so far."""

    name: str
    """as of `swarm_envs.agents.load`"""
    digest: str
    """of its source: what `source_digest` gives"""
    batched: bool = False
    """whether it flies many episodes at once: its chunks are then worth as many"""
    kept: EpisodeFile | None = None
    """where episodes are kept, if anywhere"""
    episodes: dict[int, Episode] = field(default_factory=dict)
    """by seed"""
    failure: str | None = None
    """why it was given up: the failure of the first seed that it failed on"""
    trace: str = ""
    """where it failed, as Python prints it"""
    failed_at: float = float("inf")
    """place of that seed"""

    def __post_init__(self) -> None:
        if self.kept is not None:
            self.episodes |= self.kept.episodes

    def flown(self, seeds: Sequence[int]) -> list[Episode]:
        """Its episodes in the order of the seeds, if it did not fail."""
        return [self.episodes[seed] for seed in seeds]


@dataclass(frozen=True)
class EvaluationSpec:
    """An agent on a task: what is to be flown."""

    record: AgentEpisodes
    """the agent; the results are in it"""
    task: str
    """versioned name"""
    setting: Mapping[str, Any]
    """options of the environment, ready for JSON; agents' own go before them"""
    seeds: Sequence[int]
    """of the episodes, each once"""
    refusals: bool = False
    """whether an episode that the agent refuses counts as one; see `fly_seed`"""

    @property
    def missing(self) -> list[int]:
        """Seeds of which there is no episode yet."""
        return [seed for seed in self.seeds if seed not in self.record.episodes]


def evaluate_distributed(
    specs: Sequence[EvaluationSpec],
    workers: WorkerPool,
    on_episode: Callable[[AgentEpisodes, Episode], None] = lambda record, episode: None,
) -> None:
    """Fly every agent on every seed that it has no episode of yet.

    An agent that fails is given up on for this task; the episodes before its failure are flown
    still, so that it is the first, as it would be if they were flown in order. The others go on.

    Args:
        specs: their agents are changed: what came out is in them. Begun in this order.
        workers: what runs the jobs.
        on_episode: called with each new episode, once it is kept.

    Raises:
        OSError: an agent's file cannot be read, or an episode not be kept.
        ValueError: an agent's file is too large to be sent.
    """
    by_label = {str(k): spec for k, spec in enumerate(specs)}
    places = {k: {seed: i for i, seed in enumerate(spec.seeds)} for k, spec in by_label.items()}
    jobs = deque(job for k, spec in by_label.items() for job in _jobs(spec, k, workers.size))
    for outcome in workers.run(jobs):
        label, chunk = outcome.job.label, outcome.job.arguments["seeds"]
        record, place = by_label[label].record, places[label]
        flown = outcome.result["episodes"] if outcome.error is None else []
        if flown and record.kept is not None:
            record.kept.add(*flown)
        for episode in flown:
            record.episodes[episode["seed"]] = episode
            on_episode(record, episode)
        rest = chunk[len(flown) :]
        if rest and place[rest[0]] < record.failed_at:
            if outcome.error is not None:
                why, trace = outcome.error, outcome.trace
                why = f"in the episodes of seeds {rest[0]} and on: {why}"
            else:
                why, trace = outcome.result["error"], outcome.result["trace"]
            if why is None:  # it was slow
                jobs.appendleft(_of_seeds(outcome.job, rest, by_label[label].seeds))
                continue
            record.failure, record.trace, record.failed_at = why, trace, place[rest[0]]
            for job in [job for job in jobs if job.label == label]:
                if place[job.arguments["seeds"][0]] > record.failed_at:
                    jobs.remove(job)


def _jobs(spec: EvaluationSpec, label: str, workers: int) -> list[Job]:
    files = {
        name: send(Path(value))
        for name, value in spec.setting.items()
        if isinstance(value, str) and value.endswith(".safetensors") and Path(value).is_file()
    }
    missing, record = spec.missing, spec.record
    if not missing:
        return []
    fair = -(-len(missing) // (_CHUNKS * workers))
    size = min(_LARGEST, max(fair, AT_ONCE if record.batched else 1))
    about = {"agent": _sent_agent(record), "task": spec.task, "setting": dict(spec.setting)}
    whole = Job(FUNCTION, {**about, "files": files, "refusals": spec.refusals}, label)
    return [
        _of_seeds(whole, missing[first : first + size], spec.seeds)
        for first in range(0, len(missing), size)
    ]


def _of_seeds(job: Job, seeds: list[int], order: Sequence[int]) -> Job:
    timed = sum(seed in order[:TIMED] for seed in seeds)
    return Job(job.function, {**job.arguments, "seeds": seeds, "timed": timed}, job.label)


def _sent_agent(record: AgentEpisodes) -> dict[str, Any]:
    """An agent as another machine can load it: its file, if it has one, by value."""
    sent: dict[str, Any] = {"name": record.name, "digest": record.digest}
    name = record.name.removesuffix(FILTER)
    if name in SHIPPED:
        return sent
    file, colon, part = name.rpartition(":")
    path = Path(file if colon else part)
    return {**sent, "file": send(path / FILE if path.is_dir() else path), "part": colon + part}


def fly_chunk(
    agent: Mapping[str, Any],
    task: str,
    setting: Mapping[str, Any],
    files: Mapping[str, SentFile],
    seeds: list[int],
    timed: int,
    refusals: bool = False,
) -> dict[str, Any]:
    """A job of `evaluate_distributed`: some seeds of an agent, the first `timed` one at a time.

    Returns:
        `episodes`, of fewer seeds if it took long or the agent failed; `error` and `trace` if it
        failed, else null and nothing.

    Raises:
        ValueError: the agent is not the one that was meant.
    """
    flown: list[Episode] = []
    begun = time.monotonic()
    made, env = _at_hand(json.dumps([agent, task, setting, files]))
    try:
        keep = flown.extend
        for _ in evaluate_agent(env, made, seeds, None, lambda *new: keep(new), timed, refusals):
            if time.monotonic() - begun > PATIENCE_S:
                break
    except Exception as error:
        _close()
        trace = "".join(traceback.format_exception(error.__cause__ or error))
        return {"episodes": flown, "error": str(error), "trace": trace}
    return {"episodes": flown, "error": None, "trace": ""}


_prepared: dict[str, tuple[Agent, SwarmParallelEnv]] = {}
"""The agent and the environment of the last chunk: the next is most often of the same."""


def _at_hand(key: str) -> tuple[Agent, SwarmParallelEnv]:
    if key not in _prepared:
        _close()
        agent, task, setting, files = json.loads(key)
        received = {name: str(receive(file)) for name, file in files.items()}
        made = _load(agent)
        _prepared[key] = made, make_scored(task, {**setting, **received, **made.requires})
    return _prepared[key]


def _close() -> None:
    while _prepared:
        _, (_, env) = _prepared.popitem()
        env.close()


def _load(agent: Mapping[str, Any]) -> Agent:
    name = agent["name"]
    if "file" in agent:
        part, behind = agent["part"], FILTER if name.endswith(FILTER) else ""
        name = str(receive(agent["file"])) + (part if ":" in part else "") + behind
    made = load_agent(name)
    if source_digest(made) != agent["digest"]:
        raise ValueError(
            f"agent {agent['name']!r} is another here than where the command was given: install "
            "the same packages everywhere"
        )
    return made


def send(path: Path) -> SentFile:
    """Read a file to be sent.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large.
    """
    content = path.read_bytes()
    if len(content) > LARGEST_BYTES:
        raise ValueError(
            f"{str(path)!r} has {len(content)} bytes, but at most {LARGEST_BYTES} are sent to "
            "other machines"
        )
    return {
        "path": str(path.absolute()),
        "sha256": hashlib.sha256(content).hexdigest(),
        "content": base64.b64encode(content).decode(),
    }


def receive(sent: SentFile) -> Path:
    """Where the file is on this machine: where it was, or a copy that this process keeps.

    Raises:
        OSError: the copy cannot be written.
    """
    path, digest = Path(sent["path"]), sent["sha256"]
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest:
        return path
    copy = Path(_folder().name) / digest / path.name
    if not copy.is_file():
        with written_whole(copy) as partial:
            partial.write_bytes(base64.b64decode(sent["content"]))
    return copy


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="swarm-envs-")
