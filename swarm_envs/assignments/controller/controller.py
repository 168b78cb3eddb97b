"""Starter: PD control of the reference; the action is the acceleration of the set-point."""

import numpy as np

SPEED, ACCELERATION = 2.0, 5.0  # scales of observations and actions, m/s and m/s^2


class MyController:
    requires = {"action": "acceleration", "observation": "flat", "decision_rate": 48}
    privileged = False
    stiffness, damping = 3.0, 3.0  # 1/s^2, 1/s; change them

    def reset(self, env, seed):
        self.at = {field.name: field.where for field in env.observation_layout}

    def act(self, observations, view):
        return {name: self.fly(row) for name, row in observations.items()}

    def fly(self, row):
        behind = row[self.at["task.reference_position"]]  # relative to the drone
        velocity = SPEED * row[self.at["self.velocity"]]
        wanted = SPEED * row[self.at["task.reference_velocity"]]
        acceleration = self.stiffness * behind + self.damping * (wanted - velocity)
        return np.clip(acceleration / ACCELERATION, -1.0, 1.0).astype(np.float32)
