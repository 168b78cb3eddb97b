"""Neural-Swarm2 (Shi et al. 2020): the delay-compensated tracking controller, as an agent."""

from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief

__all__ = ["TrackingAgent", "load_belief"]
