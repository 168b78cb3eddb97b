"""Lipschitz constants of a force network: an analytic bound, and what sampling finds.

They are given of two functions: the force against one neighbor's relative position (g/m), and
against the whole input of one or two neighbors, positions in m and velocities in m/s joined (g per
unit). The measured force changes by 100-150 g/m.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from swarm_envs.interactions.composed import AXIS_RADIUS
from swarm_envs.interactions.field import LOWEST_HEIGHT, ONSET, UNITS_OF_OWN, UNITS_OF_PAIR
from swarm_envs.training.force_model.composed import Composed
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    Batch,
    DeepSet,
    ForceNetwork,
    layers,
)
from swarm_envs.training.interaction_rows import NO_NEIGHBOR


def random_inputs(types: int, count: int, neighbors: int, rng: np.random.Generator) -> Batch:
    """Draw float64 inputs that cover the volume and the places where the force changes most.

    Neighbours stand uniformly in the interaction volume; for a third they stand within some
    8 cm of the axis, for a tenth on it, for a tenth at rest. Heights lie from 7 cm to 1.5 m, half
    of them below 0.6 m. Types are drawn uniformly for the drone and its neighbours.
    """
    speed = np.array([0.7, 0.7, 1.0])
    pair = rng.uniform(-1.0, 1.0, (count, neighbors, 6)) * [0.36, 0.36, 1.12, 1.1, 1.1, 1.2]
    near = rng.random((count, neighbors)) < 1 / 3
    pair[near, :2] = rng.normal(0.0, 0.08, (int(near.sum()), 2))
    pair[rng.random((count, neighbors)) < 0.1, :2] = 0.0
    pair[rng.random((count, neighbors)) < 0.1, 3:] = 0.0
    height = np.where(
        rng.random(count) < 0.5, rng.uniform(0.07, 0.6, count), rng.uniform(0.6, 1.5, count)
    )
    velocity = rng.uniform(-1.0, 1.0, (count, 3)) * speed
    velocity[rng.random(count) < 0.1] = 0.0
    environment = -np.concatenate([height[:, None], velocity], axis=1)
    kind = rng.integers(types, size=(count, neighbors))
    kind[rng.random(count) < 0.5, 1:] = NO_NEIGHBOR
    return Batch(
        ego_type=torch.from_numpy(rng.integers(types, size=count)),
        environment=torch.from_numpy(environment),
        pair=torch.from_numpy(pair),
        pair_type=torch.from_numpy(kind),
    )


def input_gradient(network: ForceNetwork, batch: Batch) -> tuple[Tensor, Tensor]:
    """Return the gradient of the force against the environment's inputs and the neighbors'.

    Their shapes are (R, 4) and (R, K, 6), in g per m and g per m/s.
    """
    environment = batch.environment.detach().requires_grad_(True)
    pair = batch.pair.detach().requires_grad_(True)
    force = network(batch._replace(environment=environment, pair=pair))
    at_environment, at_pair = torch.autograd.grad(force.sum(), (environment, pair))
    return at_environment, at_pair


def joint_norm(environment: Tensor, pair: Tensor) -> Tensor:
    """Euclidean norm (R,) of the inputs (R, 4) and (R, K, 6) joined."""
    norm: Tensor = torch.linalg.vector_norm(torch.cat([environment, pair.flatten(1)], 1), dim=1)
    return norm


_STEEPEST = 1.875  # largest slope of the quintic step over its width
_CHUNK = 20000


BOUNDS = ("position_g_per_m", "input_g_per_unit", "input_two_neighbors_g_per_unit")
"""Upper bounds, window included: against one neighbour's relative position, and against the whole
input with one and with two neighbours."""
FOUND = (
    "position_gradient_g_per_m",
    "input_gradient_g_per_unit",
    "pair_ratio_g_per_m",
    "input_ratio_g_per_unit",
)
"""Largest constants found by sampling: norms of the gradient, and |f(x) - f(x')| / |x - x'| where
only the neighbour's relative position differs, or the whole input."""


def spectral_product(network: nn.Module) -> float:
    """Product of the spectral norms of a perceptron's weight matrices."""
    norms = [torch.linalg.matrix_norm(layer.weight.detach(), 2) for layer in layers(network)]
    return math.prod(float(norm) for norm in norms)


def lipschitz_bound(network: ForceNetwork) -> dict[str, float]:
    """Bound the shipped function: with window w, |d(w phi)/dp| <= Lip(phi) + |dw/dp| sup|phi|.

    A neighbor of a deep set acts through L = Lip(rho) (Lip(phi) + |dw| sup|phi|), the environment
    through M = Lip(rho) Lip(phi_env), twice where an anchor is subtracted. Each has inputs of its
    own, so K neighbors and the environment together have at most sqrt(K L^2 + M^2). A network
    without a finite input range has no bound with a window: infinity. The hard cut-off is no
    Lipschitz function: infinity too.
    """
    if isinstance(network, Composed):
        return _composed_bound(network)
    assert isinstance(network, DeepSet)
    outer = max(spectral_product(module) for module in network.rho.values())
    pairs, grounds = list(network.phi.values()), [network.phi_environment]
    pair = outer * max(_windowed(network, module) for module in pairs)
    ground = outer * max(spectral_product(module) for module in grounds)
    if network.spec.anchor_height_m is not None:
        ground *= 2.0  # both the force and the baseline move with the velocity
    return _bounds(pair, ground, ground)


def _bounds(pair: float, ground: float, ground_of_two: float) -> dict[str, float]:
    both = math.hypot(math.sqrt(2.0) * pair, ground_of_two)
    return dict(zip(BOUNDS, (pair, math.hypot(pair, ground), both), strict=True))


def _composed_bound(network: Composed) -> dict[str, float]:
    """The bound of a composed model.

    The norm that joins pushes has slope 1 in each of them, the mitigation is at most 1, and changes
    with height by M / h exp(-0.07 m / h) of what pushes. Near the axis of a wake, v_r and v_t
    change with position by the relative speed over the radius of the axis.
    """
    edge, steep, largest = _window_slope(network), 0.0, 0.0
    for i in range(len(network.types)):
        for j in range(len(network.types)):
            slope, top = _push_bounds(network, i, j)
            steep, largest = max(steep, slope), max(largest, top)
    _, lost, height = (float(value.detach()) for value in network.joined_by())
    by_height = lost / height * math.exp(-LOWEST_HEIGHT / height) * largest
    ground = max(spectral_product(module) for module in network.own) / min(UNITS_OF_OWN)
    if network.spec.anchor_height_m is not None:
        ground *= 2.0
    pair = steep + edge * largest if edge else steep
    return _bounds(pair, ground + by_height, ground + 2.0 * by_height)


@torch.no_grad()
def _push_bounds(network: Composed, upper: int, lower: int) -> tuple[float, float]:
    """Bounds of the slope, g per unit of input, and of the size, g, of one pair's push."""
    amplitude, start, spread, decay = (float(value) for value in network.wake(upper, lower))
    delay, module = float(network.delay()[upper]), network.pair[upper * len(network.types) + lower]
    units, product = torch.tensor(UNITS_OF_PAIR), spectral_product(module)
    high = network.pair_high
    speed = math.sqrt(2.0) * float(high[3])
    shift = delay * max(speed, float(high[2]))  # of the axis, by depth and by the wind
    inputs = [1.0 + shift, 1.0, speed / AXIS_RADIUS * (1.0 + shift) + 1.0, 1.0]
    inputs.insert(2, inputs[2])
    steepness = product * math.hypot(*(x / float(u) for x, u in zip(inputs, units, strict=True)))
    beside = amplitude * math.exp(-0.5) / start * (1.0 + shift)
    below = amplitude * (0.25 / ONSET + spread * (decay + 2.0 / math.e) / start)
    centre = float(module(torch.zeros(1, len(units), dtype=high.dtype))[0, 0].abs())
    farthest = [float(torch.linalg.vector_norm(high[:2])), float(high[2]), *[float(high[3])] * 2]
    radius = math.hypot(*(x / float(u) for x, u in zip([*farthest, float(high[5])], units)))
    return steepness + math.hypot(beside, below), amplitude + centre + product * radius


def _windowed(network: ForceNetwork, module: nn.Module) -> float:
    """Bound of w times a perceptron of a pair, over the pair's six inputs."""
    slope, steepness = _window_slope(network), spectral_product(module)
    if slope == 0.0 or math.isinf(slope):
        return steepness + slope
    return steepness + slope * _largest_output(network, module)


def _window_slope(network: ForceNetwork) -> float:
    if network.spec.window is None:
        return math.inf
    if network.spec.window == EVERYWHERE:
        return 0.0
    lateral, vertical = network.spec.window
    slopes = (_STEEPEST / (outer - inner) for inner, outer in (lateral, lateral, vertical))
    return math.hypot(*slopes)


def _largest_output(network: ForceNetwork, module: nn.Module) -> float:
    low, high = network.pair_low, network.pair_high
    if not bool(torch.isfinite(low).all() & torch.isfinite(high).all()):
        return math.inf
    with torch.no_grad():
        centre = float(torch.linalg.vector_norm(module((low + high) / 2)))
    radius = float(torch.linalg.vector_norm((high - low) / 2))
    return centre + spectral_product(module) * radius


def measure_lipschitz(
    network: ForceNetwork, samples: int, neighbors: int, rng: np.random.Generator
) -> dict[str, float]:
    """Search the constants of a float64 network by gradient and by random pairs, so many `samples`.

    Half of the pairs are two independent inputs, half differ by a step of 0.1 mm to 0.1 m in a
    random direction. The gradient is taken by autograd at each pair's first input.
    """
    best = np.zeros(4)
    for begin in range(0, samples, _CHUNK):
        count = min(_CHUNK, samples - begin)
        best = np.maximum(best, _search(network, count, neighbors, rng))
    return dict(zip(FOUND, best.tolist(), strict=True))


def _search(
    network: ForceNetwork, count: int, neighbors: int, rng: np.random.Generator
) -> tuple[float, float, float, float]:
    first = random_inputs(len(network.types), count, neighbors, rng)
    second = _second_inputs(first, rng)
    at_environment, at_pair = input_gradient(network, first)
    moved = first.pair.clone()
    moved[:, 0, :3] = second.pair[:, 0, :3]
    with torch.no_grad():
        force = network(first)
        force_moved = network(first._replace(pair=moved))
        force_other = network(second)
    distance = torch.linalg.vector_norm((moved - first.pair)[:, 0, :3], dim=1)
    whole = joint_norm(second.environment - first.environment, second.pair - first.pair)
    return (
        float(torch.linalg.vector_norm(at_pair[..., :3], dim=-1).max()),
        float(joint_norm(at_environment, at_pair).max()),
        float(((force_moved - force).abs() / distance).max()),
        float(((force_other - force).abs() / whole).max()),
    )


def _second_inputs(first: Batch, rng: np.random.Generator) -> Batch:
    count, neighbors = first.pair_type.shape
    far = random_inputs(1, count, neighbors, rng)
    size = torch.from_numpy(10.0 ** rng.uniform(-4.0, -1.0, (count, 1)))
    direction = torch.from_numpy(rng.normal(size=(count, 4 + 6 * neighbors)))
    step = size * direction / torch.linalg.vector_norm(direction, dim=1, keepdim=True)
    near = torch.from_numpy(rng.random(count) < 0.5)
    close_environment = first.environment + step[:, :4]
    close_pair = first.pair + step[:, 4:].reshape(first.pair.shape)
    return first._replace(
        environment=torch.where(near[:, None], close_environment, far.environment),
        pair=torch.where(near[:, None, None], close_pair, far.pair),
    )
