"""Things that act: the agent protocol, and the loop that flies an agent through an episode."""

if __name__ == "agents":
    raise ImportError("import swarm_envs.agents: the bare name 'agents' is another package's")

from swarm_envs.agents.protocol import Actions, Agent, Observations, fly_episode

__all__ = ["Actions", "Agent", "Observations", "fly_episode"]
