"""Evaluation of an agent on many episodes with fixed seeds.

Each episode is stored when it is complete. Scores are rates and means with confidence intervals.
"""

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

from swarm_envs.agents.protocol import (
    AT_ONCE,
    Actions,
    Agent,
    BatchAgent,
    Observations,
    check_requirements,
    disagreement,
    flies_batches,
    fly_batch,
    fly_episode,
)
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer
from swarm_envs.state import FloatArray
from swarm_envs.user_files import file_digest

__all__ = [
    "COLLISIONS",
    "CONFIDENCE",
    "RESAMPLES",
    "TIMED",
    "AgentRefused",
    "Episode",
    "EpisodeFile",
    "bootstrap_interval",
    "collided",
    "evaluate_agent",
    "frozen_seeds",
    "interquartile_mean",
    "rate_interval",
    "score_episodes",
    "source_digest",
]

Episode = dict[str, Any]
"""One episode: its `seed`, its `metrics` and `act_us`, the time of every decision, microseconds;
`act_us` is empty if many episodes were simulated together."""

TIMED = 16
"""Number of episodes of each agent that are simulated one at a time, to time its decisions."""


class AgentFailed(RuntimeError):
    """An agent raised an exception or returned invalid actions; the message gives the episode."""


class AgentRefused(AgentFailed):
    """An agent does not support an episode: its `reset` raised a ValueError, the cause."""


