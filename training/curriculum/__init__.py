"""The curriculum of Neural-Swarm2, Sec. IV-D: fit, fly closer with what was learned, fit again.

Drones that do not know the wakes are blown apart, so nobody can fly them close together to learn
the wakes. So it is done in rounds: one and two drones fly far apart, without compensation, and a
model is fitted; with it as the pilot's feed-forward they fly closer; then three drones. Order of
reading: `config` (the rounds), `closeness` (how close drones came, and how close the next round may
plan), `rounds` (one round), `unseen` (how much of the true force a model explains), `report`,
`picture`, `run` (all of it).

Command: `swarm-envs curriculum --out DIR --seed 0`; the page is docs/curriculum.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from swarm_envs.training.curriculum.closeness import Closeness, next_clearance
from swarm_envs.training.curriculum.config import CurriculumConfig

if TYPE_CHECKING:
    from swarm_envs.training.curriculum.run import run_curriculum

__all__ = ["Closeness", "CurriculumConfig", "next_clearance", "run_curriculum"]


def __getattr__(name: str) -> Any:
    """Load the run when it is asked for: options are read without torch."""
    if name == "run_curriculum":
        return import_module(f"{__name__}.run").run_curriculum
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
