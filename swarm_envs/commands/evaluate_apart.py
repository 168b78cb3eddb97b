"""`swarm-envs evaluate` with other processes or a Ray cluster: the report is the same."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

from swarm_envs.agents.batch import flies_batches
from swarm_envs.agents.evaluation import Episode, frozen_seeds, source_digest
from swarm_envs.agents.scores import score
from swarm_envs.commands.evaluate import (
    EvaluateOptions,
    described,
    open_episodes,
    prepare,
    tell_before,
    unflyable,
)
from swarm_envs.training.scale_out.episodes import Entrant, Leg, fly_apart


def reports(options: EvaluateOptions, about: dict[str, Any]) -> list[dict[str, Any]]:
    """Each agent's scores; or, under `error`, why it has none.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is asked for, and Ray is not installed.
        OSError: an episode cannot be kept.
    """
    found: dict[str, dict[str, Any]] = {}
    entrants: dict[str, Entrant] = {}
    for name in options.agent:
        found[name], entrant = _enter(name, options, about)
        if entrant is not None:
            entrants[name] = entrant
    _fly([*entrants.values()], options, about["task"])
    for name, entrant in entrants.items():
        found[name] |= _scores(entrant, options)
    return [found[name] for name in options.agent]


def _enter(
    name: str, options: EvaluateOptions, about: dict[str, Any]
) -> tuple[dict[str, Any], Entrant | None]:
    """What is known of an agent before it flies; no entrant if it cannot."""
    report: dict[str, Any] = {"agent": name}
    try:
        agent, env = prepare(name, options, about["task"])
    except (Exception, SystemExit) as error:
        return {**report, "error": unflyable(error)}, None
    report |= described(agent, env)
    batched = flies_batches(env, agent)
    env.close()
    try:
        kept = open_episodes(name, agent, options, about)
    except Exception as error:
        return {**report, "error": str(error)}, None
    return report, Entrant(name, source_digest(agent), batched, kept)


def _fly(entrants: list[Entrant], options: EvaluateOptions, task: str) -> None:
    """Every episode of all agents that is not there yet, with one progress bar."""
    seeds = frozen_seeds(options.seed, options.episodes)
    before = {e.name: sum(seed in e.episodes for seed in seeds) for e in entrants}
    for name, count in before.items():
        tell_before(name, count, len(seeds))
    total = len(seeds) * len(entrants)
    if sum(before.values()) == total:
        return
    with (
        options.scale.open() as workers,
        tqdm(total=total, initial=sum(before.values()), unit="episode", mininterval=0.5) as bar,
    ):

        def watch(entrant: Entrant, episode: Episode) -> None:
            bar.set_description_str(entrant.name[-30:], refresh=False)
            bar.update()

        setting = options.setting()
        fly_apart([Leg(e, task, setting, seeds) for e in entrants], workers, watch)


def _scores(entrant: Entrant, options: EvaluateOptions) -> dict[str, Any]:
    if entrant.failure is None:
        return score(entrant.flown(frozen_seeds(options.seed, options.episodes)))
    if ":" in entrant.name:  # whoever wrote the file needs to see where it failed
        sys.stderr.write(entrant.trace)
    return {"error": entrant.failure}
