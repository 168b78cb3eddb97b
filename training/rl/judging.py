"""How good a policy is: episodes on seeds that are the same in every run and never trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.agents.batch import AT_ONCE, fly_batch
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.policy_file import Policy
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from swarm_envs.training.rl.recipes import RECIPES

CHOOSING = (0x63686F6F, 0x73696E67)
"""Entropy of the seeds on which policies are chosen: no `--seed` of `evaluate` draws the same."""


def choosing_seeds(count: int) -> list[int]:
    """Seeds of so many episodes; fewer are the first of more."""
    return [int(word) for word in np.random.SeedSequence(CHOOSING).generate_state(count)]


class Judges:
    """Environments in which a policy is judged, one batch a layout and team.

    Args:
        task: versioned name.
        layouts: of the task.
        seeds: of the episodes, the same on each layout.
        options: of the environments, beside what the policy requires.
        teams: options of each team that flies; with none the others say who does.
    """

    def __init__(
        self,
        task: str,
        layouts: Sequence[str],
        seeds: Sequence[int],
        options: Mapping[str, Any],
        teams: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        self._task, self._seeds = task, list(seeds)
        self._recipe = RECIPES[task]
        self._flown = {
            layout if len(teams) < 2 else f"{layout}_{_short(team)}": {
                **options,
                **team,
                **self._recipe.layouts[layout],
            }
            for team in teams or ({},)
            for layout in layouts
        }
        self._cores: dict[str, SwarmCore] = {}

    def judge(self, policy: Policy) -> dict[str, float]:
        """Averages of the recipe's measures on each layout, such as `random_success`.

        With several teams each has its own, such as `random_8_success` of eight drones.
        """
        agent, found = PolicyAgent(policy), {}
        for flown in self._flown:
            metrics = fly_batch(self._core(flown, agent), agent.act_batch, self._seeds)
            for name, measure in self._recipe.measures.items():
                found[f"{flown}_{name}"] = float(np.mean([measure(m) for m in metrics]))
        return found

    def _core(self, name: str, agent: PolicyAgent) -> SwarmCore:
        if name not in self._cores:
            options = {"threads": 1, **self._flown[name], **agent.requires}
            found = batch_of(self._task, **options)
            count = min(AT_ONCE, len(self._seeds))
            self._cores[name] = SwarmCore(found.task, found.config, count)
        return self._cores[name]

    def close(self) -> None:
        """Free the environments."""
        for core in self._cores.values():
            core.close()


def _short(team: Mapping[str, Any]) -> str:
    """A team by its number, or by its vehicles where they are named."""
    return "_".join(str(value) for value in team.values())
