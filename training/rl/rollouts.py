"""Where Stable-Baselines3's algorithms tell of their rollouts."""

from __future__ import annotations

from collections.abc import Callable

from stable_baselines3.common.callbacks import BaseCallback

from swarm_envs.training.rl.learner import Watch


class Rollouts(BaseCallback):  # type: ignore[misc]  # SB3's base has no types here
    """Tells the learner that a rollout begins, and the run that one has ended.

    Args:
        begin: called before each, with the number of steps that were flown.
        watch: called after each.
    """

    def __init__(self, begin: Callable[[int], None], watch: Watch | None) -> None:
        super().__init__()
        self._begin, self._watch = begin, watch

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self._begin(self.num_timesteps)

    def _on_rollout_end(self) -> None:
        if self._watch is not None:
            self._watch()
