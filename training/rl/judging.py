"""How good a policy is: episodes on seeds that are the same in every run and never trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.agents.batch import fly_batch
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.policy_file import Policy
from swarm_envs.envs.blueprints import batch_of
from swarm_envs.envs.core import SwarmCore
from swarm_envs.vehicles import SMALL, Team, team_string

CHOOSING = (0x63686F6F, 0x73696E67)
"""Entropy of the seeds on which policies are chosen: no `--seed` of `evaluate` draws the same."""
_AT_ONCE = 64
"""Environments that fly at once."""


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
        teams: that fly; with none the options say who does.
    """

    def __init__(
        self,
        task: str,
        layouts: Sequence[str],
        seeds: Sequence[int],
        options: Mapping[str, Any],
        teams: Sequence[Team] = (),
    ) -> None:
        self._task, self._seeds = task, list(seeds)
        self._flown = {
            layout if len(teams) < 2 else f"{layout}_{_short(team)}": {
                **options,
                **({"team": team} if teams else {}),
                "layout": layout,
            }
            for team in teams or ((),)
            for layout in layouts
        }
        self._cores: dict[str, SwarmCore] = {}

    def judge(self, policy: Policy) -> dict[str, float]:
        """Rates of success and of collision on each layout, such as `random_success`.

        With several teams each has its own, such as `random_8_success` of eight small drones.
        """
        agent, rates = PolicyAgent(policy), {}
        for name in self._flown:
            metrics = fly_batch(self._core(name, agent), agent.act_batch, self._seeds)
            crashed = [m["collided_drones"] > 0 for m in metrics]
            rates[f"{name}_success"] = float(np.mean([m["success"] for m in metrics]))
            rates[f"{name}_collision"] = float(np.mean(crashed))
        return rates

    def _core(self, name: str, agent: PolicyAgent) -> SwarmCore:
        if name not in self._cores:
            options = {"threads": 1, **self._flown[name], **agent.requires}
            found = batch_of(self._task, **options)
            count = min(_AT_ONCE, len(self._seeds))
            self._cores[name] = SwarmCore(found.task, found.config, count)
        return self._cores[name]

    def close(self) -> None:
        """Free the environments."""
        for core in self._cores.values():
            core.close()


def mean_success(rates: Mapping[str, float]) -> float:
    """The mean of all rates of success that `Judges.judge` gave."""
    found = [rate for name, rate in rates.items() if name.endswith("_success")]
    return sum(found) / len(found)


def _short(team: Team) -> str:
    """A team of small drones by its number, any other by its vehicles."""
    return str(len(team)) if set(team) == {SMALL} else team_string(team)
