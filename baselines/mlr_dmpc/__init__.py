"""MLR-DMPC (Gräfe et al., DMPC-Swarm): distributed MPC that avoids collisions despite message loss.

Lemmas L1 to L11 and theorems T1 to T3 are those of docs/mlr-dmpc/proof.md; those without a letter
are the paper's.
"""

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_agent import MlrDmpcAgent
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import GilbertElliott, Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.simulate import MlrDmpcResult, simulate
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
