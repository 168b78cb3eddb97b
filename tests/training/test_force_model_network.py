"""The deep set: eq. 10 written out in numpy, symmetries, anchor, window, clip, file."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    OUTER_FADE,
    DeepSet,
    DeepSetSpec,
    layers,
)
from swarm_envs.training.force_model.optimisers import hold_spectral_norms
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import RANGE


def network(spec=None, seed=0):
    torch.manual_seed(seed)
    made = DeepSet(spec or DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, 0.6), dtype=torch.float64)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(2.0)  # larger than at the start of training, so that clamps matter
        made.drag[0], made.drag[-1] = torch.tensor([0.01] * 2 + [0.02]), torch.tensor([0.04] * 3)
    return made


def swarm(rng, envs, drones):
    position = rng.uniform(0, 1, (envs, drones, 3)) * [0.5, 0.5, 1.5]
    return torch.from_numpy(position), torch.from_numpy(rng.uniform(-2, 2, position.shape))


def written_out(made, position, velocity, types, i):
    """Equation 10 for one drone of one swarm, with window, clamp, anchor and drag, in numpy."""

    def perceptron(module, x):
        chain = [(m.weight.detach().numpy(), m.bias.detach().numpy()) for m in layers(module)]
        for weight, bias in chain[:-1]:
            x = np.maximum(weight @ x + bias, 0.0)
        return chain[-1][0] @ x + chain[-1][1]

    def step(r, a, b):
        u = min(max((r - a) / (b - a), 0.0), 1.0)
        return 1 - (6 * u**5 - 15 * u**4 + 10 * u**3)

    z, v = min(position[i, 2], 0.6), velocity[i]
    low, high = (np.array(side) for side in RANGE.environment)
    e = perceptron(made.phi_environment, np.clip(-np.array([z, *v]), low, high))
    reference = perceptron(made.phi_environment, np.clip(-np.array([0.6, *v]), low, high))
    low, high = (np.array(side) for side in RANGE.pair)
    h = e.copy()
    for j in range(len(types)):
        if j != i:
            x = np.concatenate([position[j] - position[i], velocity[j] - velocity[i]])
            ax, ay, az = np.abs(x[:3])
            w = step(ax, 0.25, 0.35) * step(ay, 0.25, 0.35) * step(az, 0.8, 1.1)
            h += w * perceptron(made.phi[types[j]], np.clip(x, low, high))
    rho = made.rho[types[i]]
    drag = made.drag.numpy()["SL".index(types[i]), 2] * v[2] / GRAM_FORCE
    return (perceptron(rho, h) - perceptron(rho, reference))[0] - drag


def test_force_is_equation_10_written_out():
    made, team = network(), ("S", "L", "L", "S")
    position, velocity = swarm(np.random.default_rng(0), 6, 4)
    force = made.force_g(position, velocity, team).detach().numpy()
    for e in range(6):
        for i in range(4):
            expected = written_out(made, position[e].numpy(), velocity[e].numpy(), team, i)
            assert force[e, i] == pytest.approx(expected, abs=1e-11)


def test_clip_scales_down_to_the_limit_and_never_up():
    made = network()
    before = [p.detach().clone() for p in made.parameters()]
    hold_spectral_norms(made.parameters(), 1.5)
    clipped = 0
    for old, new in zip(before, made.parameters(), strict=True):
        if old.ndim == 2 and np.linalg.norm(old.numpy(), 2) > 1.5:
            clipped += 1
            assert np.linalg.norm(new.detach().numpy(), 2) == pytest.approx(1.5, rel=1e-9)
            assert torch.allclose(new / new.norm(), old / old.norm())
        else:
            assert torch.equal(new, old)
    assert 0 < clipped < len([p for p in before if p.ndim == 2])


def test_file_gives_back_the_same_function(tmp_path):
    for name, spec in {
        "shipped": None,
        "paper": DeepSetSpec(("S", "L"), EVERYWHERE, None, None),
        "hard": DeepSetSpec(("S", "L", "XL"), None, None, None),
        "pairwise": DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, kind="pairwise"),
    }.items():
        made = network(spec)
        if spec and name in ("hard", "pairwise"):
            made = build(spec, torch.float32 if name == "hard" else torch.float64)
        save_network(tmp_path / f"{name}.safetensors", made, {"seed": 7})
        loaded = load_network(tmp_path / f"{name}.safetensors")
        assert type(loaded) is type(made) and loaded.spec == made.spec
        assert b'\\"seed\\": 7' in (tmp_path / f"{name}.safetensors").read_bytes()
        position, velocity = swarm(np.random.default_rng(6), 10, 3)
        force = loaded.force_g(position, velocity, "SLS")
        assert torch.equal(force, made.double().force_g(position, velocity, "SLS"))
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_missing_or_foreign_weights_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no weights file"):
        load_network(tmp_path / "none.safetensors")
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, tmp_path / "foreign.safetensors")
    with pytest.raises(ValueError, match="format None, but must have 'deep-set-1' or"):
        load_network(tmp_path / "foreign.safetensors")
