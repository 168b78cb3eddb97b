"""How good a policy is: episodes on seeds that are the same in every run and never trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.agents.batch import AT_ONCE, fly_batch
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.policy_file import Policy
from swarm_envs.envs.blueprints import batch_of
from swarm_envs.envs.core import SwarmCore

CHOOSING = (0x63686F6F, 0x73696E67)
"""Entropy of the seeds on which policies are chosen: no `--seed` of `evaluate` draws the same."""


def choosing_seeds(count: int) -> list[int]:
    """Seeds of so many episodes; fewer are the first of more."""
    return [int(word) for word in np.random.SeedSequence(CHOOSING).generate_state(count)]


class Judges:
    """Environments in which a policy is judged, one batch a layout.

    Args:
        task: versioned name.
        layouts: of the task.
        seeds: of the episodes, the same on each layout.
        options: of the environments, beside what the policy requires.
    """

    def __init__(
        self, task: str, layouts: Sequence[str], seeds: Sequence[int], options: Mapping[str, Any]
    ) -> None:
        self._task, self._layouts, self._seeds = task, layouts, list(seeds)
        self._options = dict(options)
        self._cores: dict[str, SwarmCore] = {}

    def judge(self, policy: Policy) -> dict[str, float]:
        """Rates of success and of collision on each layout, such as `random_success`."""
        agent, rates = PolicyAgent(policy), {}
        for layout in self._layouts:
            metrics = fly_batch(self._core(layout, agent), agent.act_batch, self._seeds)
            crashed = [m["collided_drones"] > 0 for m in metrics]
            rates[f"{layout}_success"] = float(np.mean([m["success"] for m in metrics]))
            rates[f"{layout}_collision"] = float(np.mean(crashed))
        return rates

    def _core(self, layout: str, agent: PolicyAgent) -> SwarmCore:
        if layout not in self._cores:
            options = {**self._options, **agent.requires, "layout": layout, "threads": 1}
            found = batch_of(self._task, **options)
            count = min(AT_ONCE, len(self._seeds))
            self._cores[layout] = SwarmCore(found.task, found.config, count)
        return self._cores[layout]

    def close(self) -> None:
        """Free the environments."""
        for core in self._cores.values():
            core.close()
