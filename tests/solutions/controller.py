"""Solutions of the assignment `controller`: thrust and body rates, without and with an observer."""

import numpy as np

SPEED, STEP_S, GRAVITY = 2.0, 1.0 / 120.0, 9.81
LARGEST = 65.0 / 34.0 * GRAVITY  # thrust over mass of the small drone, m/s^2
UP = np.array([0.0, 0.0, 1.0])


class Feedforward:
    """Follows the reference's acceleration, and turns the thrust where it is needed."""

    requires = {"action": "ctbr", "observation": "flat", "decision_rate": 120}
    privileged = False
    stiffness, damping, rate = 12.0, 6.0, 0.0

    def reset(self, env, seed):
        self.at = {field.name: field.where for field in env.observation_layout}
        self.known = {name: (np.zeros(3), None) for name in env.possible_agents}

    def act(self, observations, view):
        return {name: self.fly(name, row.astype(float)) for name, row in observations.items()}

    def fly(self, name, row):
        velocity = SPEED * row[self.at["self.velocity"]]
        attitude = row[self.at["self.attitude"]].reshape(3, 3)
        rotors = LARGEST * row[self.at["self.thrust"]] * attitude[:, 2] - GRAVITY * UP
        asked = self.stiffness * row[self.at["task.reference_position"]]
        asked += self.damping * (SPEED * row[self.at["task.reference_velocity"]] - velocity)
        asked += 5.0 * row[self.at["task.reference_acceleration"]]
        thrust = asked - self.force(name, velocity, rotors) + GRAVITY * UP
        lean = attitude.T @ thrust / np.linalg.norm(thrust)
        share = 2.0 * max(thrust @ attitude[:, 2], 0.0) / LARGEST - 1.0
        rates = 10.0 * np.array([-lean[1], lean[0], 0.0]) / (8.0, 8.0, 4.0)
        return np.clip([share, *rates], -1.0, 1.0).astype(np.float32)

    def force(self, name, velocity, rotors):
        """Return the force beside rotors and gravity, over the mass, m/s^2."""
        force, before = self.known[name]
        if before is not None:
            seen = (velocity - before) / STEP_S - rotors
            force = force + (1.0 - np.exp(-self.rate * STEP_S)) * (seen - force)
        self.known[name] = force, velocity
        return force


class Observer(Feedforward):
    """With what the drone's velocity says of the force on it."""

    stiffness, damping, rate = 18.0, 8.0, 15.0


class Stiff(Observer):
    """As stiff, and as quick to learn the force, as the rotors allow."""

    stiffness, damping, rate = 40.0, 12.0, 60.0
