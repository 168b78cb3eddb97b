"""Derivatives of the forces by one robot's state: the parts of A_k and C_k, eqs. (15), (16).

The derivative of a deep set (eq. 10) is computed by backpropagation in numpy, for all knots at
once, so that the planner need not import torch. Other models are differentiated by central
differences, for all knots and directions in one call of the compiled kernel.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import DEEP_SET, ForceField, Numbers
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE, Team


def force_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int
) -> FloatArray:
    """Return the derivatives (K, N, 3, 6) of the forces on all robots by the state of one.

    `states` (K, N, 6) are positions (m) and velocities (m/s) of all robots at K knots. [k, j] is
    d f_a(j) / d x(i) for `robot` i, in N per m and N per m/s. At a kink of the model (a ReLU, the
    end of a measured range, the edge of the interaction volume) it is the derivative of one side,
    or a mean of both for central differences.
    """
    if model.field.kind == DEEP_SET:
        field = model.with_precision("float64").field
        return _DeepSet(field, model.type_indices(team), states).jacobian(robot)
    return difference_jacobian(model, team, states, robot)


def difference_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int, step: float = 1e-5
) -> FloatArray:
    """Return the result of `force_jacobian` for any model, by central differences.

    `step` is half the width of a difference, m and m/s.
    """
    knots, robots = states.shape[:2]
    moved = np.broadcast_to(states, (2, 6, *states.shape)).copy()
    for k in range(6):
        moved[0, k, :, robot, k] += step
        moved[1, k, :, robot, k] -= step
    flat = moved.reshape(12 * knots, robots, 6)
    forces = model.forces(flat[..., :3], flat[..., 3:], team).reshape(2, 6, knots, robots, 3)
    return np.moveaxis((forces[0] - forces[1]) / (2.0 * step), 0, -1)


class _Network:
    """Network `n` of a deep set applied to rows (R, inputs), stored for its derivative."""

    def __init__(self, field: ForceField, n: int, inputs: FloatArray) -> None:
        row, columns = field.layout[n], field.layout.shape[1] // 2
        self.weights: list[Numbers] = []
        self.active: list[BoolArray] = []
        x = inputs
        for k in range(row[0]):
            width_in, width, start = row[1 + k], row[2 + k], row[1 + columns + k]
            middle = start + width_in * width
            weight = field.weights[start:middle].reshape(width_in, width)
            x = x @ weight + field.weights[middle : middle + width]
            self.weights.append(weight)
            if k < row[0] - 1:
                self.active.append(x > 0.0)
                x = np.maximum(x, 0.0)
        self.output = x

    def gradient(self, upstream: FloatArray) -> FloatArray:
        """Return the derivative (R, inputs) of `sum(upstream * output)` by the inputs, by row."""
        flow = upstream @ self.weights[-1].T
        for weight, active in zip(self.weights[-2::-1], self.active[::-1]):
            flow = (flow * active) @ weight.T
        return flow


class _DeepSet:
    """A deep set evaluated for states (K, N, 6): the forward pass, stored for its derivatives.

    The rows of the networks phi are the ordered pairs inside the interaction volume at any knot.
    """

    def __init__(self, field: ForceField, types: IntArray, states: FloatArray) -> None:
        self.field, self.types, self.states = field, types, states
        self.kinds = field.layout.shape[0] // 2
        self._find_pairs()
        low, high = field.pair_range
        self.phi = []
        for kind in range(self.kinds):
            rows = np.nonzero(types[self.neighbor] == kind)[0]
            self.phi.append((rows, _Network(field, kind, np.clip(self.offset[rows], low, high))))
        self.below = np.array((field.anchor_height == 0.0) | (states[..., 2] < field.anchor_height))
        self.active = self.below.copy()  # (K, N) True for drones with any force but drag
        self.active[self.knot[self.weight > 0.0], self.ego[self.weight > 0.0]] = True
        self.upstream = self._slopes_of_rho(types, self._codes()) * self.active[..., None]

    def _find_pairs(self) -> None:
        """Find the pairs that the model evaluates: indices, offsets, windows and slopes."""
        offset = self.states[:, None, :, :] - self.states[:, :, None, :]  # [knot, ego, neighbor]
        window = self.field.window
        reach = (window[1], window[1], window[3])
        near = (np.abs(offset[..., :3]) < reach).all(axis=-1)
        near &= ~np.eye(self.states.shape[1], dtype=np.bool_)
        self.knot, self.ego, self.neighbor = np.nonzero(near)
        self.offset = offset[self.knot, self.ego, self.neighbor]
        edges = (window[:2], window[:2], window[2:])
        parts = [_fade_with_slope(np.abs(self.offset[:, k]), *edges[k]) for k in range(3)]
        (x, dx), (y, dy), (z, dz) = parts
        slope = np.stack((dx * y * z, x * dy * z, x * y * dz), axis=1)
        self.weight, self.slope = x * y * z, slope * np.sign(self.offset[:, :3])

    def _environment_inputs(self, states: FloatArray) -> FloatArray:
        """Return inputs (..., 4) of phi_env, not clamped; heights are limited to the anchor's."""
        height = states[..., 2:3]
        if self.field.anchor_height > 0.0:
            height = np.minimum(height, self.field.anchor_height)
        return np.concatenate((-height, -states[..., 3:]), axis=-1)

    def _environment(self, inputs: FloatArray) -> _Network:
        low, high = self.field.environment_range
        return _Network(self.field, self.kinds, np.clip(inputs, low, high))

    def _environment_slope(self, inputs: FloatArray, upstream: FloatArray) -> FloatArray:
        low, high = self.field.environment_range
        inside = (inputs >= low) & (inputs <= high)
        return self._environment(inputs).gradient(upstream) * inside

    def _codes(self) -> FloatArray:
        """Return the inputs of rho (K, N, hidden) of all drones."""
        inputs = self._environment_inputs(self.states).reshape(-1, 4)
        codes = self._environment(inputs).output.reshape(*self.states.shape[:2], -1)
        for rows, phi in self.phi:
            shares = self.weight[rows, None] * phi.output
            np.add.at(codes, (self.knot[rows], self.ego[rows]), shares)
        return codes

    def _slopes_of_rho(self, types: IntArray, codes: FloatArray) -> FloatArray:
        """Return the derivative (K, N, hidden) of each drone's vertical force by its code, N."""
        slopes = np.empty_like(codes)
        for kind in np.unique(types):
            mine, n = types == kind, self.kinds + 1 + int(kind)
            rho = _Network(self.field, n, codes[:, mine].reshape(-1, codes.shape[-1]))
            flat = rho.gradient(np.full((len(rho.output), 1), GRAM_FORCE))
            slopes[:, mine] = flat.reshape(len(codes), -1, codes.shape[-1])
        return slopes

    def jacobian(self, robot: int) -> FloatArray:
        """Return the derivative (K, N, 3, 6) of all forces by one robot's state."""
        jacobian = np.zeros((*self.states.shape[:2], 3, 6))
        for k in range(3):
            jacobian[:, robot, k, 3 + k] = -self.field.drag[self.types[robot], k]
        for rows, phi in self.phi:
            self._add_pairs(rows, phi, robot, jacobian)
        self._add_environment(robot, jacobian)
        return jacobian

    def _add_pairs(self, rows: IntArray, phi: _Network, robot: int, jacobian: FloatArray) -> None:
        """Add the robot's effect on its neighbors, and theirs on it."""
        low, high = self.field.pair_range
        knot, ego, offset = self.knot[rows], self.ego[rows], self.offset[rows]
        flow = self.upstream[knot, ego]
        inside = (offset >= low) & (offset <= high)
        slope = phi.gradient(flow * self.weight[rows, None]) * inside
        slope[:, :3] += (flow * phi.output).sum(axis=1)[:, None] * self.slope[rows]
        sign = (self.neighbor[rows] == robot) * 1.0 - (ego == robot) * 1.0
        np.add.at(jacobian[:, :, 2], (knot, ego), sign[:, None] * slope)

    def _add_environment(self, robot: int, jacobian: FloatArray) -> None:
        """Add the effect of the robot's own height and velocity on the force on itself."""
        inputs = self._environment_inputs(self.states[:, robot])
        near = self._environment_slope(inputs, self.upstream[:, robot])
        near[:, 0] *= self.below[:, robot]
        jacobian[:, robot, 2, 2] -= near[:, 0]
        jacobian[:, robot, 2, 3:] -= near[:, 1:]
        if self.field.anchor_height > 0.0:
            # The model subtracts the force on a lone drone at the anchor's height.
            inputs[:, 0] = -self.field.anchor_height
            alone = self._environment(inputs).output
            flow = self._slopes_of_rho(self.types[robot : robot + 1], alone[:, None])[:, 0]
            free = self._environment_slope(inputs, flow * self.active[:, robot, None])
            jacobian[:, robot, 2, 3:] += free[:, 1:]


def _fade_with_slope(
    distance: FloatArray, full: float, end: float
) -> tuple[FloatArray, FloatArray]:
    """Return the window's `fade` of distances and its derivative, which is 0 at a jump."""
    width = end - full
    u = np.clip((distance - full) / (width if width > 0.0 else 1.0), 0.0, 1.0)
    if width == 0.0:
        return (distance < end).astype(np.float64), np.zeros_like(distance)
    return 1.0 - u**3 * (10.0 + u * (6.0 * u - 15.0)), -30.0 * (u * (1.0 - u)) ** 2 / width
