"""MLR-DMPC (Gräfe et al., DMPC-Swarm): distributed MPC that never collides, whatever is lost."""

from swarm_envs.baselines.mlr_dmpc.agent import MlrDmpcAgent
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.loss import GilbertElliott, Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.result import MlrDmpcResult
from swarm_envs.baselines.mlr_dmpc.simulate import simulate
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, UnitOutage

__all__ = [
    "GilbertElliott",
    "Jam",
    "LossModel",
    "MlrDmpcAgent",
    "MlrDmpcConfig",
    "MlrDmpcResult",
    "MlrDmpcSwarm",
    "UnitOutage",
    "simulate",
]