def frozen_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds of `count` episodes; a smaller count gives the first of these seeds.

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
        # The time of planning before the episode is not measured.
        self.spent_us, self.begun = [], 0
        try:
            self._agent.reset(env, seed)
        except ValueError:
            self.refused = True
            raise

    def act(self, observations: Observations, view: View | None) -> Actions:
        self.begun += 1
        begun = time.perf_counter_ns()
        actions = self._agent.act(observations, view)
        self.spent_us.append((time.perf_counter_ns() - begun) // 1000)
        return actions


def fly_seed(env: SwarmParallelEnv, agent: Agent, seed: int, refusals: bool = False) -> Episode:
    """Simulate one episode and return it.

    Args:
        env: an environment with the options that the agent requires.
        agent: the agent.
        seed: the seed of the episode.
        refusals: return an episode that the agent's `reset` refuses too; its only metric is
            `refused`, the reason.

    Raises:
        AgentFailed: the agent failed; the cause is chained.
        AgentRefused: the agent's `reset` refused the episode.
    """
    timed = _Timed(agent)
    try:
        metrics = fly_episode(env, timed, seed)
    except (Exception, SystemExit) as error:
        if timed.refused and refusals:
            return _refused(seed, error)
        kind = AgentRefused if timed.refused else AgentFailed
        raise kind(
            f"in the episode of seed {seed}, decision {timed.begun}: "
            f"{type(error).__name__}: {error}"
        ) from error
    return {"seed": seed, "metrics": metrics, "act_us": timed.spent_us}


def evaluate_agent(
    env: SwarmParallelEnv,
    agent: Agent,
    seeds: Sequence[int],
    timed: int = TIMED,
    refusals: bool = False,
) -> Iterator[Episode]:
    """Yield the episodes of the seeds in order.

    With a `BatchAgent`, `AT_ONCE` episodes are simulated together after the first `timed`, with the
    same metrics; their decisions are not timed, and `act_us` is empty.

    Args:
        env: an environment with the options that the agent requires.
        agent: the agent.
        seeds: the seeds of the episodes.
        timed: the number of episodes that are simulated one at a time in any case.
        refusals: yield episodes that the agent refuses too; see `fly_seed`.

    Raises:
        AgentFailed: the agent failed.
    """
    batched = flies_batches(env, agent)
    single = seeds[:timed] if batched else seeds
    for seed in single:
        yield fly_seed(env, agent, seed, refusals)
    if batched:
        yield from _evaluate_batched(env, agent, seeds[len(single) :], refusals)


def _evaluate_batched(
    env: SwarmParallelEnv, agent: Agent, seeds: Sequence[int], refusals: bool
) -> Iterator[Episode]:
    """Yield episodes as `evaluate_agent` does, many simulated together."""
    check_requirements(env, agent)
    core: SwarmCore | None = None
    for first in range(0, len(seeds), AT_ONCE):
        chunk = seeds[first : first + AT_ONCE]
        episodes: dict[int, Episode] = {}
        for seed in chunk:
            try:
                _begin(env, agent, seed)
            except AgentRefused as error:
                if not refusals:
                    raise
                episodes[seed] = _refused(seed, error.__cause__)
        flown = [seed for seed in chunk if seed not in episodes]
        if flown:
            core = core or _prepared(env, agent, flown[0], min(AT_ONCE, len(seeds)))
            episodes |= {each["seed"]: each for each in _fly_seeds(core, env, agent, flown)}
        yield from (episodes[seed] for seed in chunk)


def _begin(env: SwarmParallelEnv, agent: Agent, seed: int) -> Observations:
    """Reset the environment and the agent, which may refuse the episode."""
    observations, _ = env.reset(seed=seed)
    try:
        agent.reset(env, seed)
    except (Exception, SystemExit) as error:
        kind = AgentRefused if isinstance(error, ValueError) else AgentFailed
        raise kind(
            f"in the episode of seed {seed}, before its first decision: "
            f"{type(error).__name__}: {error}"
        ) from error
    return observations


def _refused(seed: int, error: BaseException | None) -> Episode:
    return {"seed": seed, "metrics": {"refused": str(error)}, "act_us": []}


def _prepared(env: SwarmParallelEnv, agent: Agent, seed: int, count: int) -> SwarmCore:
    """Return `count` environments like one, for which the agent has been reset."""
    observations = _begin(env, agent, seed)
    differ = disagreement(agent, observations) if isinstance(agent, BatchAgent) else None
    if differ is not None:
        raise AgentFailed(differ)
    return SwarmCore(env.core.task, env.core.config, count)


def _fly_seeds(
    core: SwarmCore, env: SwarmParallelEnv, agent: Agent, seeds: Sequence[int]
) -> list[Episode]:
    """Simulate episodes together; if the agent fails, one at a time to find the episode."""
    assert isinstance(agent, BatchAgent)
    try:
        flown = fly_batch(core, agent.act_batch, seeds)
    except (Exception, SystemExit) as error:
        for seed in seeds:
            fly_seed(env, agent, seed)
        raise AgentFailed(
            f"act_batch fails in the episodes of seeds {seeds[0]} to {seeds[-1]}, but act does "
            f"not: {type(error).__name__}: {error}"
        ) from error
    return [
        {"seed": seed, "metrics": metrics, "act_us": []}
        for seed, metrics in zip(seeds, flown, strict=True)
    ]


class EpisodeFile:
    """File with the episodes of one agent in one setting, one line of JSON each.

    An incomplete last line, from a killed process, is discarded. A digest of the setting is in the
    file's name and the setting in its first line, so that each setting has its own file.

    Args:
        folder: the folder of the file.
        name: the name of the agent.
        setting: everything that an episode depends on besides its seed, ready for JSON.

    Raises:
        ValueError: the file exists and has other content.
    """

    def __init__(self, folder: Path, name: str, setting: Mapping[str, Any]) -> None:
        self._head = json.dumps({"format": 2, "setting": dict(setting)}, sort_keys=True)
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
        """Append episodes; they are on disk when this returns.

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


def source_digest(agent: Agent, name: str = "") -> str:
    """Return the SHA-256 of the source of an agent.

    It covers the file of its class, its attribute `digest`, such as that of its weights, and for an
    agent from a file, `path/to/file.py:Class`, the files of its folder that it imports.

    Args:
        agent: the agent.
        name: its name for `swarm_envs.agents.load`; required only for agents from files.
    """
    file = inspect.getsourcefile(type(agent))
    digest = hashlib.sha256(Path(file).read_bytes() if file else b"")
    digest.update(str(getattr(agent, "digest", "")).encode())
    digest.update(file_digest(name).encode())
    return digest.hexdigest()


CONFIDENCE = 0.95
"""Confidence level of all intervals."""
RESAMPLES = 2000
"""Number of bootstrap resamples."""

COLLISIONS = {
    "drone": "collided_drones",
    "floor": "collided_floor",
    "wall": "collided_wall",
    "obstacle": "collided_obstacle",
    "tumbling": "tumbled",
}
"""Kinds of crash, and the metric that counts the drones that crashed in this way."""

OF_SUCCESSES = ("time_to_goal_s", "energy_j")
_OF_ALL = (
    "minimum_separation_m",
    "worst_tracking_error_m",
    "rms_tracking_error_m",
    "worst_height_error_m",
    "worst_force_g",
    "length_s",
    "mean_return",
)
_SCORES = ("throughput_per_min", "share_on_goal", "gates_per_min")


def interquartile_mean(values: FloatArray, axis: int = -1) -> FloatArray:
    """Return the mean of the middle half of n values: n // 4 are left out at each end."""
    from scipy.stats import trim_mean

    return np.asarray(trim_mean(values, 0.25, axis=axis))


def bootstrap_interval(
    values: FloatArray, statistic: Callable[..., FloatArray] = interquartile_mean
) -> list[float]:
    """Return the percentile bootstrap interval of a statistic of values (n,), deterministically.

    One value has no spread to draw from: both ends are its statistic.
    """
    from scipy.stats import bootstrap

    if len(values) < 2:
        return [float(statistic(values, axis=-1))] * 2
    result = bootstrap(
        (values,),
        statistic,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        batch=max(1, 500_000 // len(values)),
        rng=np.random.default_rng(0),
    )
    return [float(end) for end in result.confidence_interval]


def rate_interval(count: int, total: int) -> list[float]:
    """Return Wilson's interval of a rate, which is not empty at rates of 0 and 1."""
    from scipy.stats import binomtest

    ends = binomtest(count, total).proportion_ci(CONFIDENCE, method="wilson")
    return [float(ends.low), float(ends.high)]


def collided(metrics: Mapping[str, Any]) -> bool:
    """Return True if any drone collided, left the arena or tumbled in an episode."""
    return any(metrics[name] for name in COLLISIONS.values())


def score_episodes(
    episodes: Sequence[dict[str, Any]], scores: Sequence[str] = _SCORES
) -> dict[str, Any]:
    """Return the scores of an agent's episodes.

    Rates (with Wilson's intervals): `success_rate`; `collision_rate`, of episodes in which any
    drone collided, left the arena or tumbled; `collision_rate_by_kind`, where an episode may count
    for several kinds; `near_miss_rate`, of episodes with a near miss and no crash. Interquartile
    means (with bootstrap intervals): `time_to_goal_s` and `energy_j` of the successful episodes,
    other metrics, the return and the task's score of all episodes, null if none has them. Also the
    smallest separation and the largest errors. `act_ms`: the median and 99th percentile of the
    time of a decision of the whole team, from the `timed_decisions`, those of episodes that were
    simulated one at a time.

    Args:
        episodes: the episodes, as from `evaluate_agent`.
        scores: names of metrics that are scores of the task.

    Raises:
        ValueError: there is no episode.
    """
    if not episodes:
        raise ValueError("there is no episode to score; evaluate at least one")
    metrics = [episode["metrics"] for episode in episodes]
    crashed = [collided(m) for m in metrics]
    flags = {
        "success_rate": [m["success"] for m in metrics],
        "collision_rate": crashed,
        "near_miss_rate": [
            m["near_misses"] > 0 and not bad for m, bad in zip(metrics, crashed, strict=True)
        ],
    }
    numbers: dict[str, Any] = {"episodes": len(metrics)}
    intervals: dict[str, list[float]] = {}
    for name, flag in flags.items():
        numbers[name] = sum(flag) / len(flag)
        intervals[name] = rate_interval(sum(flag), len(flag))
    numbers["collision_rate_by_kind"] = {
        kind: sum(m[name] > 0 for m in metrics) / len(metrics) for kind, name in COLLISIONS.items()
    }
    successes = [m for m in metrics if m["success"]]
    own = [name for name in scores if name in metrics[0]]
    for names, of in ((OF_SUCCESSES, successes), ((*_OF_ALL, *own), metrics)):
        for name in names:
            known = [m[name] for m in of if m.get(name) is not None]
            values = np.array(known, dtype=np.float64)
            numbers[name] = float(interquartile_mean(values)) if len(values) else None
            if len(values):
                intervals[name] = bootstrap_interval(values)
    numbers |= _extremes(metrics)
    numbers["act_ms"] = _compute(episodes)
    numbers["timed_decisions"] = sum(len(episode["act_us"]) for episode in episodes)
    return {**numbers, "intervals": intervals}


def _extremes(metrics: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Return the smallest separation and the largest tracking error of all episodes."""
    found: dict[str, float | None] = {}
    for new, name, worst in (
        ("smallest_separation_m", "minimum_separation_m", min),
        ("largest_tracking_error_m", "worst_tracking_error_m", max),
    ):
        values = [float(m[name]) for m in metrics if m[name] is not None]
        found[new] = worst(values) if values else None
    return found


def _compute(episodes: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    spent = np.concatenate([np.asarray(episode["act_us"], np.float64) for episode in episodes])
    names = {"p50": 50.0, "p99": 99.0}
    if not len(spent):
        return dict.fromkeys(names)
    return {name: float(np.percentile(spent, share)) / 1e3 for name, share in names.items()}
