"""Training: force models, data collection, reinforcement learning and the benchmark."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if __name__ == "training":
    raise ImportError(
        "import swarm_envs.training instead: a bare 'training' collides with other packages"
    )

if TYPE_CHECKING:
    from swarm_envs.training.shared_policy import SharedPolicyVecEnv

__all__ = ["SharedPolicyVecEnv"]


def __getattr__(name: str) -> Any:
    """Import `SharedPolicyVecEnv` on access, as it needs Stable-Baselines3 and torch."""
    if name == "SharedPolicyVecEnv":
        from swarm_envs.training.shared_policy import SharedPolicyVecEnv

        return SharedPolicyVecEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
