"""Neural-Swarm2's interaction-aware motion planner (Sec. V, Algorithm 1), in two stages.

`pipeline.plan_swarm` runs both: a problem goes into `ao_rrt.search`, which returns `Trajectories`
of the cheapest plan found. `scp.refine` improves them, one robot's subproblem after another, and
`verify.check_plan` says what the result is worth. docs/equations.md says which file holds which
equation and which lines of the algorithm.
"""

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import search
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories

__all__ = ["PlanningBounds", "PlanningProblem", "Trajectories", "search"]
