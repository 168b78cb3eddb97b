"""`swarm-envs evaluate` with other processes or a Ray cluster: the report is the same."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

from swarm_envs.agents.evaluation import Episode, frozen_seeds, score_episodes, source_digest
from swarm_envs.agents.protocol import flies_batches
from swarm_envs.commands.evaluate import (
    EvaluateOptions,
    described,
    open_episodes,
    tell_before,
    unflyable,
)
from swarm_envs.commands.fly import prepare
from swarm_envs.training.scale_out.episodes import (
    AgentEpisodes,
    EvaluationSpec,
    evaluate_distributed,
)


def reports(options: EvaluateOptions, about: dict[str, Any]) -> list[dict[str, Any]]:
    """Each agent's scores; or, under `error`, why it has none.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is asked for, and Ray is not installed.
        OSError: an episode cannot be kept.
    """
    found: dict[str, dict[str, Any]] = {}
    agents: dict[str, AgentEpisodes] = {}
    for name in options.agent:
        found[name], record = _enter(name, options, about)
        if record is not None:
            agents[name] = record
    _fly([*agents.values()], options, about["task"])
    for name, record in agents.items():
        found[name] |= _scores(record, options)
    return [found[name] for name in options.agent]


def _enter(
    name: str, options: EvaluateOptions, about: dict[str, Any]
) -> tuple[dict[str, Any], AgentEpisodes | None]:
    """What is known of an agent before it flies; no record if it cannot."""
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
    return report, AgentEpisodes(name, source_digest(agent), batched, kept)


def _fly(agents: list[AgentEpisodes], options: EvaluateOptions, task: str) -> None:
    """Every episode of all agents that is not there yet, with one progress bar."""
    seeds = frozen_seeds(options.seed, options.episodes)
    before = {e.name: sum(seed in e.episodes for seed in seeds) for e in agents}
    for name, count in before.items():
        tell_before(name, count, len(seeds))
    total = len(seeds) * len(agents)
    if sum(before.values()) == total:
        return
    with (
        options.scale.open() as workers,
        tqdm(total=total, initial=sum(before.values()), unit="episode", mininterval=0.5) as bar,
    ):

        def on_episode(record: AgentEpisodes, episode: Episode) -> None:
            bar.set_description_str(record.name[-30:], refresh=False)
            bar.update()

        setting = options.setting()
        evaluate_distributed(
            [EvaluationSpec(e, task, setting, seeds) for e in agents], workers, on_episode
        )


def _scores(record: AgentEpisodes, options: EvaluateOptions) -> dict[str, Any]:
    if record.failure is None:
        return score_episodes(record.flown(frozen_seeds(options.seed, options.episodes)))
    if ":" in record.name:  # whoever wrote the file needs to see where it failed
        sys.stderr.write(record.trace)
    return {"error": record.failure}
