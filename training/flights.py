"""Evaluation of agents by parallel workers, for the commands `evaluate` and `benchmark`.

Workers simulate chunks of seeds and return the episodes; only the calling process stores them.
Except for the times of decisions, the results do not depend on the workers.
"""

from __future__ import annotations

import functools
import json
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
from swarm_envs.user_files import users_traceback

__all__ = ["Flight", "Flown", "fly_chunk", "fly_flights"]

_BAR = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"


@dataclass(frozen=True, kw_only=True)
class Flight:
    """The episodes of an agent on a task, with everything that a worker needs to simulate them."""

    agent: str
    """The agent's name for `swarm_envs.agents.load`."""
    digest: str
    """The digest of its source, from `source_digest`."""
    task: str
    """The versioned name of the environment."""
    setting: Mapping[str, Any]
    """The options of the environment, ready for JSON; those that the agent requires are added."""
    seeds: Sequence[int]
    """The seeds of the episodes."""
    timed: int = 0
    """The number of first seeds that are simulated one at a time, to time decisions."""
    batched: bool = False
    """True if many episodes can be simulated together."""
    refusals: bool = False
    """True if an episode that the agent refuses counts as one; see `fly_seed`."""
    version: str = __version__

    def without(self, flown: Mapping[int, Episode]) -> Flight:
        """Return the flight with the seeds that are not in `flown`."""
        missing = [seed for seed in self.seeds if seed not in flown]
        timed = sum(seed not in flown for seed in self.seeds[: self.timed])
        return replace(self, seeds=missing, timed=timed)

    def chunks(self) -> Iterator[tuple[int, Flight]]:
        """Yield parts of the flight, each after the position of its first seed."""
        size = AT_ONCE if self.batched else 1
        for k in range(0, len(self.seeds), size):
            yield k, replace(self, seeds=self.seeds[k : k + size], timed=max(0, self.timed - k))


class Flown(NamedTuple):
    """Episodes in the order of the seeds; fewer than the seeds if the agent failed."""

    episodes: list[Episode]
    error: str = ""  # The reason of a failure; empty for none
    trace: str = ""  # The traceback of a failure in a user's file


def fly_flights(
    kept: Sequence[tuple[Flight, EpisodeFile | None]], scale: ScaleOptions
) -> list[Flown]:
    """Simulate the missing episodes of flights, with a progress bar.

    If an agent fails, its flight ends and the others continue. The reported failure is that of the
    first failing seed, as if the seeds had been simulated in order.

    Args:
        kept: flights, each with the file that stores its episodes, or None.
        scale: the workers.

    Returns:
        All episodes of each flight, or, if the agent failed, those that succeeded and the reason.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is requested, and Ray is not installed.
        OSError: an episode cannot be written.
    """
    found = [{} if file is None else dict(file.episodes) for _, file in kept]
    missing = [flight.without(flown) for (flight, _), flown in zip(kept, found, strict=True)]
    work = sum(len(flight.seeds) for flight in missing)
    failed: dict[int, tuple[int, Flown]] = {}
    label = next((_label(flight) for flight in missing if flight.seeds), "")
    given: dict[str, Any] = {"bar_format": _BAR, "mininterval": 0.5, "disable": not work}
    with tqdm(total=work, desc=label, **given) as bar:
        for k, first, result in _fly_chunks(missing, failed, scale):
            flight, file = kept[k]
            if file is not None and result.episodes:
                file.add(*result.episodes)
            found[k] |= {episode["seed"]: episode for episode in result.episodes}
            if result.error and (k not in failed or first < failed[k][0]):
                failed[k] = first, result
            good = sum(each["metrics"].get("success", False) for each in found[k].values())
            bar.set_description_str(_label(flight), refresh=False)
            bar.set_postfix_str(f"{good} successes in {len(found[k])} episodes", refresh=False)
            bar.update(len(result.episodes))
    whole = [
        Flown([flown[seed] for seed in flight.seeds if seed in flown])
        for (flight, _), flown in zip(kept, found, strict=True)
    ]
    for k, (_, result) in failed.items():
        whole[k] = result._replace(episodes=whole[k].episodes)
    return whole


def _label(flight: Flight) -> str:
    """Return the description of a flight for the progress bar."""
    return f"{flight.task} {flight.agent[-30:]}"


def _fly_chunks(
    flights: Sequence[Flight], failed: Container[int], scale: ScaleOptions
) -> Iterator[tuple[int, int, Flown]]:
    """Yield the index of a flight, the position of a seed, and the chunk that begins there.

    The remaining chunks of flights in `failed` are skipped.
    """
    jobs = (
        ((k, first), chunk)
        for k, flight in enumerate(flights)
        for first, chunk in flight.chunks()
        if k not in failed  # chunks are in order, so the remaining seeds follow the failed one
    )
    with closing(run_jobs(fly_chunk, jobs, scale)) as results:
        for (k, first), result in results:
            if isinstance(result, WorkerDied):
                where = f"in the episodes of seeds {flights[k].seeds[first]} and on"
                result = Flown([], f"{where}: WorkerDied: {result}")
            yield k, first, result


def fly_chunk(chunk: Flight) -> Flown:
    """Simulate the seeds of a chunk in this process, in order."""
    episodes: list[Episode] = []
    try:
        if chunk.version != __version__:
            raise ValueError(
                f"a worker has swarm-envs {__version__}, but the driver has {chunk.version}; "
                "install the same version everywhere"
            )
        setting = json.dumps(dict(chunk.setting))
        agent, env = _prepare(chunk.agent, chunk.digest, chunk.task, setting)
        episodes.extend(
            evaluate_agent(env, agent, chunk.seeds, timed=chunk.timed, refusals=chunk.refusals)
        )
    except (Exception, SystemExit) as error:
        _prepare.cache_clear()
        why = str(error) if isinstance(error, AgentFailed) else f"{type(error).__name__}: {error}"
        return Flown(episodes, " ".join(why.split()), users_traceback(error))
    return Flown(episodes)


@functools.lru_cache(maxsize=1)  # the next chunk is usually of the same flight
def _prepare(name: str, digest: str, task: str, setting: str) -> tuple[Agent, SwarmParallelEnv]:
    """Load an agent, and make its environment from options in JSON."""
    agent = load_agent(name)
    if source_digest(agent, name) != digest:
        raise ValueError(
            f"the source of agent {name!r} differs between worker and driver; all machines need "
            "the same packages, and the same files at the same paths"
        )
    return agent, make_scored(task, {**json.loads(setting), **agent.requires})
