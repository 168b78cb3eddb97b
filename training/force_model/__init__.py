"""Trainer of the interaction-force models: from rows of measured force to weights that ship.

Order of reading: `data` (files of `swarm_envs.training.interaction_rows`, and of flights),
`labels` and `drag` (what is taken out of the labels), `spec` and `network` (the heterogeneous
deep set, Neural-Swarm2 eq. 10), `pairwise` (a sum over pairs), `train`, `export`, `evaluate`,
`lipschitz`, `pipeline` (all of it: `fit`). `wake_product` fits the closed form to the same rows;
`wake_fit` and `card` make the parameters and the model card that ship.

Command: `swarm-envs fit --data FILE --out DIR --seed 0`; the pages are docs/fit.md and
docs/training.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarm_envs.training.force_model.config import FitConfig
    from swarm_envs.training.force_model.export import load_network, save_network
    from swarm_envs.training.force_model.network import DeepSet, DeepSetSpec, Window
    from swarm_envs.training.force_model.pipeline import fit
    from swarm_envs.training.force_model.report import FitReport

__all__ = [
    "DeepSet",
    "DeepSetSpec",
    "FitConfig",
    "FitReport",
    "Window",
    "fit",
    "load_network",
    "save_network",
]

_HOMES = {
    "config": ("FitConfig",),
    "export": ("load_network", "save_network"),
    "network": ("DeepSet", "DeepSetSpec", "Window"),
    "pipeline": ("fit",),
    "report": ("FitReport",),
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is asked for: rows and options are read without torch."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
