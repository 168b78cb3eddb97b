"""The deep set that the compensated controller believes, from flights inside the environment.

Command: `python -m swarm_envs.training.belief --out DIR --seed 0`, and
`--collection.interactions wake` for an environment with another force model.
"""

from swarm_envs.training.belief.fit import BeliefConfig, fit_belief
from swarm_envs.training.belief.judge import SwapJudgement, judge

__all__ = ["BeliefConfig", "SwapJudgement", "fit_belief", "judge"]
