"""Agents: their protocol, the included agents by name, and the loop of an episode."""

if __name__ == "agents":
    raise ImportError("import swarm_envs.agents: the bare name 'agents' is another package's")

from swarm_envs.agents.models import from_model
from swarm_envs.agents.protocol import (
    Actions,
    Agent,
    Observations,
    fly_episode,
    record_episode,
)
from swarm_envs.agents.recommendation import recommended
from swarm_envs.agents.registry import load_agent as load
from swarm_envs.agents.safety import Safety, SafetyFilter

__all__ = [
    "Actions",
    "Agent",
    "Observations",
    "Safety",
    "SafetyFilter",
    "fly_episode",
    "from_model",
    "load",
    "recommended",
    "record_episode",
]
