"""Solutions of the assignment `learning`: what is searched is how a velocity obstacle is kept."""

import importlib

import numpy as np

starter = importlib.import_module("swarm_envs.assignments.learning.learner")
SPEED, ACCELERATION = starter.SPEED, starter.ACCELERATION
_RNG = np.random.default_rng(0)
_WAYS = _RNG.standard_normal((40, 3))
_WAYS /= np.linalg.norm(_WAYS, axis=1, keepdims=True)
CHANGES = np.concatenate([np.zeros((1, 3)), 0.5 * _WAYS, 1.2 * _WAYS, 2.2 * _WAYS])  # m/s


class Searched(starter.MyLearner):
    """Takes the velocity nearest to the wanted one that meets nobody soon."""

    changes = CHANGES  # (C, 3) what is tried besides the wanted velocity, m/s

    def __init__(self):
        self.gains = np.array([1.5, 5.0, 0.3, 0.8])  # speed, 1/s, m, s

    def decide(self, rows, gains):
        speed, gain, radius, soon_s = gains
        way, velocity = rows[..., self.at["task.goal"]], SPEED * rows[..., self.at["self.velocity"]]
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        wanted = speed * way / np.maximum(distance, 1.0)
        tried = wanted[..., None, :] + self.changes
        cost = np.linalg.norm(self.changes, axis=-1)
        for k in range(starter.NEIGHBORS):
            offset = rows[..., None, self.at[f"neighbor_{k}.position"]]
            moved = SPEED * rows[..., self.at[f"neighbor_{k}.velocity"]] + velocity
            relative = tried - moved[..., None, :]
            squared = np.sum(relative**2, axis=-1) + 1e-9
            when = np.clip(np.sum(offset * relative, axis=-1) / squared, 0.0, soon_s)
            least = np.linalg.norm(offset - when[..., None] * relative, axis=-1)
            inside = np.maximum(radius - least, 0.0) * rows[..., self.at[f"neighbor_{k}.mask"]]
            cost = np.maximum(cost, (inside > 0) * (3.0 + 20.0 * inside))
        best = np.take_along_axis(tried, np.argmin(cost, axis=-1)[..., None, None], axis=-2)
        return np.clip(gain * (best[..., 0, :] - velocity) / ACCELERATION, -1, 1).astype(np.float32)


_ANGLES = np.arange(8) * np.pi / 4
_LEVEL = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(8)], axis=1)


class Level(Searched):
    """A draft: tries few velocities, all at the same climb rate."""

    changes = np.concatenate([np.zeros((1, 3)), 0.5 * _LEVEL, 1.2 * _LEVEL])
