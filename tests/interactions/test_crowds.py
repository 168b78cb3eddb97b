"""What `learned` promises in crowds, which no flight had: nobody is lifted, the mean is sound.

Pairs are evaluated alone, through `forces`, so nothing here depends on how they are joined.
"""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE

CROWDS = 40


def crowd(drones: int, speed: float, lowest: float) -> tuple[FloatArray, FloatArray]:
    """Drones all of which share one interaction volume, at rest or moving."""
    rng = np.random.default_rng([drones, int(10 * speed)])
    position = rng.uniform(0.0, 1.0, (CROWDS, drones, 3)) * [0.7, 0.7, 1.1]
    position[..., 2] += lowest
    return position, rng.uniform(-speed, speed, position.shape)


def summed_pairs(
    model: InteractionModel, position: FloatArray, velocity: FloatArray, team: str
) -> FloatArray:
    """(E, N) vertical force, g, if the neighbours' forces on a drone merely added up."""
    total = np.zeros(position.shape[:2])
    for i, own in enumerate(team):
        alone = model.forces(position[:, [i]], velocity[:, [i]], own)[:, 0, 2]
        total[:, i] = alone
        for j, other in enumerate(team):
            if j != i:
                pair = position[:, [i, j]], velocity[:, [i, j]]
                total[:, i] += model.forces(*pair, own + other)[:, 0, 2] - alone
    return total / GRAM_FORCE


@pytest.mark.parametrize("speed", [0.0, 0.7])
@pytest.mark.parametrize("kinds", ["S", "L", "SL"])
@pytest.mark.parametrize("drones", [3, 5, 8, 16])
def test_nobody_whom_pairs_push_down_is_lifted(drones: int, kinds: str, speed: float) -> None:
    model, team = load("learned"), (kinds * drones)[:drones]
    for lowest in (0.1, 0.7):
        position, velocity = crowd(drones, speed, lowest)
        force = model.forces(position, velocity, team) / GRAM_FORCE
        pairs = summed_pairs(model, position, velocity, team)
        pushed = pairs < -2.0
        assert pushed.any()
        assert not (force[..., 2][pushed] > 0.0).any()
        wake = load("wake").forces(position, velocity, team)[..., 2].mean() / GRAM_FORCE
        least, most = sorted([wake, pairs.mean()])
        assert least - 0.3 <= force[..., 2].mean() <= most + 0.3
        assert np.hypot(force[..., 0], force[..., 1]).max() < 3.0 * drones


def test_more_neighbours_never_push_less() -> None:
    model, (position, velocity) = load("learned"), crowd(8, 0.4, 0.7)
    before = model.forces(position[:, :1], velocity[:, :1], "S")[:, 0, 2]
    for count in range(2, 9):
        team = "SL" * 4
        now = model.forces(position[:, :count], velocity[:, :count], team[:count])[:, 0, 2]
        assert (now <= before + 1e-12).all()
        before = now
    assert (before < -GRAM_FORCE).any()


@pytest.mark.parametrize(("pair", "pull"), [("LL", 2.5), ("LS", 1.7), ("SS", 0.3)])
def test_the_air_pulls_towards_the_axis(pair: str, pull: float) -> None:
    """The lower drone first; means of the measured flights at 8 to 13 cm, in grams."""
    beside = np.linspace(0.08, 0.13, 6)
    position = np.zeros((6, 2, 3))
    position[:, 1, 0], position[:, :, 2] = beside, [1.0, 1.35]
    force = load("learned").forces(position, np.zeros_like(position), pair)[:, 0] / GRAM_FORCE
    assert force[:, 0].mean() == pytest.approx(pull, abs=0.6)
    np.testing.assert_allclose(force[:, 1], 0.0, atol=1e-12)
