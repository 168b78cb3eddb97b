"""The analytic Lipschitz bound, window included: never below what can be measured."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.lipschitz import lipschitz_bound, measure_lipschitz
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    OUTER_FADE,
    DeepSetSpec,
    ForceNetwork,
    NetworkKind,
    layers,
)
from tests.helpers.tiny_fits import RANGE

KINDS: tuple[NetworkKind, ...] = ("deep-set", "pairwise")
ALL: tuple[NetworkKind, ...] = (*KINDS, "composed")


def random_network(spec: DeepSetSpec, seed: int, scale: float) -> ForceNetwork:
    torch.manual_seed(seed)
    made = build(spec, torch.float64)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(scale)
    return made


def holds(network: ForceNetwork, samples: int = 3000) -> None:
    bound = lipschitz_bound(network)
    for neighbors, whole in (
        (1, bound["input_g_per_unit"]),
        (2, bound["input_two_neighbors_g_per_unit"]),
    ):
        found = measure_lipschitz(network, samples, neighbors, np.random.default_rng(neighbors))
        assert 0.0 < found["position_gradient_g_per_m"] <= bound["position_g_per_m"]
        assert 0.0 < found["pair_ratio_g_per_m"] <= bound["position_g_per_m"]
        assert 0.0 < found["input_gradient_g_per_unit"] <= whole
        assert 0.0 < found["input_ratio_g_per_unit"] <= whole


@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("anchor", [0.6, None])
def test_random_networks_keep_to_the_bound(
    kind: NetworkKind, scale: float, anchor: float | None
) -> None:
    for seed in range(3):
        spec = DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, anchor, layers=2 + seed, kind=kind)
        holds(random_network(spec, seed, scale))


@pytest.mark.parametrize("kind", KINDS)
def test_the_papers_form_keeps_to_the_bound_of_its_weights_alone(kind: NetworkKind) -> None:
    network = random_network(DeepSetSpec(("S",), EVERYWHERE, None, None, kind=kind), 0, 2.0)
    holds(network)
    norms = [
        math.prod(float(np.linalg.norm(layer.weight.detach().numpy(), 2)) for layer in layers(m))
        for m in network.named_networks().values()
    ]
    pair = norms[0] * (norms[2] if kind == "deep-set" else 1.0)
    assert lipschitz_bound(network)["position_g_per_m"] == pytest.approx(pair)


@pytest.mark.parametrize("kind", KINDS)
def test_a_constant_force_leaves_the_slope_of_the_window(kind: NetworkKind) -> None:
    """A perceptron that always says 4 g: all slope is the window's, 1.875 times 4 g over 0.1 m."""
    spec = DeepSetSpec(("S",), OUTER_FADE, RANGE, None, hidden=1, layers=2, kind=kind)
    network = random_network(spec, 0, 0.0)
    with torch.no_grad():
        last = layers(network.named_networks()["phi.S" if kind == "deep-set" else "pair.S.S"])[-1]
        last.bias[0] = 4.0
        if kind == "deep-set":  # rho: the identity where its input is positive
            for layer in layers(network.named_networks()["rho.S"]):
                layer.weight[0, 0] = 1.0
    bound = lipschitz_bound(network)["position_g_per_m"]
    found = measure_lipschitz(network, 20_000, 1, np.random.default_rng(0))
    assert bound == pytest.approx(4.0 * 1.875 * math.hypot(10.0, 10.0, 10.0 / 3.0))
    assert 0.9 * 75.0 < found["position_gradient_g_per_m"] <= bound


def test_no_finite_range_or_a_hard_edge_has_no_bound() -> None:
    spec = DeepSetSpec(("S",), OUTER_FADE, None, 0.6)
    assert math.isinf(lipschitz_bound(build(spec))["position_g_per_m"])
    spec = dataclasses.replace(spec, window=None, input_range=RANGE)
    assert math.isinf(lipschitz_bound(build(spec))["input_g_per_unit"])
