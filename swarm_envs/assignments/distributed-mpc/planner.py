"""Starter: a least-squares path to the goal, shifted away from the other drones."""

import numpy as np

HORIZON, ROUND_S, MAX_ACCELERATION = 15, 0.2, 5.0
CLEARANCE = 0.6  # m; change it
STEPS = np.arange(HORIZON)
# Position and velocity at the end of round k are a free motion plus these matrices times the plan.
TO_VELOCITY = ROUND_S * np.tri(HORIZON)
TO_POSITION = ROUND_S**2 * (np.clip(STEPS[:, None] - STEPS, 0, None) + 0.5) * np.tri(HORIZON)


class MyPlanner:
    """Planner of one drone; every drone has one, in a separate process."""

    def reset(self, drone, goal):
        """Begin an episode with the index of the drone and its goal (3,), m."""
        self.drone, self.goal = drone, goal

    def plan(self, state, goal, heard, ages):
        """Return accelerations (HORIZON, 3), m/s^2; the first is executed, all are broadcast.

        state: (6,) current position and velocity, m and m/s.
        heard: (N, HORIZON, 3) last received plan of each drone as positions, m; NaN if none.
        ages: (N,) rounds since it was made, 1 for the last round; -1 if none.
        """
        free = state[:3] + ROUND_S * (STEPS[:, None] + 1) * state[3:]
        target = goal + self.evasion(state, heard, ages)
        rows = np.concatenate([TO_POSITION, 0.4 * TO_VELOCITY, 0.15 * np.eye(HORIZON)])
        wanted = np.concatenate(
            [target - free, np.tile(-0.4 * state[3:], (HORIZON, 1)), np.zeros((HORIZON, 3))]
        )
        plan, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
        return np.clip(plan, -MAX_ACCELERATION, MAX_ACCELERATION)

    def evasion(self, state, heard, ages):
        """Return an offset (3,) away from the drones that are close now, m."""
        away = np.zeros(3)
        for other, (path, age) in enumerate(zip(heard, ages, strict=True)):
            if other != self.drone and age >= 0:
                offset = state[:3] - path[min(int(age) - 1, HORIZON - 1)]
                distance = np.linalg.norm(offset) + 1e-6
                away += max(CLEARANCE - distance, 0.0) * 2.0 * offset / distance
        return away
