"""Derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import LEARNED, ForceField, Numbers
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE, Team

STEP = 1e-5
"""Half width of a central difference, m and m/s."""


def force_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int
) -> FloatArray:
    """Derivative of the forces on every robot by the state of one.

    Where the model has a kink (a ReLU, the end of a measured range, the edge of the interaction
    volume), the derivative of one side, or of central differences a mean.

    Args:
        model: what is believed of the forces.
        team: the N vehicles.
        states: (K, N, 6) positions (m) and velocities (m/s) of all robots at K knots.
        robot: index i of the robot that moves.

    Returns:
        (K, N, 3, 6) d f_a(j) / d x(i): N per m and N per m/s.
    """
    if model.field.kind == LEARNED:
        field = model.with_precision("float64").field
        return deep_set_jacobian(field, model.type_indices(team), states, robot)
    return difference_jacobian(model, team, states, robot)


def difference_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int, step: float = STEP
) -> FloatArray:
    """The same as `force_jacobian` by central differences, of any model.

    Args:
        model: what is believed of the forces.
        team: the N vehicles.
        states: (K, N, 6) positions (m) and velocities (m/s) at K knots.
        robot: index i of the robot that moves.
        step: half width of a difference, m and m/s.
    """
    knots, robots = states.shape[:2]
    moved = np.broadcast_to(states, (2, 6, *states.shape)).copy()
    for k in range(6):
        moved[0, k, :, robot, k] += step
        moved[1, k, :, robot, k] -= step
    flat = moved.reshape(12 * knots, robots, 6)
    forces = model.forces(flat[..., :3], flat[..., 3:], team).reshape(2, 6, knots, robots, 3)
    return np.moveaxis((forces[0] - forces[1]) / (2.0 * step), 0, -1)


class Layer(NamedTuple):
    """One layer of a network."""

    weight: Numbers
    """(inputs, outputs)."""
    bias: Numbers
    """(outputs,)."""


class Pass(NamedTuple):
    """A network applied to R rows, with what its derivative needs."""

    layers: list[Layer]
    """Of the network."""
    active: list[BoolArray]
    """(R, width) which units of each hidden layer are on."""
    output: FloatArray
    """(R, outputs)."""

    def gradient(self, upstream: FloatArray) -> FloatArray:
        """Derivative (R, inputs) of `sum(upstream * output)` by the inputs, row by row."""
        flow = upstream
        for k in range(len(self.layers) - 1, -1, -1):
            flow = flow @ self.layers[k].weight.T
            if k > 0:
                flow = flow * self.active[k - 1]
        return flow


class Pairs(NamedTuple):
    """Ordered pairs inside the interaction volume, R rows over all knots."""

    knot: IntArray
    """Index of the knot of each pair."""
    ego: IntArray
    """Index of the robot that feels."""
    neighbour: IntArray
    """Index of the robot that is felt."""
    offset: FloatArray
    """(R, 6) p_j - p_i and v_j - v_i, m and m/s."""
    weight: FloatArray
    """(R,) the window w."""
    slope: FloatArray
    """(R, 3) its derivative by p_j - p_i, 1/m."""


def network_layers(field: ForceField, n: int) -> list[Layer]:
    """The layers of network `n` of a field, as views."""
    row, columns = field.layout[n], field.layout.shape[1] // 2
    found = []
    for k in range(row[0]):
        inputs, outputs, start = row[1 + k], row[2 + k], row[1 + columns + k]
        middle = start + inputs * outputs
        matrix = field.weights[start:middle].reshape(inputs, outputs)
        found.append(Layer(matrix, field.weights[middle : middle + outputs]))
    return found


def apply(field: ForceField, n: int, inputs: FloatArray) -> Pass:
    """Apply network `n` to rows (R, inputs)."""
    layers, active, x = network_layers(field, n), [], inputs
    for layer in layers[:-1]:
        x = x @ layer.weight + layer.bias
        active.append(x > 0.0)
        x = np.maximum(x, 0.0)
    return Pass(layers, active, x @ layers[-1].weight + layers[-1].bias)


def fade_with_slope(distance: FloatArray, full: float, end: float) -> tuple[FloatArray, FloatArray]:
    """The window's `fade` of distances, and its derivative; 0 where it jumps."""
    width = end - full
    u = np.clip((distance - full) / (width if width > 0.0 else 1.0), 0.0, 1.0)
    if width == 0.0:
        return (distance < end).astype(np.float64), np.zeros_like(distance)
    return 1.0 - u**3 * (10.0 + u * (6.0 * u - 15.0)), -30.0 * (u * (1.0 - u)) ** 2 / width


