"""Starter: random search over the gains of a control law, each tested in 64 environments."""

import time

import gymnasium
import numpy as np

import swarm_envs  # registers the environments

SPEED, ACCELERATION = 2.0, 5.0  # scales of observations and actions, m/s and m/s^2
DRONES, NEIGHBORS = 8, 4


class MyLearner:
    requires = {
        "action": "acceleration",
        "observation": "flat",
        "decision_rate": 10,
        "num_neighbors": NEIGHBORS,
    }
    privileged = False

    def __init__(self):
        self.gains = np.array([2.0, 2.0, 3.0, 0.3])  # goal, damping, repulsion, its range

    def train(self, seconds):
        """Learn for a number of seconds; the graded episodes follow."""
        until = time.monotonic() + seconds
        options = {"num_drones": DRONES, "layout": "random", **self.requires}
        self.find(swarm_envs.make("swap_v1", physics="batch", **options).observation_layout)
        envs = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=64, **options)
        rng = np.random.default_rng(0)
        best, gains = -np.inf, self.gains
        while time.monotonic() < until - 5.0:
            value = self.trial(envs, gains)
            if value > best:
                best, self.gains = value, gains
            gains = self.gains * np.exp(0.4 * rng.standard_normal(4))
        envs.close()

    def trial(self, envs, gains):
        """Return the mean reward of a drone in 6 s with these gains."""
        rows, _ = envs.reset(seed=0)
        total = 0.0
        for _ in range(60):
            actions = self.decide(rows.reshape(len(rows), DRONES, -1), gains)
            rows, rewards, *_ = envs.step(actions.reshape(len(rows), -1))
            total += float(np.mean(rewards))
        return total

    def reset(self, env, seed):
        self.find(env.observation_layout)

    def find(self, layout):
        self.at = {field.name: field.where for field in layout}

    def act(self, observations, view):
        rows = np.stack(list(observations.values()))
        return dict(zip(observations, self.act_batch(rows), strict=True))

    def act_batch(self, rows):
        return self.decide(rows, self.gains)

    def decide(self, rows, gains):
        """Return accelerations for rows (..., width) of any number of drones."""
        to_goal, damping, push, reach = gains
        way, velocity = rows[..., self.at["task.goal"]], SPEED * rows[..., self.at["self.velocity"]]
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        acceleration = to_goal * way / np.maximum(distance, 1.0) - damping * velocity
        for k in range(NEIGHBORS):
            offset = rows[..., self.at[f"neighbor_{k}.position"]]
            there = rows[..., self.at[f"neighbor_{k}.mask"]]
            gap = np.linalg.norm(offset, axis=-1, keepdims=True) + 1e-6
            acceleration = acceleration - there * push * np.exp(-gap / reach) * offset / gap
        return np.clip(acceleration / ACCELERATION, -1.0, 1.0).astype(np.float32)
