"""Solutions of the assignment `swap`: velocity obstacles, seen late, and seen in time."""

import importlib

import numpy as np

starter = importlib.import_module("swarm_envs.assignments.swap.swap")
SPEED, ACCELERATION = starter.SPEED, starter.ACCELERATION
NEIGHBORS = 8


def neighbors(rows, at):
    """Offsets and relative velocities (..., K, 3), m and m/s, and who is there (..., K)."""
    offset = np.stack([rows[..., at[f"neighbor_{k}.position"]] for k in range(NEIGHBORS)], axis=-2)
    moved = np.stack([rows[..., at[f"neighbor_{k}.velocity"]] for k in range(NEIGHBORS)], axis=-2)
    there = np.stack([rows[..., at[f"neighbor_{k}.mask"]] for k in range(NEIGHBORS)], axis=-2)
    return offset, SPEED * moved, there[..., 0] > 0


class Obstacles(starter.MyAgent):
    """The velocity nearest to the wanted one that meets nobody soon, of many tried."""

    requires = {**starter.MyAgent.requires, "num_neighbors": NEIGHBORS, "decision_rate": 20}
    radius, soon_s = 0.34, 1.0

    def act_batch(self, rows):
        way, velocity = rows[..., self.at["task.goal"]], SPEED * rows[..., self.at["self.velocity"]]
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        wanted = 1.5 * way / np.maximum(distance, 1.0)
        offset, moved, there = neighbors(rows, self.at)
        tried = wanted[..., None, :] + self.changes()  # (..., C, 3)
        relative = tried[..., None, :] - (moved + velocity[..., None, :])[..., None, :, :]
        cost = self.danger(offset[..., None, :, :], relative, there[..., None, :])
        cost = cost.max(axis=-1) + np.linalg.norm(tried - wanted[..., None, :], axis=-1)
        chosen = np.argmin(cost, axis=-1)[..., None, None]
        best = np.take_along_axis(tried, chosen, axis=-2)[..., 0, :]
        return np.clip(5.0 * (best - velocity) / ACCELERATION, -1.0, 1.0).astype(np.float32)

    def changes(self):
        """(C, 3) changes of velocity, m/s, those to the right somewhat before the left."""
        rng = np.random.default_rng(0)
        ways = rng.standard_normal((80, 3)) * (1.0, 1.0, 0.7)
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        return np.concatenate([np.zeros((1, 3)), 0.4 * ways, 0.9 * ways, 1.6 * ways, 2.4 * ways])

    def danger(self, offset, relative, there):
        """Return a cost of each neighbor: the sooner it is met, the more."""
        squared = np.sum(relative**2, axis=-1) + 1e-9
        nearest_s = np.clip(np.sum(offset * relative, axis=-1) / squared, 0.0, self.soon_s)
        least = np.linalg.norm(offset - nearest_s[..., None] * relative, axis=-1)
        inside = np.maximum(self.radius - least, 0.0)
        return np.where(there & (inside > 0.0), 3.0 + 20.0 * inside + 2.0 * (1.0 - nearest_s), 0.0)


class Late(Obstacles):
    """Sees half as far ahead, and keeps less room."""

    radius, soon_s = 0.26, 0.45
