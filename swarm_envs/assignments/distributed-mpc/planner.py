"""Starter: the least-squares way to the goal, bent away from the plans that it has heard."""

import numpy as np

HORIZON, ROUND_S, MAX_ACCELERATION = 15, 0.2, 5.0
CLEARANCE = 0.6  # m: yours to choose
STEPS = np.arange(HORIZON)
# Position and velocity at the end of round k are a free motion plus these matrices times the plan.
TO_VELOCITY = ROUND_S * np.tri(HORIZON)
TO_POSITION = ROUND_S**2 * (np.clip(STEPS[:, None] - STEPS, 0, None) + 0.5) * np.tri(HORIZON)


class MyPlanner:
    """Plans for one drone; every drone has one, in a process of its own."""

    def reset(self, drone, goal):
        """An episode begins: which drone this is, and where it is to go, m."""
        self.drone, self.goal = drone, goal

    def plan(self, state, goal, heard, ages):
        """(HORIZON, 3) accelerations, m/s^2; the first is flown for a round, all are announced.

        state: (6,) position and velocity now, m and m/s.
        heard: (N, HORIZON, 3) the last plan heard from each drone, as positions, m; NaN if none.
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
        """Offset away from the drones that are near now, m."""
        away = np.zeros(3)
        for other, (way, age) in enumerate(zip(heard, ages, strict=True)):
            if other != self.drone and age >= 0:
                offset = state[:3] - way[min(int(age) - 1, HORIZON - 1)]
                distance = np.linalg.norm(offset) + 1e-6
                away += max(CLEARANCE - distance, 0.0) * 2.0 * offset / distance
        return away
