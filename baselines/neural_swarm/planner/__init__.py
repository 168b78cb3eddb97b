"""Neural-Swarm2's interaction-aware motion planner (Sec. V, Algorithm 1), in two stages.

`pipeline.plan_swarm` runs both: `ao_rrt.search` returns the `Trajectories` of the cheapest plan
that it finds for a problem, `scp.refine` improves them, one robot's subproblem after another, and
`verify.check_plan` evaluates the result. docs/equations.md lists the file of each equation and of
each line of the algorithm.
"""

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import search
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories

__all__ = ["PlanningBounds", "PlanningProblem", "Trajectories", "search"]
