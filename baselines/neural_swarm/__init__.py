"""Neural-Swarm2 (Shi et al. 2020): the delay-compensated controller, the planner, their agents."""

from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig
from swarm_envs.baselines.neural_swarm.planner.pipeline import plan_swarm
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds

__all__ = [
    "PlanningBounds",
    "SearchConfig",
    "SwarmPlan",
    "TrackingAgent",
    "load_belief",
    "plan_swarm",
]
