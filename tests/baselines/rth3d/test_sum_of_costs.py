"""Plans of which the sum of costs is small."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import make_instance, plan, validate


@pytest.mark.parametrize("family", ["uniform", "shift"])
def test_the_sum_of_costs_falls_within_the_same_makespan(family):
    instance = make_instance(family, (12, 9, 6), seed=2)
    short, cheap = (
        plan(**instance.fields(), objective=name) for name in ("makespan", "sum_of_costs")
    )
    assert cheap.makespan <= short.makespan and cheap.check()
    least = instance.lengths.sum()
    assert all(found.sum_of_costs == found.check().sum_of_costs for found in (short, cheap))
    before, after = (found.sum_of_costs - least for found in (short, cheap))
    assert 0 <= after < 0.8 * before


def test_an_unknown_objective_is_refused():
    with pytest.raises(ValueError, match="objective"):
        plan([[0, 0]], [[1, 0]], (2, 2), objective="makspan")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_robot_that_collides_a_thousand_times_on_its_way_has_a_cost():
    """Robots join a corridor one by one; costs in 32 bits overflowed."""
    length, count = 1300, 12
    walls = np.ones((length, count + 2, 1), dtype=bool)
    walls[:, 0] = False
    walls[1, : count + 1] = False
    starts = [*([1, k + 1, 0] for k in range(count)), [0, 0, 0]]
    goals = [[length - 1 - k, 0, 0] for k in range(count + 1)]
    found = plan(starts, goals, walls.shape, walls, objective="sum_of_costs")
    assert validate(found.paths, starts, goals, walls.shape, walls)
