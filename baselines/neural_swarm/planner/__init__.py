"""Neural-Swarm2's interaction-aware motion planner (Sec. V, Algorithm 1)."""

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig, SearchResult, search
from swarm_envs.baselines.neural_swarm.planner.pipeline import straight_lines
from swarm_envs.baselines.neural_swarm.planner.plan_plot import plot_plan
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.scp import RefinementOptions
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories

__all__ = [
    "PlanningBounds",
    "PlanningProblem",
    "RefinementOptions",
    "SearchConfig",
    "SearchResult",
    "Trajectories",
    "plot_plan",
    "search",
    "straight_lines",
]