def find_pairs(field: ForceField, states: FloatArray) -> Pairs:
    """The ordered pairs at all knots (K, N, 6) that the model evaluates."""
    offset = states[:, None, :, :] - states[:, :, None, :]  # [knot, ego, neighbour]
    lateral, vertical = field.window[1], field.window[3]
    near = (np.abs(offset[..., :3]) < (lateral, lateral, vertical)).all(axis=-1)
    near &= ~np.eye(states.shape[1], dtype=np.bool_)
    knot, ego, neighbour = np.nonzero(near)
    rows = offset[knot, ego, neighbour]
    edges = (field.window[:2], field.window[:2], field.window[2:])
    parts = [fade_with_slope(np.abs(rows[:, k]), *edges[k]) for k in range(3)]
    (x, dx), (y, dy), (z, dz) = parts
    slope = np.stack((dx * y * z, x * dy * z, x * y * dz), axis=1) * np.sign(rows[:, :3])
    return Pairs(knot, ego, neighbour, rows, x * y * z, slope)


def deep_set_jacobian(
    field: ForceField, types: IntArray, states: FloatArray, robot: int
) -> FloatArray:
    """Derivative of all forces of a deep set by one robot's state.

    Args:
        field: a deep set's.
        types: (N,) interaction types.
        states: (K, N, 6) positions (m) and velocities (m/s).
        robot: index i.

    Returns:
        (K, N, 3, 6) d f_a(j) / d x(i), N per m and N per m/s.
    """
    knots, robots = states.shape[:2]
    jacobian = np.zeros((knots, robots, 3, 6))
    for k in range(3):
        jacobian[:, robot, k, 3 + k] = -field.drag[types[robot], k]
    pairs, kinds = find_pairs(field, states), field.layout.shape[0] // 2
    passes = [_pair_pass(field, pairs, types, kind) for kind in range(kinds)]
    felt = _felt(field, pairs, states)
    codes = _codes(field, pairs, passes, states)
    upstream = _slopes_of_rho(field, types, codes) * felt[..., None]
    for rows, done in passes:
        _add_pairs(field, pairs, rows, done, upstream, robot, jacobian)
    _add_environment(field, types, states, felt, upstream, robot, jacobian)
    return jacobian


def _pair_pass(
    field: ForceField, pairs: Pairs, types: IntArray, kind: int
) -> tuple[IntArray, Pass]:
    """The rows whose neighbour is of a type, and phi of that type applied to them."""
    rows = np.nonzero(types[pairs.neighbour] == kind)[0]
    low, high = field.pair_range
    return rows, apply(field, kind, np.clip(pairs.offset[rows], low, high))


def _felt(field: ForceField, pairs: Pairs, states: FloatArray) -> BoolArray:
    """Which drones (K, N) feel anything at all."""
    felt = _low(field, states)
    felt[pairs.knot[pairs.weight > 0.0], pairs.ego[pairs.weight > 0.0]] = True
    return felt


def _low(field: ForceField, states: FloatArray) -> BoolArray:
    """Which drones (K, N) fly below the anchor height, or have none."""
    return np.array((field.anchor_height == 0.0) | (states[..., 2] < field.anchor_height))


