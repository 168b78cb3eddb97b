"""Starter: straight flight to the goal, with repulsion by close neighbors."""

import numpy as np

SPEED, ACCELERATION = 2.0, 5.0  # scales of observations and actions, m/s and m/s^2
NEIGHBORS = 3


class MyAgent:
    requires = {
        "action": "acceleration",
        "observation": "flat",
        "decision_rate": 10,
        "num_neighbors": NEIGHBORS,
    }
    privileged = False

    def reset(self, env, seed):
        self.at = {field.name: field.where for field in env.observation_layout}

    def act(self, observations, view):
        rows = np.stack(list(observations.values()))
        return dict(zip(observations, self.act_batch(rows), strict=True))

    def act_batch(self, rows):
        """Return actions for rows (..., width) of any number of drones."""
        way, velocity = rows[..., self.at["task.goal"]], SPEED * rows[..., self.at["self.velocity"]]
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        acceleration = 3.0 * way / np.maximum(distance, 1.0) - 3.0 * velocity
        for k in range(NEIGHBORS):
            offset = rows[..., self.at[f"neighbor_{k}.position"]]
            there = rows[..., self.at[f"neighbor_{k}.mask"]]
            gap = np.linalg.norm(offset, axis=-1, keepdims=True) + 1e-6
            acceleration = acceleration - there * 6.0 * np.exp(-gap / 0.25) * offset / gap
        return np.clip(acceleration / ACCELERATION, -1.0, 1.0).astype(np.float32)
