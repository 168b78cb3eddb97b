"""Files of rows: every rule they can break; joining and splitting."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.state import BoolArray
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import read_data
from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows
from swarm_envs.training.interaction_rows.drone_rows import join_rows, rows_of_drone
from swarm_envs.training.interaction_rows.hold_out import hold_out_blocks
from tests.helpers.tiny_fits import make_rows

Arrays = dict[str, Any]


def some_rows(count: int = 1200, types: tuple[str, ...] = ("S", "L")) -> InteractionRows:
    """Rows of two flights of two vehicles aloft, each alone half of the time, forces of some g."""
    rng = np.random.default_rng(0)
    ego = np.arange(count) % 2
    alone = np.arange(count) // 2 % 2 == 0
    neighbor = rng.uniform(-0.3, 0.3, (count, 1, 6))
    neighbor[alone] = 0.0
    return make_rows(
        count,
        types=types,
        ego_type=ego,
        position=rng.uniform(0.4, 1.2, (count, 3)),
        velocity=rng.uniform(-0.2, 0.2, (count, 3)),
        neighbor=neighbor,
        neighbor_type=np.where(alone, -1, 1 - ego)[:, None],
        force_g=rng.normal(-2.0, 2.0, (count, 3)),
        flight=np.arange(count) * 2 // count,
        step=np.arange(count) // 2 * 3,
        vehicle=np.array([50, 101])[ego],
        scenario=np.where(alone, 0, 2) + ego,
        scenario_names=("Ge2S", "Ge2L", "L2S", "S2L"),
    )


def arrays_of(rows: InteractionRows, path: Path) -> Arrays:
    save_rows(path, rows)
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def edited(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], Arrays]:
    return lambda arrays: arrays | {name: change(arrays[name])}


def at(index: Any, value: object) -> Callable[[Any], Any]:
    def change(array: Any) -> Any:
        array = array.copy()
        array[index] = value
        return array

    return change


def without(name: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {key: value for key, value in arrays.items() if key != name}


BAD: list[tuple[Callable[[Arrays], Arrays], str]] = [
    (edited("force_g", at((7, 2), np.nan)), r"force_g is nan at index \(7, 2\), .*finite; remove"),
    (edited("neighbor", at((3, 0, 4), np.inf)), r"neighbor is inf at index \(3, 0, 4\)"),
    (edited("velocity", lambda v: v[:-1]), r"velocity has shape \(1199, 3\), but must have shape"),
    (edited("position", lambda p: p[:, :2]), r"position has shape \(1200, 2\), but must have"),
    (edited("neighbor_type", lambda k: k[:, 0]), r"neighbor_type has shape \(1200,\), .*\(R, K\)"),
    (edited("neighbor_type", at((5, 0), 2)), r"neighbor_type lies in \[-1, 2\], but must .* 1\]"),
    (edited("ego_type", at(5, -1)), r"ego_type lies in \[-1, 1\]"),
    (edited("ego_type", lambda e: e + 0.5), "ego_type has type float64, but must have integers"),
    (edited("force_g", lambda f: f.astype(str)), "force_g has type <U.*, but must have numbers"),
    (without("step"), "array 'step' is missing; there are"),
    (edited("force_g", lambda f: f * 1000), r"force_g is \S+ at index .* -200 and 200 \(gram-"),
    (edited("position", lambda p: p * 1000), r"position is \S+ at index .* -200 and 200 \(m"),
    (edited("position", lambda p: -p), r"heights must be at least -0\.5 m: z points up"),
    (edited("velocity", lambda v: v * 1000), r"velocity is \S+ at index .* -30 and 30 \(m/s"),
    (edited("neighbor", lambda n: n * 1e4), r"neighbor is \S+ at index .* -400 and 400"),
    (edited("step", at(4, 0)), "step 0 of flight 0 occurs 2 times for vehicle 50 .*duplicates"),
]


@pytest.mark.parametrize(("edit", "message"), BAD)
def test_a_bad_table_is_an_error_that_names_value_rule_and_fix(
    edit: Callable[[Arrays], Arrays], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "rows.npz"
    np.savez(path, allow_pickle=False, **edit(arrays_of(some_rows(), path)))
    with pytest.raises(ValueError, match=rf"^rows\.npz: .*{message}"):
        read_data(path)


def test_blocks_are_held_out_with_a_guard_where_nothing_is_marked(tmp_path: Path) -> None:
    marked = some_rows(12_000)
    assert hold_out_blocks(marked, 100.0, 0) is marked
    unmarked = dataclasses.replace(marked, validation=np.zeros(12_000, dtype=np.bool_))
    save_rows(tmp_path / "a.npz", unmarked)
    options = LogOptions(rate_hz=100.0)
    rows, _ = read_data(tmp_path / "a.npz", options)
    assert 0.15 < rows.validation.mean() < 0.3
    for flight in (0, 1):
        own = rows.select(rows.flight == flight)
        time = (own.step - unmarked.step[unmarked.flight == flight].min()) / 100.0
        block = (time / 5.0).astype(int)
        for number in np.unique(block):
            assert np.unique(own.validation[block == number]).size == 1
        apart = np.abs(time[own.validation][:, None] - time[~own.validation])
        assert 0.5 <= apart.min() < 0.6
    assert 0 < 12_000 - len(rows) < 1000
    again, _ = read_data(tmp_path / "a.npz", dataclasses.replace(options, split_seed=1))
    assert not np.array_equal(again.step[again.validation], rows.step[rows.validation])


def test_types_that_no_row_has_are_left_out_and_others_may_be_invented(tmp_path: Path) -> None:
    rows = some_rows(types=("S", "XL"))
    save_rows(tmp_path / "a.npz", rows)
    assert read_data(tmp_path / "a.npz")[0].types == ("S", "XL")
    alone = rows.select((rows.ego_type == 1) & ~rows.has_neighbor.any(axis=1))
    save_rows(tmp_path / "a.npz", alone)
    found, _ = read_data(tmp_path / "a.npz")
    assert found.types == ("XL",) and not found.ego_type.any()


def test_rows_of_drones_are_joined_with_room_for_all_their_neighbours() -> None:
    rng = np.random.default_rng(0)
    position, velocity, force = rng.uniform(-0.2, 0.2, (3, 50, 3, 3))
    keep: BoolArray = np.asarray(np.arange(50) % 2 == 0)

    def part(i: int, kinds: str, use: BoolArray, **numbers: int) -> InteractionRows:
        p, v, f = (values[:, : len(kinds)] for values in (position, velocity, force))
        return rows_of_drone(i, tuple(kinds), p, v, f, use, **numbers)

    parts = [
        part(0, "S", keep, flight=0, vehicle=7, validation=True),
        part(1, "SLS", ~keep, flight=1, vehicle=101, validation=False),
        part(0, "LL", keep & ~keep, flight=2, vehicle=101, validation=False),
    ]
    rows = join_rows(parts, {7: "cf7"})
    assert rows.scenario_names == ("Ge2S", "SS2L") and rows.vehicle_names == {7: "cf7"}
    assert rows.neighbor_type.tolist() == [[-1, -1]] * 25 + [[0, 0]] * 25
    assert rows.step.tolist() == [*range(0, 50, 2), *range(1, 50, 2)]
    offset = (position[:, 2] - position[:, 1])[1::2]
    np.testing.assert_array_equal(rows.neighbor[25:, 1, :3], offset)
    np.testing.assert_array_equal(rows.force_g[25:], force[1::2, 1])
    assert rows.validation.tolist() == [True] * 25 + [False] * 25


def published(names: tuple[str, ...]) -> Arrays:
    rng, count = np.random.default_rng(0), 900
    x = rng.uniform(-0.3, 0.3, (count, 18)).astype(np.float32)
    x[:, 2] -= 0.8
    fa = rng.normal(-2.0, 2.0, (count, 4)).astype(np.float32)
    scenario = np.arange(count) % len(names)
    cf = np.array([50 if name.endswith("S") else 101 for name in names])[scenario]
    return {"x": x, "fa": fa, "names": np.array(names), "cf": cf, "scenario": scenario,
            "flight": scenario, "step": np.arange(count) * 3,
            "val": np.arange(count) % 300 < 60}  # fmt: skip


def test_the_published_format_names_its_types_by_scenario(tmp_path: Path) -> None:
    path = tmp_path / "rows.npz"
    np.savez(path, **published(("Ge2S", "SL2S", "L2L")))
    rows = read_rows(path)
    assert rows.neighbor_type[:3].tolist() == [[-1, -1], [0, 1], [1, -1]]
    np.savez(path, **without("val")(published(("Ge2S", "SL2S", "L2L"))))
    assert not read_rows(path).validation.any()
    np.savez(path, **published(("Ge2S", "SM2S", "L2L")))
    with pytest.raises(ValueError, match=r"unknown vehicle type 'M' in the scenario 'SM2S'; .*'S'"):
        read_rows(path)
    np.savez(path, **published(("Ge2S", "SLL2S", "L2L")))
    with pytest.raises(ValueError, match="has 3 neighbors, but x has two"):
        read_rows(path)
    np.savez(path, **edited("x", lambda x: x[:, :12])(published(("Ge2S", "L2L"))))
    with pytest.raises(ValueError, match=r"x has shape \(900, 12\) and fa"):
        read_rows(path)


def test_rows_survive_their_file(tmp_path: Path) -> None:
    rows = some_rows(100)
    save_rows(tmp_path / "rows.npz", rows)
    again = read_rows(tmp_path / "rows.npz")
    for entry in dataclasses.fields(rows):
        assert np.array_equal(getattr(again, entry.name), getattr(rows, entry.name)), entry.name
    with pytest.raises(FileNotFoundError, match="no file of interaction rows"):
        read_rows(tmp_path / "none.npz")


def test_errors_stand_beside_trivial_predictors() -> None:
    rows = some_rows(1000)
    label, held_out = rows.force_g[:, 2], rows.validation
    perfect = mean_squared_errors(label, rows)
    assert perfect.overall == 0
    assert perfect.zero == pytest.approx(np.mean(label[held_out] ** 2))
    none = mean_squared_errors(np.zeros(1000), rows)
    assert none.overall == none.zero
    assert none.scenario == none.scenario_zero
    assert 0 < none.scenario_mean < none.zero
