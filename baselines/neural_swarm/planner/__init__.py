"""Neural-Swarm2's interaction-aware motion planner (Sec. V, Algorithm 1)."""

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig, SearchResult, search
from swarm_envs.baselines.neural_swarm.planner.bounds import PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories

__all__ = [
    "PlanningBounds",
    "PlanningProblem",
    "SearchConfig",
    "SearchResult",
    "Trajectories",
    "search",
]
