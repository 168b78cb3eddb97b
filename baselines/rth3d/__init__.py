"""RTH3D: labeled multi-robot path planning on 3-D grids (Guo, Feng, Yu, IROS 2022).

`plan` returns a `GridPlan`, `validate` checks one by independent code, `max_density` returns the
largest density of robots on the highways, `make_instance` draws instances of `FAMILIES`.
"""

from swarm_envs.baselines.rth3d.grid import (
    FAMILIES,
    GridInstance,
    NoPlanExists,
    PlanNotFound,
    building_columns,
    make_instance,
)
from swarm_envs.baselines.rth3d.grid_plan import GridPlan, PlanTimeout
from swarm_envs.baselines.rth3d.grid_planning import METHODS, plan
from swarm_envs.baselines.rth3d.grid_validation import validate
from swarm_envs.baselines.rth3d.highways import max_density

__all__ = [
    "FAMILIES",
    "METHODS",
    "GridInstance",
    "GridPlan",
    "NoPlanExists",
    "PlanNotFound",
    "PlanTimeout",
    "building_columns",
    "make_instance",
    "max_density",
    "plan",
    "validate",
]
