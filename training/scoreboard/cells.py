"""The cells of the scoreboard: an agent on a task, what it flew, or why it did not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import swarm_envs
from swarm_envs.agents import Agent, load
from swarm_envs.agents.batch import flies_batches
from swarm_envs.agents.evaluation import Episode, EpisodeFile, source_digest
from swarm_envs.agents.protocol import check_wishes
from swarm_envs.training.scale_out.episodes import Entrant, Leg
from swarm_envs.training.scoreboard.tasks import ScoredTask, digest

FOLDER = "episodes"
"""Where episodes are kept, in a benchmark's folder."""
Status = Literal["flown", "failed", "unsupported"]


@dataclass(frozen=True)
class Contender:
    """An agent that was asked for."""

    name: str
    """As of `swarm_envs.agents.load`."""
    agent: Agent | None
    """None if it could not be made."""
    digest: str
    """Of its source; empty if it could not be made."""
    error: str = ""
    """Why it could not."""

    @property
    def privileged(self) -> bool:
        """Whether it sees the true state."""
        return self.agent is not None and self.agent.privileged


def enter(name: str) -> Contender:
    """Make an agent, or say why it cannot be made."""
    try:
        agent = load(name)
        return Contender(name, agent, source_digest(agent))
    except (Exception, SystemExit) as error:
        return Contender(name, None, "", f"cannot be made: {type(error).__name__}: {error}")


@dataclass
class Cell:
    """An agent on a task."""

    task: ScoredTask
    """What is flown."""
    contender: Contender
    """Who flies."""
    seeds: Sequence[int]
    """Of its episodes."""
    leg: Leg | None = None
    """Its flights; None if there can be none."""
    refusal: str = ""
    """Why there can be none, found before anything flew."""

    @property
    def episodes(self) -> list[Episode]:
        """Those that count, in the order of the seeds: none after the first that failed."""
        if self.leg is None:
            return []
        entrant = self.leg.entrant
        last = len(self.seeds) if entrant.failure is None else int(entrant.failed_at)
        return entrant.flown(self.seeds[:last])

    @property
    def refused(self) -> list[str]:
        """Why the agent refused, one for each episode that it did."""
        found = (episode["metrics"].get("refused") for episode in self.episodes)
        return [why for why in found if why is not None]

    @property
    def status(self) -> Status:
        """What became of it: an agent that refuses every episode does not support the task."""
        if self.contender.error or (self.leg is not None and self.leg.entrant.failure is not None):
            return "failed"
        if self.leg is None or len(self.refused) == len(self.seeds):
            return "unsupported"
        return "flown"

    @property
    def reason(self) -> str:
        """Why it was not flown, or some of it not; empty if all was."""
        failure = self.leg.entrant.failure if self.leg is not None else None
        if self.contender.error or failure is not None:
            return self.contender.error or str(failure)
        refused = self.refused
        if self.leg is None or len(refused) == len(self.seeds):
            return self.refusal or refused[0]
        if refused:
            return f"refused {len(refused)} of {len(self.seeds)} episodes: {refused[0]}"
        return ""

    @property
    def act_us(self) -> list[int]:
        """Times of the decisions that were timed, microseconds."""
        return [spent for episode in self.episodes for spent in episode["act_us"]]


def prepare(task: ScoredTask, contender: Contender, seeds: Sequence[int], out: Path) -> Cell:
    """A cell, with the episodes that were flown before.

    Args:
        task: what is flown.
        contender: who flies.
        seeds: of the episodes.
        out: the benchmark's folder.

    Raises:
        ValueError: the file of episodes is damaged.
    """
    agent, cell = contender.agent, Cell(task, contender, seeds)
    if agent is None:
        return cell
    try:
        check_wishes(agent, task.setting)
        env = swarm_envs.make(task.environment, **{**task.setting, **agent.requires})
    except (ValueError, TypeError, ImportError) as error:
        cell.refusal = str(error)
        return cell
    batched = flies_batches(env, agent)
    env.close()
    kept = EpisodeFile(out / FOLDER / task.id, contender.name, _depends_on(task, contender))
    entrant = Entrant(contender.name, contender.digest, batched, kept)
    cell.leg = Leg(entrant, task.environment, task.setting, seeds, refusals=True)
    return cell


def _depends_on(task: ScoredTask, contender: Contender) -> dict[str, Any]:
    """What an episode depends on beside its seed."""
    about = {"task": task.id, "definition": digest(task), "version": swarm_envs.__version__}
    return {**about, "agent": contender.name, "source": contender.digest}
