"""Lipschitz constants of a deep set as it ships: an analytic bound, and what sampling finds.

Two functions: the force against one neighbour's relative position (g/m), and against the whole
input of one or two neighbours, positions in m and velocities in m/s joined (g per unit).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    Batch,
    DeepSet,
    ForceNetwork,
    layers,
)
from swarm_envs.training.force_model.pairwise import PairwiseSum
from swarm_envs.training.force_model.smoothness import (
    input_gradient,
    joint_norm,
    random_inputs,
)

_STEEPEST = 1.875  # largest slope of the quintic step over its width
_CHUNK = 20000


@dataclass(frozen=True)
class LipschitzBound:
    """Upper bounds from products of spectral norms, window included."""

    position_g_per_m: float
    """Against one neighbour's relative position."""
    input_g_per_unit: float
    """Against the whole input with one neighbour."""
    input_two_neighbors_g_per_unit: float
    """Against the whole input with two neighbours."""


@dataclass(frozen=True)
class MeasuredLipschitz:
    """Largest constants found by sampling."""

    position_gradient_g_per_m: float
    """Norm of the gradient against one neighbour's relative position."""
    input_gradient_g_per_unit: float
    """Norm of the gradient against the whole input."""
    pair_ratio_g_per_m: float
    """|f(x) - f(x')| / |x - x'| where only the neighbour's relative position differs."""
    input_ratio_g_per_unit: float
    """The same where the whole input differs."""


def spectral_product(network: nn.Module) -> float:
    """Product of the spectral norms of a perceptron's weight matrices."""
    norms = [torch.linalg.matrix_norm(layer.weight.detach(), 2) for layer in layers(network)]
    return math.prod(float(norm) for norm in norms)


def lipschitz_bound(network: ForceNetwork) -> LipschitzBound:
    """Bound the shipped function: with window w, |d(w phi)/dp| <= Lip(phi) + |dw/dp| sup|phi|.

    A neighbour acts through L = Lip(rho) (Lip(phi) + |dw| sup|phi|), in a sum over pairs without
    rho; the environment through M = Lip(rho) Lip(phi_env), twice where an anchor is subtracted.
    Each stands in inputs of its own, so K neighbours and the environment together have at most
    sqrt(K L^2 + M^2). A network without a finite input range has no bound with a window: infinity.
    The hard cut-off is no Lipschitz function: infinity too.
    """
    if isinstance(network, PairwiseSum):
        outer, pairs = 1.0, [network.network_of(a, b) for a in network.types for b in network.types]
        grounds = list(network.environment.values())
    else:
        assert isinstance(network, DeepSet)
        outer = max(spectral_product(module) for module in network.rho.values())
        pairs, grounds = list(network.phi.values()), [network.phi_environment]
    pair = outer * max(_windowed(network, module) for module in pairs)
    ground = outer * max(spectral_product(module) for module in grounds)
    if network.spec.anchor_height_m is not None:
        ground *= 2.0  # both the force and the baseline move with the velocity
    return LipschitzBound(pair, math.hypot(pair, ground), math.hypot(math.sqrt(2.0) * pair, ground))


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
) -> MeasuredLipschitz:
    """Search the constants of a float64 network by gradient and by random pairs.

    Half of the pairs are two independent inputs, half differ by a step of 0.1 mm to 0.1 m in a
    random direction. The gradient is taken by autograd at each pair's first input.

    Args:
        network: float64, as `load_network` returns it.
        samples: how many pairs.
        neighbors: how many neighbours each input has, at least 1.
        rng: source of every draw.
    """
    best = np.zeros(4)
    for begin in range(0, samples, _CHUNK):
        count = min(_CHUNK, samples - begin)
        best = np.maximum(best, _search(network, count, neighbors, rng))
    return MeasuredLipschitz(*(float(value) for value in best))


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
