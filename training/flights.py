"""Episodes of agents, flown by any workers, for the commands `evaluate` and `benchmark`.

Workers fly chunks of seeds and return the episodes; only the calling process keeps them. Except for
the times of decisions, the results do not depend on the workers.
"""

from __future__ import annotations

import functools
import json
import traceback
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents import Agent
from swarm_envs.agents.evaluation import (
    AgentFailed,
    Episode,
    EpisodeFile,
    evaluate_agent,
    source_digest,
)
from swarm_envs.agents.protocol import AT_ONCE
from swarm_envs.agents.registry import load_agent
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training.scale_out import ScaleOptions, WorkerDied, run_jobs
from swarm_envs.training.scoreboard.tasks import make_scored

__all__ = ["Flight", "Flown", "fly_chunk", "fly_flights"]

_BAR = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"


@dataclass(frozen=True, kw_only=True)
class Flight:
    """An agent on a task with the seeds to be flown: all that any machine needs to fly them."""

    agent: str
    """Name, as of `swarm_envs.agents.load`."""
    digest: str
    """Of its source, by `source_digest`."""
    task: str
    """Versioned name of the environment."""
    setting: Mapping[str, Any]
    """Options of the environment, ready for JSON; those that the agent requires are added."""
    seeds: Sequence[int]
    """Of the episodes."""
    timed: int = 0
    """So many of the first seeds are flown one at a time, so that decisions are timed."""
    batched: bool = False
    """True if the agent flies many episodes at once."""
    refusals: bool = False
    """True if an episode that the agent refuses counts as one; see `fly_seed`."""
    cost: float = 1.0
    """Of an episode, relative to those of other flights: expensive flights are flown first."""
    version: str = __version__

    def without(self, flown: Mapping[int, Episode]) -> Flight:
        """Return the flight of the seeds that were not flown."""
        missing = [seed for seed in self.seeds if seed not in flown]
        timed = sum(seed not in flown for seed in self.seeds[: self.timed])
        return replace(self, seeds=missing, timed=timed)

    def chunks(self) -> Iterator[tuple[int, Flight]]:
        """Yield parts of the flight, each after the position of its first seed."""
        size = AT_ONCE if self.batched else 1
        for k in range(0, len(self.seeds), size):
            yield k, replace(self, seeds=self.seeds[k : k + size], timed=max(0, self.timed - k))


class Flown(NamedTuple):
    """Episodes in the order of the seeds; fewer than those if the agent failed, and then why."""

    episodes: list[Episode]
    error: str = ""
    trace: str = ""  # Where the agent failed, as Python prints it


def fly_flights(
    kept: Sequence[tuple[Flight, EpisodeFile | None]], scale: ScaleOptions
) -> list[Flown]:
    """Fly what is missing of flights, with a progress bar.

    A flight in which the agent fails is given up, and the others go on. The failure is that of the
    first failing seed, as if the seeds had been flown in order.

    Args:
        kept: flights, each with the file of its episodes, which has those that were flown before;
            None if they are not kept.
        scale: the workers.

    Returns:
        Of each flight every episode; or, if the agent failed, those before and why.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is asked for, and Ray is not installed.
        OSError: an episode cannot be written.
    """
    found = [{} if file is None else dict(file.episodes) for _, file in kept]
    missing = [flight.without(flown) for (flight, _), flown in zip(kept, found, strict=True)]
    work = sum(len(flight.seeds) * flight.cost for flight in missing)
    failed: dict[int, tuple[int, Flown]] = {}
    with tqdm(total=work, bar_format=_BAR, mininterval=0.5, disable=not work) as bar:
        for k, first, result in _fly_chunks(missing, failed, scale):
            flight, file = kept[k]
            if file is not None and result.episodes:
                file.add(*result.episodes)
            found[k] |= {episode["seed"]: episode for episode in result.episodes}
            if result.error and (k not in failed or first < failed[k][0]):
                failed[k] = first, result
            good = sum(each["metrics"].get("success", False) for each in found[k].values())
            bar.set_description_str(f"{flight.task} {flight.agent[-30:]}", refresh=False)
            bar.set_postfix_str(f"{good} successes in {len(found[k])} episodes", refresh=False)
            bar.update(len(result.episodes) * flight.cost)
    whole = [
        Flown([flown[seed] for seed in flight.seeds if seed in flown])
        for (flight, _), flown in zip(kept, found, strict=True)
    ]
    for k, (_, result) in failed.items():
        whole[k] = result._replace(episodes=whole[k].episodes)
    return whole


def _fly_chunks(
    flights: Sequence[Flight], failed: Container[int], scale: ScaleOptions
) -> Iterator[tuple[int, int, Flown]]:
    """Yield the index of a flight, the position of a seed, and what was flown from there on.

    What is left of flights that are in `failed` by then is not flown.
    """
    order = sorted(range(len(flights)), key=lambda k: -flights[k].cost)
    jobs = (
        ((k, first), chunk)
        for k in order
        for first, chunk in flights[k].chunks()
        if k not in failed  # what has not begun is of later seeds than the one that failed
    )
    with closing(run_jobs(fly_chunk, jobs, scale)) as results:
        for (k, first), result in results:
            if isinstance(result, WorkerDied):
                where = f"in the episodes of seeds {flights[k].seeds[first]} and on"
                result = Flown([], f"{where}: WorkerDied: {result}")
            yield k, first, result


def fly_chunk(chunk: Flight) -> Flown:
    """Fly the seeds of a chunk in this process, in order."""
    episodes: list[Episode] = []
    try:
        if chunk.version != __version__:
            raise ValueError(
                f"a worker has swarm-envs {__version__}, but was asked by {chunk.version}; install "
                "the same version everywhere"
            )
        setting = json.dumps(dict(chunk.setting))
        agent, env = _prepare(chunk.agent, chunk.digest, chunk.task, setting)
        episodes.extend(
            evaluate_agent(env, agent, chunk.seeds, timed=chunk.timed, refusals=chunk.refusals)
        )
    except (Exception, SystemExit) as error:
        _prepare.cache_clear()
        said = str(error) if isinstance(error, AgentFailed) else f"{type(error).__name__}: {error}"
        said = " ".join(said.split())  # a line of a table
        trace = "".join(traceback.format_exception(error.__cause__ or error))
        return Flown(episodes, said, trace)
    return Flown(episodes)


@functools.lru_cache(maxsize=1)  # the next chunk is most often of the same flight
def _prepare(name: str, digest: str, task: str, setting: str) -> tuple[Agent, SwarmParallelEnv]:
    """Load an agent, and make its environment from options in JSON."""
    agent = load_agent(name)
    if source_digest(agent, name) != digest:
        raise ValueError(
            f"agent {name!r} is another here than where the command was given: all machines need "
            "the same packages, and the same files at the same paths"
        )
    return agent, make_scored(task, {**json.loads(setting), **agent.requires})