def _environment_inputs(field: ForceField, states: FloatArray) -> FloatArray:
    """Inputs (..., 4) of phi_env, not clamped; no drone counts as higher than the anchor."""
    height = states[..., 2:3]
    if field.anchor_height > 0.0:
        height = np.minimum(height, field.anchor_height)
    return np.concatenate((-height, -states[..., 3:]), axis=-1)


def _codes(
    field: ForceField,
    pairs: Pairs,
    passes: list[tuple[IntArray, Pass]],
    states: FloatArray,
) -> FloatArray:
    """The inputs of rho (K, N, hidden), of every drone as if it felt something."""
    low, high = field.environment_range
    inputs = np.clip(_environment_inputs(field, states), low, high).reshape(-1, 4)
    codes = apply(field, len(passes), inputs).output.reshape(*states.shape[:2], -1)
    for rows, done in passes:
        shares = pairs.weight[rows, None] * done.output
        np.add.at(codes, (pairs.knot[rows], pairs.ego[rows]), shares)
    return codes


def _slopes_of_rho(field: ForceField, types: IntArray, codes: FloatArray) -> FloatArray:
    """Derivative (K, N, hidden) of each drone's vertical force by its code, N."""
    slopes, half = np.empty_like(codes), field.layout.shape[0] // 2
    for kind in np.unique(types):
        mine = types == kind
        done = apply(field, half + 1 + int(kind), codes[:, mine].reshape(-1, codes.shape[-1]))
        flat = done.gradient(np.full((len(done.output), 1), GRAM_FORCE))
        slopes[:, mine] = flat.reshape(len(codes), -1, codes.shape[-1])
    return slopes


def _add_pairs(
    field: ForceField,
    pairs: Pairs,
    rows: IntArray,
    done: Pass,
    upstream: FloatArray,
    robot: int,
    jacobian: FloatArray,
) -> None:
    """Add what the robot does as a neighbour, and what neighbours do to it, through the pairs."""
    low, high = field.pair_range
    knot, ego = pairs.knot[rows], pairs.ego[rows]
    flow = upstream[knot, ego]
    offset = pairs.offset[rows]
    inside = (offset >= low) & (offset <= high)
    slope = done.gradient(flow * pairs.weight[rows, None]) * inside
    slope[:, :3] += (flow * done.output).sum(axis=1)[:, None] * pairs.slope[rows]
    sign = (pairs.neighbour[rows] == robot) * 1.0 - (ego == robot) * 1.0
    np.add.at(jacobian[:, :, 2], (knot, ego), sign[:, None] * slope)


def _add_environment(
    field: ForceField,
    types: IntArray,
    states: FloatArray,
    felt: BoolArray,
    upstream: FloatArray,
    robot: int,
    jacobian: FloatArray,
) -> None:
    """Add the robot's own height and velocity, through phi_env, to the force on itself."""
    half, (low, high) = field.layout.shape[0] // 2, field.environment_range
    own = states[:, robot]

    def slope(inputs: FloatArray, flow: FloatArray) -> FloatArray:
        done = apply(field, half, np.clip(inputs, low, high))
        return done.gradient(flow) * ((inputs >= low) & (inputs <= high))

    inputs = _environment_inputs(field, own)
    near = slope(inputs, upstream[:, robot])
    near[:, 0] *= _low(field, own)
    jacobian[:, robot, 2, 2] -= near[:, 0]
    jacobian[:, robot, 2, 3:] -= near[:, 1:]
    if field.anchor_height > 0.0:  # what a lone drone at that height would feel is subtracted
        inputs[:, 0] = -field.anchor_height
        alone = apply(field, half, np.clip(inputs, low, high)).output
        flow = _slopes_of_rho(field, types[robot : robot + 1], alone[:, None])[:, 0]
        free = slope(inputs, flow * felt[:, robot, None])
        jacobian[:, robot, 2, 3:] += free[:, 1:]
