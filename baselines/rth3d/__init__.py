"""RTH3D: labelled multi-robot path planning on 3-D grids (Guo, Feng, Yu, IROS 2022).

`plan` makes a `GridPlan`, `validate` checks one by other code, `max_density` says how many robots
the guaranteed methods take, `make_instance` draws instances of `FAMILIES`.
"""

from swarm_envs.baselines.rth3d.grid import GridInstance
from swarm_envs.baselines.rth3d.highways import max_density
from swarm_envs.baselines.rth3d.instances import FAMILIES, buildings, make_instance
from swarm_envs.baselines.rth3d.plan import GridPlan, plan
from swarm_envs.baselines.rth3d.records import PhaseRecord, PlanTimeout
from swarm_envs.baselines.rth3d.solvers import METHODS, PlanNotFound
from swarm_envs.baselines.rth3d.validation import ValidationReport, validate

__all__ = [
    "FAMILIES",
    "METHODS",
    "GridInstance",
    "GridPlan",
    "PhaseRecord",
    "PlanNotFound",
    "PlanTimeout",
    "ValidationReport",
    "buildings",
    "make_instance",
    "max_density",
    "plan",
    "validate",
]
