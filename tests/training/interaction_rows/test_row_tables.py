"""Files of rows: every rule they can break, alone and among sound ones; joining and splitting."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import read_data
from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows
from swarm_envs.training.interaction_rows.row_tables import join_rows

OPTIONS = LogOptions()
Arrays = dict[str, Any]


def some_rows(
    count: int = 1200, seed: int = 0, types: tuple[str, ...] = ("S", "L")
) -> InteractionRows:
    """Rows of two flights of two vehicles aloft, each alone half of the time, forces of some g."""
    rng = np.random.default_rng(seed)
    ego = np.arange(count) % 2
    alone = np.arange(count) // 2 % 2 == 0
    neighbor = rng.uniform(-0.3, 0.3, (count, 1, 6))
    neighbor[alone] = 0.0
    return InteractionRows(
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
        validation=np.arange(count) // 100 % 5 == 0,
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
    (edited("ego_type", lambda e: e + 0.5), "ego_type holds float64, but must hold integers"),
    (edited("force_g", lambda f: f.astype(str)), "force_g holds <U.*, but must hold numbers"),
    (without("step"), "array 'step' is missing; there are"),
    (edited("force_g", lambda f: f * 1000), r"force_g is \S+ at index .* -200 and 200 \(gram-"),
    (edited("position", lambda p: p * 1000), r"position is \S+ at index .* -200 and 200 \(m"),
    (edited("position", lambda p: -p), r"heights must be at least -0\.5 m: z points up"),
    (edited("velocity", lambda v: v * 1000), r"velocity is \S+ at index .* -30 and 30 \(m/s"),
    (edited("neighbor", lambda n: n * 1e4), r"neighbor is \S+ at index .* -400 and 400"),
    (edited("step", at(4, 0)), "step 0 of flight 0 is there 2 times for vehicle 50 .*doubles"),
]


@pytest.mark.parametrize(("edit", "message"), BAD)
def test_a_bad_table_alone_is_an_error_that_names_value_rule_and_fix(
    edit: Callable[[Arrays], Arrays], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "rows.npz"
    np.savez(path, allow_pickle=False, **edit(arrays_of(some_rows(), path)))
    with pytest.raises(ValueError, match=rf"^rows\.npz: .*{message}"):
        read_data(path, OPTIONS)


def test_a_scenario_with_too_few_rows_is_left_out_and_said(tmp_path: Path) -> None:
    rows = some_rows()
    few = rows.select((rows.scenario != 2) | (np.cumsum(rows.scenario == 2) <= 90))
    save_rows(tmp_path / "rows.npz", few)
    used, report = read_data(tmp_path, OPTIONS)
    assert used.scenario_names == ("Ge2S", "Ge2L", "S2L")
    assert len(used) == len(few) - 90
    assert [used.scenario_names[k] for k in used.scenario] == [
        few.scenario_names[k] for k in few.scenario if k != 2
    ]
    said = "\n".join(report.lines())
    assert "left out scenario L2S: it has " in said and "but must have 100; fly it" in said
    assert "rows.npz: 990 of 1080 rows are used (left out: scenario too small: 90)" not in said
    assert f"rows.npz: {len(used)} of {len(few)} rows are used (left out: scenario too" in said


def test_tables_are_joined_with_flights_apart_and_vehicles_matched(tmp_path: Path) -> None:
    first = some_rows(seed=1)
    second = dataclasses.replace(
        some_rows(400, seed=2, types=("XL", "S")), vehicle_names={101: "50", 50: "big"}
    )
    for tables in ([first, second], [first]):
        joined = join_rows(tables)
        assert len(joined) == sum(map(len, tables))
        assert np.array_equal(joined.force_g[:1200], first.force_g)
    joined = join_rows([first, second])
    assert joined.types == ("S", "L", "XL")
    assert np.unique(joined.flight).tolist() == [0, 1, 2, 3]
    names = np.array([joined.vehicle_names[v] for v in joined.vehicle])
    kinds = np.array(joined.types)[joined.ego_type]
    assert set(zip(names, kinds, strict=True)) == {("50", "S"), ("101", "L"), ("big", "XL")}
    assert (names[1200:] == np.where(second.ego_type == 1, "50", "big")).all()
    has = second.has_neighbor[:, 0]
    assert (joined.neighbor_type[1200:, 0][~has] == -1).all()
    expected = np.array(second.types)[second.neighbor_type[has, 0]]
    assert np.array_equal(np.array(joined.types)[joined.neighbor_type[1200:, 0][has]], expected)
    save_rows(tmp_path / "joined.npz", joined)
    assert read_rows(tmp_path / "joined.npz").vehicle_names == joined.vehicle_names


def test_a_number_that_two_types_share_is_two_vehicles() -> None:
    first = some_rows(100)
    second = dataclasses.replace(first, types=("L", "S"))
    joined = join_rows([first, second])
    assert sorted(joined.vehicle_names.values()) == ["101 (L)", "101 (S)", "50 (L)", "50 (S)"]


def test_blocks_are_held_out_with_a_guard_where_nothing_is_marked(tmp_path: Path) -> None:
    long = some_rows(4000)
    unmarked = dataclasses.replace(long, validation=np.zeros(4000, dtype=np.bool_))
    save_rows(tmp_path / "a.npz", unmarked)
    save_rows(tmp_path / "b.npz", some_rows(seed=5))
    options = LogOptions(block_s=2.0, validation_share=0.25, guard_s=0.4, rate_hz=50.0)
    rows, report = read_data(tmp_path, options)
    drawn = np.isin(rows.flight, (0, 1))
    assert np.array_equal(rows.validation[~drawn], some_rows(seed=5).validation)
    assert 0.2 < rows.validation[drawn].mean() < 0.3
    for flight in (0, 1):
        own = rows.select(rows.flight == flight)
        start = long.step[long.flight == flight].min()
        time = (own.step - start) / 50.0
        block = (time / 2.0).astype(int)
        for number in np.unique(block):
            assert np.unique(own.validation[block == number]).size == 1
        apart = np.abs(time[own.validation][:, None] - time[~own.validation])
        assert 0.4 <= apart.min() < 0.5
    file = report.files[0]
    assert file.dropped["guard gap"] == 4000 - int(drawn.sum()) > 0
    again, _ = read_data(tmp_path, dataclasses.replace(options, split_seed=1))
    other = again.select(np.isin(again.flight, (0, 1)))
    assert not np.array_equal(other.step[other.validation], rows.step[drawn & rows.validation])


def test_a_type_that_no_vehicle_has_is_fitted_and_named(tmp_path: Path) -> None:
    save_rows(tmp_path / "a.npz", some_rows(types=("S", "XL")))
    rows, report = read_data(tmp_path, OPTIONS)
    assert rows.types == ("S", "XL")
    assert "a.npz: types 'XL' belong to no vehicle that ships" in report.lines()


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
    with pytest.raises(ValueError, match="has 3 neighbours, but x holds two"):
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
