"""Many episodes of an agent, on seeds that are fixed beforehand: each is kept once it is flown."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents.batch import AT_ONCE, BatchAgent, disagreement, flies_batches, fly_batch
from swarm_envs.agents.protocol import (
    Actions,
    Agent,
    Observations,
    check_requirements,
    fly_episode,
)
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer

Episode = dict[str, Any]
"""One episode: its `seed`, its `metrics` and `act_us`, the time of every decision, microseconds;
without entries where many episodes were flown at once."""

TIMED = 16
"""Episodes of each agent that are flown one by one in any case, so that its decisions are timed."""


class AgentFailed(RuntimeError):
    """An agent raised, or gave actions that no environment takes. The message says where."""


class AgentRefused(AgentFailed):
    """An agent does not fly such an episode: its `reset` raised a ValueError, the cause."""


def frozen_seeds(seed: int, count: int) -> list[int]:
    """Seeds of `count` episodes, the same for every agent; fewer are the first of more.

    Raises:
        ValueError: the seed is negative, or the count below one.
    """
    check_integer("seed", seed, 0)
    check_integer("episodes", count, 1)
    return [int(word) for word in np.random.SeedSequence(seed).generate_state(count)]


class _Timed:
    """An agent whose decisions are timed."""

    def __init__(self, agent: Agent) -> None:
        self.requires, self.privileged = agent.requires, agent.privileged
        self.spent_us: list[int] = []
        self.begun = 0
        self.refused = False
        self._agent = agent

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """As the agent does; not timed: it may plan as long as it likes."""
        self.spent_us, self.begun = [], 0
        try:
            self._agent.reset(env, seed)
        except ValueError:
            self.refused = True
            raise

    def act(self, observations: Observations, view: View | None) -> Actions:
        """As the agent does."""
        self.begun += 1
        begun = time.perf_counter_ns()
        actions = self._agent.act(observations, view)
        self.spent_us.append((time.perf_counter_ns() - begun) // 1000)
        return actions


def fly_seed(env: SwarmParallelEnv, agent: Agent, seed: int) -> Episode:
    """Fly one episode and say how it went.

    Raises:
        AgentFailed: the agent did; the cause is chained. `AgentRefused`, if its `reset` refused.
    """
    timed = _Timed(agent)
    try:
        metrics = fly_episode(env, timed, seed)
    except (Exception, SystemExit) as error:
        kind = AgentRefused if timed.refused else AgentFailed
        raise kind(
            f"in the episode of seed {seed}, decision {timed.begun}: "
            f"{type(error).__name__}: {error}"
        ) from error
    return {"seed": seed, "metrics": metrics, "act_us": timed.spent_us}


def fly_or_refuse(env: SwarmParallelEnv, agent: Agent, seed: int) -> Episode:
    """As `fly_seed`, but what an agent refuses is an episode too: its metrics are `refused`, why.

    Raises:
        AgentFailed: the agent did otherwise.
    """
    try:
        return fly_seed(env, agent, seed)
    except AgentRefused as refusal:
        return {"seed": seed, "metrics": {"refused": str(refusal.__cause__)}, "act_us": []}


def evaluate(
    env: SwarmParallelEnv,
    agent: Agent,
    seeds: Sequence[int],
    kept: Mapping[int, Episode] | None = None,
    keep: Callable[..., None] | None = None,
    timed: int = TIMED,
    refusals: bool = False,
) -> Iterator[Episode]:
    """Give the episodes of the seeds in their order; those that are kept are not flown again.

    An agent that acts on arrays (`swarm_envs.agents.batch.BatchAgent`) flies `AT_ONCE` episodes at
    once after the first `timed`, with the same metrics; of these no decision is timed, and
    `act_us` is empty.

    Args:
        env: has what the agent requires.
        agent: who acts.
        seeds: of the episodes.
        kept: episodes flown before, by seed.
        keep: called with new episodes, one or more, before they are given.
        timed: of the seeds, how many are flown one by one in any case.
        refusals: whether an episode that the agent refuses is given too, as of `fly_or_refuse`.

    Raises:
        AgentFailed: the agent did.
    """
    found = kept or {}
    fly = fly_or_refuse if refusals else fly_seed
    batched = flies_batches(env, agent)
    single = seeds[:timed] if batched else seeds
    for seed in single:
        episode = found.get(seed)
        if episode is None:
            episode = fly(env, agent, seed)
            if keep is not None:
                keep(episode)
        yield episode
    if batched:
        yield from _evaluate_batched(env, agent, seeds[len(single) :], found, keep, refusals)


def _evaluate_batched(
    env: SwarmParallelEnv,
    agent: Agent,
    seeds: Sequence[int],
    kept: Mapping[int, Episode],
    keep: Callable[..., None] | None,
    refusals: bool,
) -> Iterator[Episode]:
    """As `evaluate`, many at once."""
    core: SwarmCore | None = None
    for first in range(0, len(seeds), AT_ONCE):
        chunk = seeds[first : first + AT_ONCE]
        missing = [seed for seed in chunk if seed not in kept]
        new: list[Episode] = []
        if missing:
            try:
                core = core or _prepared(env, agent, missing[0], min(AT_ONCE, len(seeds)))
                new = _fly_seeds(core, env, agent, missing)
            except AgentRefused:
                if not refusals:
                    raise
                new = [fly_or_refuse(env, agent, seed) for seed in missing]
            if keep is not None:
                keep(*new)
        given = {**kept, **{episode["seed"]: episode for episode in new}}
        yield from (given[seed] for seed in chunk)


def _prepared(env: SwarmParallelEnv, agent: Agent, seed: int, count: int) -> SwarmCore:
    """So many environments like one, for which the agent is prepared."""
    check_requirements(env, agent)
    try:
        observations, _ = env.reset(seed=seed)
        agent.reset(env, seed)
    except (Exception, SystemExit) as error:
        kind = AgentRefused if isinstance(error, ValueError) else AgentFailed
        raise kind(f"before its first decision: {type(error).__name__}: {error}") from error
    differ = disagreement(agent, observations) if isinstance(agent, BatchAgent) else None
    if differ is not None:
        raise AgentFailed(differ)
    return SwarmCore(env.core.task, env.core.config, count)


def _fly_seeds(
    core: SwarmCore, env: SwarmParallelEnv, agent: Agent, seeds: Sequence[int]
) -> list[Episode]:
    """Episodes flown at once; if the agent fails, one by one, to say in which."""
    assert isinstance(agent, BatchAgent)
    try:
        flown = fly_batch(core, agent.act_batch, seeds)
    except (Exception, SystemExit) as error:
        for seed in seeds:
            fly_seed(env, agent, seed)
        raise AgentFailed(
            f"act_batch fails in the episodes of seeds {seeds[0]} to {seeds[-1]}, though act does "
            f"not: {type(error).__name__}: {error}"
        ) from error
    return [
        {"seed": seed, "metrics": metrics, "act_us": []}
        for seed, metrics in zip(seeds, flown, strict=True)
    ]


class EpisodeFile:
    """Episodes of one agent in one setting, a line of JSON each, synced to disk one by one.

    A line that was being written when the process or the machine died is not counted: that episode
    is flown again. What the episodes depend on is in the file's name and its first line, so that
    other settings begin another file, and nothing is overwritten.

    Args:
        folder: where the file is, or will be.
        name: of the agent.
        setting: everything that an episode depends on beside its seed, ready for JSON.

    Raises:
        ValueError: the file holds what no run of this class wrote.
    """

    def __init__(self, folder: Path, name: str, setting: Mapping[str, Any]) -> None:
        self._head = json.dumps({"setting": dict(setting)}, sort_keys=True)
        digest = hashlib.sha256(self._head.encode()).hexdigest()[:12]
        short = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")[-40:]
        self.path = folder / f"{short}-{digest}.jsonl"
        self.episodes: dict[int, Episode] = {}
        if self.path.is_file():
            self._read()

    def _read(self) -> None:
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        try:
            head, *lines = whole.decode().splitlines() or [self._head]
            if head != self._head:
                raise ValueError("its first line is of another setting")
            for line in lines:
                episode = json.loads(line)
                self.episodes[episode["seed"]] = {k: episode[k] for k in _FIELDS}
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{str(self.path)!r} is damaged ({error}); delete it") from error
        if len(whole) < len(content):
            os.truncate(self.path, len(whole))

    def add(self, *episodes: Episode) -> None:
        """Keep episodes: they are on disk when this returns.

        Raises:
            OSError: the file cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write(self._head + "\n")
            for episode in episodes:
                file.write(json.dumps(episode, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.episodes.update({episode["seed"]: episode for episode in episodes})


_FIELDS = ("seed", "metrics", "act_us")


def source_digest(agent: Agent) -> str:
    """SHA-256 of the file that defines an agent: an edited controller is another one.

    An agent with a `digest` of its own, such as that of its weights, has it in here too.
    """
    file = inspect.getsourcefile(type(agent))
    digest = hashlib.sha256(Path(file).read_bytes() if file else b"")
    digest.update(str(getattr(agent, "digest", "")).encode())
    return digest.hexdigest()
