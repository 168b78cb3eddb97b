"""What only SAC is told: options alone, readable where torch is not installed."""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.errors import check_integer


@dataclass(frozen=True)
class SacOptions:
    """Of `--algo sac`: how often it learns from what it remembers."""

    rollout: int = 8
    """decisions of each drone between two rounds of gradient steps"""
    gradient_steps: int = 32
    """of a round; each takes a batch from all that is remembered"""
    batch_size: int = 1024
    """decisions per gradient step"""
    learning_rate: float = 1e-3
    """of Adam at the start, for actor, critics and temperature; it falls linearly"""
    last_rate: float = 0.1
    """what is left of it at the end, as a share"""
    lookahead: int = 5
    """rewards that are counted before a critic's word on what follows them (n-step returns)"""
    learning_starts: int = 8192
    """decisions of single drones, drawn at random, before the first gradient step"""
    buffer_size: int = 300_000
    """decisions that are remembered, the latest; checkpoints hold them, 0.6 kB each"""
    smoothing: float = 0.02
    """tau: share by which target critics follow the critics at each gradient step"""
    temperature: float = 0.002
    """weight of entropy beside reward at the start; it is learned. Far above what a decision's
    reward is, drones are paid for trembling"""

    def __post_init__(self) -> None:
        """Refuse numbers with which nothing could be learned.

        Raises:
            ValueError: naming the option, the value and the rule.
        """
        for name in _COUNTS:
            check_integer(f"--sac.{name.replace('_', '-')}", getattr(self, name), 1)
        check_integer("--sac.learning-starts", self.learning_starts, 0)
        for name in ("learning_rate", "last_rate", "smoothing", "temperature"):
            value = getattr(self, name)
            if not 1e-7 <= value <= 1.0:
                raise ValueError(
                    f"--sac.{name.replace('_', '-')} is {value}, but must be from 1e-07 to 1"
                )


_COUNTS = ("rollout", "gradient_steps", "batch_size", "lookahead", "buffer_size")
