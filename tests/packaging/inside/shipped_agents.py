"""Every agent that ships flies the start of an episode of a task that it is for."""

from __future__ import annotations

from typing import Any

import numpy as np

from swarm_envs import make
from swarm_envs.agents import load
from swarm_envs.agents.registry import SHIPPED

TASKS = {
    **{"ring-dagger": "ring_v1"},
    **{"gates-dagger": "gates_v0", "pursuit-dagger": "pursuit_v0"},
    **{f"{name}-dagger": "columns_v0" for name in ("stack", "mixed", "sprint")},
    **{"delivery-dagger": "delivery_v0", "crowd-dagger": "crowd_v0"},
}
TEAMS = {
    **{"stack-dagger": 8, "sprint-dagger": 8, "delivery-dagger": 7, "crowd-dagger": 8},
    **{"swap-ppo": 4},
}
"""Numbers of drones, of agents that were made for so many; the others fly two."""
OTHERS = {"sprint-dagger": {"layout": "sprint"}, "mixed-dagger": {"team": "LSSLSS"}}
"""Layout or vehicles of agents that the default ones are not for."""
DECISIONS = 3

for name in SHIPPED:
    agent = load(name)
    options: dict[str, Any] = {**OTHERS.get(name, {}), **agent.requires}
    if "team" not in options:
        options["num_drones"] = TEAMS.get(name, 2)
    env = make(TASKS.get(name, "swap_v1"), physics="batch", **options)
    observations, _ = env.reset(seed=0)
    agent.reset(env, seed=0)
    for _step in range(DECISIONS):
        actions = agent.act(observations, env.view if agent.privileged else None)
        assert all(np.isfinite(action).all() for action in actions.values()), name
        observations = env.step(actions)[0]
    print(f"{name} flies")
    env.close()
