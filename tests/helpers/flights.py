"""Episodes of agents by name."""

from __future__ import annotations

from typing import Any

from swarm_envs import make
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import TIMED, evaluate_agent


def flown(
    name: str, task: str, seeds: list[int], timed: int = TIMED, **options: Any
) -> list[dict[str, Any]]:
    """Metrics of an agent's episodes on the compiled engine; `timed` as of `evaluate_agent`."""
    agent = load(name)
    env = make(task, physics="batch", **options, **agent.requires)
    found = [episode["metrics"] for episode in evaluate_agent(env, agent, seeds, timed=timed)]
    env.close()
    return found
