"""Define your own force model: drones push down those below them.

Fly it from Python, or from the command line:

    python examples/own_force.py
    swarm-envs fly --layout stacked --team LS --agent tracking \
        --interactions examples/own_force.py:push_down
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import swarm_envs
from swarm_envs.agents import fly_episode, load

Array = npt.NDArray[np.float64]


def push_down(position: Array, velocity: Array, types: npt.NDArray[np.str_]) -> Array:
    """Return forces (E, N, 3), N: each drone pushes down those below, up to 20 cm to the side."""
    offset = position[:, None] - position[:, :, None]  # (E, i, j, 3): from i to j
    aside, above = np.linalg.norm(offset[..., :2], axis=-1), offset[..., 2]
    strength = np.where((aside < 0.2) & (above > 0.0), 0.02 * (1.0 - aside / 0.2), 0.0)
    force = np.zeros_like(position)
    force[..., 2] = -(strength * np.where(types == "L", 2.0, 1.0)[:, None]).sum(axis=2)
    return force


def main() -> None:
    """Fly a stacked swap without forces, and with `push_down`."""
    agent = load("tracking")
    for force in ("none", push_down):
        env = swarm_envs.make(
            "swap_v1", team="LS", layout="stacked", interactions=force, **agent.requires
        )
        metrics = fly_episode(env, agent, seed=0)
        name = force if isinstance(force, str) else force.__name__
        print(f"{name}: worst height error {100 * metrics['worst_height_error_m']:.1f} cm")
        env.close()


if __name__ == "__main__":
    main()
