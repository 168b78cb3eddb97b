"""The tables of the state: the memory that kernels copy by columns is the one that users read."""

from __future__ import annotations

import numpy as np

from swarm_envs.tables import (
    ADAPTATION_END,
    BLOCK_TYPE,
    BODY_END,
    CONTROLLER_END,
    DRONE,
    DRONE_TYPE,
    ENVIRONMENT,
    HALL_ENDS,
    LANES,
    RESET_COLUMNS,
    RESET_VALUES,
    VEHICLE_END,
    World,
    clear_environments,
    new_world,
)


def filled() -> World:
    """Two environments of three drones, with other numbers in every place."""
    rng, world = np.random.default_rng(0), new_world(2, 3, 4)
    world.columns[...] = rng.normal(size=world.columns.shape)
    world.goals[...] = rng.normal(size=world.goals.shape)
    for name in world.environments.dtype.names or ():
        world.environments[name] = rng.integers(1, 9, world.environments[name].shape)
    return world


def test_drones_are_rows_of_float64():
    """Without gaps: the columns are all that there is."""
    world = filled()
    assert world.columns.shape == (2, 3, DRONE_TYPE.itemsize // 8)
    assert np.shares_memory(world.columns, world.drones)
    parts = [world.drones[field.name].reshape(2, 3, -1) for field in DRONE]
    np.testing.assert_array_equal(np.concatenate(parts, axis=-1), world.columns)


def test_a_copy_is_independent():
    world = filled()
    twin = world.copy()
    for mine, theirs in zip(world, twin, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert not np.shares_memory(mine, theirs)
    assert np.shares_memory(twin.columns, twin.drones)


def test_a_block_begins_with_the_columns_of_a_drone():
    """In their order, each with a number for every lane: `load` and `store` copy by columns."""
    block = np.zeros(1, BLOCK_TYPE)
    rows = block.view(np.float64).reshape(-1, LANES)
    last = HALL_ENDS[1]
    rows[:last] = np.arange(last)[:, None] + np.linspace(0.0, 0.5, LANES)
    drone = np.zeros(1, DRONE_TYPE)
    drone.view(np.float64)[:last] = np.arange(last)
    shared = [name for name in BLOCK_TYPE.names or () if name in (DRONE_TYPE.names or ())]
    assert sum(np.size(drone[0][name]) for name in shared) == last
    for name in shared:
        expected = np.asarray(drone[0][name])[..., None] + np.linspace(0.0, 0.5, LANES)
        np.testing.assert_array_equal(block[0][name], expected)
    places = {name: offset // 8 for name, (_, offset, *_) in (DRONE_TYPE.fields or {}).items()}
    assert places["setpoint_position"] == BODY_END
    assert places["mass"] == CONTROLLER_END
    assert places["adaptive_force"] == VEHICLE_END
    assert places["residual_process"] == ADAPTATION_END
    assert (places["residual_quiet"], places["battery_capacity"]) == HALL_ENDS


def test_a_reset_sets_what_says_so_and_leaves_the_rest():
    world, before = filled(), filled()
    world.columns[1][:, RESET_COLUMNS] = RESET_VALUES
    clear_environments(world.environments, np.array([1]))
    for records, old, table in (
        (world.drones, before.drones, DRONE),
        (world.environments, before.environments, ENVIRONMENT),
    ):
        for field in table:
            np.testing.assert_array_equal(records[field.name][0], old[field.name][0])
            wanted = old[field.name][1] if field.reset is None else field.reset
            assert (records[field.name][1] == wanted).all(), field.name
