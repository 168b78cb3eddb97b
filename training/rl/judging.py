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
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.recipes import RECIPES
from swarm_envs.vehicles import SMALL, Team, team_string

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
        self._options, self._recipe = dict(options), RECIPES[task]
        self._given: dict[str, dict[str, Any]] = {
            layout + suffix: {**flown, **self._recipe.layouts[layout]}
            for suffix, flown in _flown(teams).items()
            for layout in layouts
        }
        self._cores: dict[str, SwarmCore] = {}

    def judge(self, policy: Policy) -> dict[str, float]:
        """Averages of the recipe's measures on each layout, such as `random_success`.

        With several teams, of each: such as `random_8_success` of eight small drones.
        """
        agent, found = PolicyAgent(policy), {}
        for layout in self._given:
            metrics = fly_batch(self._core(layout, agent), agent.act_batch, self._seeds)
            for name, measure in self._recipe.measures.items():
                found[f"{layout}_{name}"] = float(np.mean([measure(m) for m in metrics]))
        return found

    def _core(self, layout: str, agent: PolicyAgent) -> SwarmCore:
        if layout not in self._cores:
            given = self._given[layout]
            options = {**self._options, **agent.requires, **given, "threads": 1}
            found = batch_of(self._task, **options)
            count = min(AT_ONCE, len(self._seeds))
            self._cores[layout] = SwarmCore(found.task, found.config, count)
        return self._cores[layout]

    def close(self) -> None:
        """Free the environments."""
        for core in self._cores.values():
            core.close()


def quality(config: TrainConfig, task: str, measured: Mapping[str, float]) -> float:
    """How good a policy is: its recipe's quality, averaged over teams.

    Args:
        config: of its training.
        task: versioned name.
        measured: what `Judges.judge` gave.
    """
    recipe, layout, found = RECIPES[task], str(config.layout), []
    for suffix in _flown(config.teams):
        names = [(a, b) for a in recipe.judged_on(layout) for b in recipe.measures]
        own = {f"{a}_{b}": measured[f"{a}{suffix}_{b}"] for a, b in names}
        found.append(recipe.quality(layout, own))
    return sum(found) / len(found)


def _flown(teams: Sequence[Team]) -> dict[str, dict[str, Any]]:
    """Options of each team, by what follows the layout in names: nothing if there is one."""
    if len(teams) < 2:
        return {"": {"team": teams[0]} if teams else {}}
    return {f"_{_short(team)}": {"team": team} for team in teams}


def _short(team: Team) -> str:
    """A team of small drones by its number, any other by its vehicles."""
    return str(len(team)) if set(team) == {SMALL} else team_string(team)
