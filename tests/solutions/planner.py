"""Solutions of the assignment `distributed-mpc`: a draft that swerves, and one that constrains."""

import importlib

import numpy as np
import osqp
from scipy import sparse

starter = importlib.import_module("swarm_envs.assignments.distributed-mpc.planner")
HORIZON, ROUND_S = starter.HORIZON, starter.ROUND_S


class Swerving(starter.MyPlanner):
    """Looks ahead along the plans that it has heard, and passes on the right."""

    def evasion(self, state, heard, ages):
        away = np.zeros(3)
        own = (
            state[:3]
            + np.clip(self.goal - state[:3], -1.0, 1.0) * np.linspace(0, 1, HORIZON)[:, None]
        )
        for other, (way, age) in enumerate(zip(heard, ages, strict=True)):
            if other == self.drone or age < 0:
                continue
            there = way[np.minimum(starter.STEPS + int(age), HORIZON - 1)]
            offset = own - there
            distance = np.linalg.norm(offset, axis=1)
            k = int(np.argmin(distance))
            right = np.array([-offset[k][1], offset[k][0], 0.0])
            away += max(0.7 - distance[k], 0.0) * 1.2 * (offset[k] + right) / (distance[k] + 1e-6)
        return away


class Constrained:
    """A quadratic program with a plane between its own plan and each one that it has heard."""

    def reset(self, drone, goal):
        self.drone, self.last = drone, None

    def plan(self, state, goal, heard, ages):
        free = state[:3] + ROUND_S * (starter.STEPS[:, None] + 1) * state[3:]
        before = free if self.last is None else self.last
        rows = np.concatenate(
            [starter.TO_POSITION, 0.8 * starter.TO_VELOCITY, 0.2 * np.eye(HORIZON)]
        )
        speed = np.tile(-0.8 * state[3:], (HORIZON, 1))
        wanted = np.concatenate([goal - free, speed, np.zeros((HORIZON, 3))])
        normals, least = self.planes(before, heard, ages)
        plan = self.solve(rows, wanted, normals, least, free)
        moved = free + starter.TO_POSITION @ plan
        self.last = np.concatenate([moved[1:], moved[-1:]])
        return plan

    def planes(self, before, heard, ages):
        """Directions (M, HORIZON, 3) away from each neighbour, and how far along them, m."""
        normals, least = [], []
        for other, (way, age) in enumerate(zip(heard, ages, strict=True)):
            if other == self.drone or age < 0:
                continue
            there = way[np.minimum(starter.STEPS + int(age), HORIZON - 1)]
            offset = before - there
            offset = offset + 0.4 * np.stack(
                [-offset[:, 1], offset[:, 0], 0 * offset[:, 0]], axis=1
            )
            normal = offset / (np.linalg.norm(offset, axis=1, keepdims=True) + 1e-6)
            normals.append(normal)
            least.append(np.sum(normal * there, axis=1) + 0.42 + 0.02 * (age - 1))
        return np.array(normals).reshape(-1, HORIZON, 3), np.array(least).reshape(-1, HORIZON)

    def solve(self, rows, wanted, normals, least, free):
        """The plan, with planes that give way at a price where they must."""
        size, count = 3 * HORIZON, least.size
        hessian = np.kron(rows.T @ rows, np.eye(3))
        linear = -(rows.T @ wanted).ravel()
        position = np.kron(starter.TO_POSITION, np.eye(3))
        axes = normals.reshape(count, 3)
        steps = np.tile(starter.STEPS, len(normals))
        planes = np.einsum("ci,cij->cj", axes, position.reshape(HORIZON, 3, size)[steps])
        margin = least.ravel() - np.sum(axes * free[steps], axis=1)
        matrix = sparse.csc_matrix(
            np.block(
                [
                    [planes, np.eye(count)],
                    [np.eye(size), np.zeros((size, count))],
                    [np.zeros((count, size)), np.eye(count)],
                ]
            )
        )
        limit = np.full(size, starter.MAX_ACCELERATION)
        low = np.concatenate([margin, -limit, np.zeros(count)])
        high = np.concatenate([np.full(count, np.inf), limit, np.full(count, np.inf)])
        cost = sparse.block_diag([hessian, 1e-3 * sparse.eye(count)], format="csc")
        program = osqp.OSQP()
        price = np.concatenate([linear, np.full(count, 100.0)])
        program.setup(
            sparse.triu(cost, format="csc"),
            price,
            matrix,
            low,
            high,
            verbose=False,
            max_iter=2000,
            eps_abs=1e-4,
            eps_rel=1e-4,
        )
        found = program.solve(raise_error=False).x[:size]
        if not np.isfinite(found).all():
            found = np.zeros(size)
        return np.clip(
            found.reshape(HORIZON, 3), -starter.MAX_ACCELERATION, starter.MAX_ACCELERATION
        )
