"""Neural-Swarm2's interaction-aware motion planner (Sec. V, Algorithm 1), in two stages.

====================  ==============================================  ==========================
file                  what it does                                    in the paper
====================  ==============================================  ==========================
`pipeline`            both stages in one call: `plan_swarm`           Algorithm 1
`problem`             starts, goals, vehicles, bounds, their checks   eq. (6)
`trajectories`        motions on a time grid, and within its steps    eq. (13), (14)
`ao_rrt`              stage 1: robot after robot, tree after tree     Sec. V-A; lines 1 to 17
`search_tree`         one tree: sample, steer, extend (compiled)      lines 4 to 15
`propagation`         one step: dynamics, validity, cost (compiled)   lines 9, 10; eq. (13), (14)
`steering`            bursts of constant control (compiled)           our choice of actions
`kd_tree`             nearest neighbours (compiled)                   line 7
`scp`                 stage 2: trust regions, merit, stopping         lines 18 to 21
`linearization`       one robot's convex subproblem as arrays         eq. (17)
`convex_program`      the same as a quadratic program for OSQP        eq. (17)
`force_jacobian`      derivatives of the forces by a state            eq. (15), (16)
`verify`              a plan flown forward, all bounds measured       eq. (6)
`plan`                the result `SwarmPlan`, and its files
`plan_plot`           its picture                                     Fig. 6
====================  ==============================================  ==========================

A problem goes into `ao_rrt.search`, which returns `Trajectories` of the cheapest plan found.
`scp.refine` improves them, one robot's subproblem after another, and `verify.check_plan` says what
the result is worth.
"""

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig, SearchResult, search
from swarm_envs.baselines.neural_swarm.planner.plan_plot import plot_plan
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.scp import RefinementOptions
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories, straight_lines

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
