"""Neural-Swarm2 (Shi et al. 2020): the delay-compensated controller, the planner, their agents."""

from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief
from swarm_envs.baselines.neural_swarm.plan_agent import PlanAgent
from swarm_envs.baselines.neural_swarm.planner.bounds import PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.library import plan_swarm
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan

__all__ = [
    "PlanAgent",
    "PlanningBounds",
    "SwarmPlan",
    "TrackingAgent",
    "load_belief",
    "plan_swarm",
]
