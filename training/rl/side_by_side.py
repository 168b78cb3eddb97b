"""Several vectorised environments as one: teams of different sizes in the same rollout."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import VecEnv

Infos = list[dict[str, Any]]
"""What a step adds for each sub-environment."""


class SideBySide(VecEnv):  # type: ignore[misc]  # SB3's base has no types here
    """The sub-environments of all parts, in the parts' order; they step together.

    A decision of the whole is one decision of every drone of every part, so a rollout has the same
    number of decisions whatever happens in it, and no row stands for a drone that does not exist.

    Args:
        parts: with equal spaces of observations and actions; they are closed with the whole.

    Raises:
        ValueError: there are none, or their spaces differ.
    """

    def __init__(self, parts: Sequence[VecEnv]) -> None:
        if not parts:
            raise ValueError("parts is empty; give at least one vectorised environment")
        first = parts[0]
        for k, part in enumerate(parts):
            if (part.observation_space, part.action_space) != (
                first.observation_space,
                first.action_space,
            ):
                raise ValueError(
                    f"part {k} observes {part.observation_space} and acts in {part.action_space}, "
                    f"but part 0 {first.observation_space} and {first.action_space}; make them "
                    "with the same options but for the team"
                )
        self.parts = tuple(parts)
        self.render_mode = None
        edges = list(accumulate((part.num_envs for part in parts), initial=0))
        self._where = [slice(begin, end) for begin, end in pairwise(edges)]
        super().__init__(edges[-1], first.observation_space, first.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the parts' next reset, each by `seed` plus the sub-environments before it."""
        seeds: list[int | None] = []
        for part, where in zip(self.parts, self._where, strict=True):
            seeds += part.seed(None if seed is None else seed + where.start)
        return seeds

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin new episodes everywhere."""
        rows: npt.NDArray[np.float32] = np.concatenate([part.reset() for part in self.parts])
        self.reset_infos = [info for part in self.parts for info in part.reset_infos]
        return rows

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Hand every part its actions."""
        for part, where in zip(self.parts, self._where, strict=True):
            part.step_async(actions[where])

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Fly every part to its next decision."""
        if len(self.parts) == 1:
            alone: tuple[Any, Any, Any, Infos] = self.parts[0].step_wait()
            return alone
        rows, rewards, ended, infos = zip(*(part.step_wait() for part in self.parts), strict=True)
        told = [info for some in infos for info in some]
        return np.concatenate(rows), np.concatenate(rewards), np.concatenate(ended), told

    def close(self) -> None:
        """Close the parts."""
        for part in self.parts:
            part.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """The parts' pictures."""
        return [image for part in self.parts for image in part.get_images()]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of sub-environments, by their part."""
        values = [value for part in self.parts for value in part.get_attr(attr_name)]
        return [values[k] for k in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of sub-environments, by their part."""
        for part, own in self._shares(indices):
            part.set_attr(attr_name, value, own)

    def env_method(
        self, method_name: str, *arguments: Any, indices: Any = None, **options: Any
    ) -> list[Any]:
        """Call a method of sub-environments, by their part."""
        return [
            value
            for part, own in self._shares(indices)
            for value in part.env_method(method_name, *arguments, indices=own, **options)
        ]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether sub-environments are wrapped, by their part."""
        return [
            wrapped
            for part, own in self._shares(indices)
            for wrapped in part.env_is_wrapped(wrapper_class, own)
        ]

    def _shares(self, indices: Any) -> list[tuple[VecEnv, list[int]]]:
        """Which sub-environments of each part are meant, by their number in it."""
        asked = list(self._get_indices(indices))
        shares = [
            (part, [k - where.start for k in asked if where.start <= k < where.stop])
            for part, where in zip(self.parts, self._where, strict=True)
        ]
        return [(part, own) for part, own in shares if own]
