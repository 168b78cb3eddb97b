"""Training of models of the interaction force on rows of measured force.

Order of reading: `force_fit_config` (options), `flight_logs.read` (files of rows and of
flights), `labels` (offsets and drag), `network` (the heterogeneous deep set, Neural-Swarm2 eq. 10),
`wake`, `composed`, `examples`, `spectral`, `train`, `export`, `lipschitz`, `evaluate`, and
`pipeline` (the whole `fit`). `compare` compares models on held-out flights, `residual_fit`
identifies the residual force of a model.

Command: `swarm-envs fit --data FILE --out DIR --seed 0`; the page is docs/fit.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarm_envs.training.force_model.export import load_network, save_network
    from swarm_envs.training.force_model.force_fit_config import FitConfig
    from swarm_envs.training.force_model.network import DeepSet
    from swarm_envs.training.force_model.pipeline import fit

_HOMES = {
    "DeepSet": "network",
    "FitConfig": "force_fit_config",
    "fit": "pipeline",
    "load_network": "export",
    "save_network": "export",
}

__all__ = ["DeepSet", "FitConfig", "fit", "load_network", "save_network"]


def __getattr__(name: str) -> Any:
    """Import a public name on access, so that rows and options can be read without torch."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
