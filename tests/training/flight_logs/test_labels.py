"""Rows of logs: against the truth, which entries become rows, and which rows are held out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from swarm_envs.training.flight_logs import LogOptions, read_data
from swarm_envs.training.flight_logs.clock import ClockedFlight, kept_entries
from swarm_envs.training.flight_logs.flight_table import from_columns
from swarm_envs.training.interaction_rows.calibration import estimate_offsets
from swarm_envs.training.interaction_rows.hold_out import draw_blocks
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.vehicles import parse_team
from tests.helpers.real_logs import columns_of, write_table

EXACT = LogOptions(smoothing_s=0.0, keep_every=1)


@pytest.mark.parametrize("accelerometer", [True, False])
@pytest.mark.parametrize(
    ("team", "kind"), [("SL", "walk"), ("S", "low-walk"), ("SSL", "swap"), ("S*L", "swap")]
)
def test_labels_are_the_force_that_acted(team, kind, accelerometer, flown, as_table, tmp_path):
    table = as_table(flown(team, kind), team, accelerometer=accelerometer)
    write_table(tmp_path / "flight.csv", table)
    rows, report = read_data(tmp_path / "flight.csv", EXACT)
    (file,) = report
    entries = (100 * file.seconds + 1) * len(file.drones)
    assert file.rows + sum(file.dropped.values()) == pytest.approx(entries)
    truth = modelled_force_g(rows, "learned")
    assert np.abs(truth[:, 2]).max() > 0.3  # there is something to find
    error = rows.force_g - truth
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.05
    assert np.abs(error).max() < 0.5
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_drones_on_clocks_and_signs_of_their_own_give_the_same(flown, as_table, tmp_path):
    """Other rates, times between, quaternions of either sign, drones one after the other."""
    log = flown("SL")
    together = as_table(log, "SL")
    write_table(tmp_path / "together.csv", together)
    large = np.arange(len(together)) % 2 == 1
    keep = ~large | (np.arange(len(together)) // 2 % 5 != 2)  # the large drone's lines: uneven
    order = np.argsort(large[keep], kind="stable")
    apart = {name: values[keep][order] for name, values in columns_of(together).items()}
    flip = np.where(np.arange(len(order)) % 7 < 3, -1.0, 1.0)
    for name in ("qx", "qy", "qz", "qw"):
        apart[name] = apart[name] * flip
    write_table(tmp_path / "apart.csv", from_columns(apart))
    a, _ = read_data(tmp_path / "together.csv", EXACT)
    b, _ = read_data(tmp_path / "apart.csv", EXACT)
    both = np.intersect1d(a.step * 2 + a.ego_type, b.step * 2 + b.ego_type)
    assert len(both) > 0.9 * len(a)
    a, b = (r.select(np.isin(r.step * 2 + r.ego_type, both)) for r in (a, b))
    np.testing.assert_allclose(b.position, a.position, atol=1e-4)
    assert np.sqrt(np.mean((b.force_g - a.force_g) ** 2)) < 0.05


def test_gaps_and_standing_motors_give_no_rows(flown, as_table, tmp_path):
    table = as_table(flown("S"), "S")
    time = table.time - table.time[0]
    gap = (time > 3.0) & (time < 3.5)
    columns = {name: values[~gap] for name, values in columns_of(table).items()}
    time = time[~gap]
    for k in range(1, 5):
        columns[f"pwm{k}"][time > 6.0] = 0.0
    write_table(tmp_path / "a.csv", from_columns(columns))
    rows, report = read_data(tmp_path / "a.csv", EXACT)
    flown_at = rows.step / 100.0
    assert report[0].dropped["force unknown"] > 50
    assert not ((flown_at > 3.01) & (flown_at < 3.5 + 0.3)).any()
    assert flown_at.min() >= 0.3 and flown_at.max() <= 6.01
    assert (rows.force_g[:, 2] ** 2).mean() < 1.0


def test_only_common_time_counts(flown, as_table, tmp_path):
    table = as_table(flown("SL"), "SL")
    early = (table.drone == "cf0") | (table.time < 104.0)
    cut = from_columns({name: values[early] for name, values in columns_of(table).items()})
    write_table(tmp_path / "a.csv", cut)
    rows, report = read_data(tmp_path / "a.csv", EXACT)
    assert rows.step.max() <= 400
    assert report[0].seconds == pytest.approx(4.0, abs=0.05)
    late = dataclasses.replace(table, time=table.time + np.where(table.drone == "cf0", 50.0, 0.0))
    write_table(tmp_path / "b.csv", late)
    said = r"b\.csv: .* have 0\.00 s in common .*one file per flight"
    with pytest.raises(ValueError, match=said):
        read_data(tmp_path / "b.csv", EXACT)


def test_a_vehicle_that_never_flew_quietly_is_named(flown, as_table, tmp_path):
    write_table(tmp_path / "a.csv", as_table(flown("S", "walk", 25.0), "S", names=["known"]))
    log = flown("S")
    east, time = np.array([1.0, 0.0, 0.0]), np.arange(len(log.position))[:, None, None] / 120
    fast = log._replace(position=log.position + east * time, velocity=log.velocity + east)
    write_table(tmp_path / "b.csv", as_table(fast, "S", names=["fast"]))
    rows, _ = read_data(tmp_path)
    with pytest.raises(ValueError, match=r"vehicle 'fast' has \d+ training rows aloft, .* have 30"):
        estimate_offsets(rows)


def test_the_authors_filter():
    near, nan = (0.0, 0.0, 0.3), np.nan
    cases = [  # height, force, shift, reason
        (1.0, -5.0, near, None),
        (1.0, -5.0, (0.35, -0.35, 1.1), None),
        (1.0, -5.0, (0.36, 0.0, 0.3), "no neighbor in the volume"),
        (1.0, -5.0, (0.0, 0.0, -1.2), "no neighbor in the volume"),
        (0.07, -5.0, near, "too low"),
        (0.071, -5.0, near, None),
        (1.0, -50.1, near, "force over 50 g"),
        (0.2, 50.1, near, "force over 50 g"),
        (1.0, 35.1, near, "upward force over 35 g aloft"),
        (0.25, 35.1, near, None),
        (1.0, -49.9, near, None),
        (1.0, nan, near, "force unknown"),
    ]
    heights, forces, shifts, reasons = zip(*cases, strict=True)
    up, count = np.array([0.0, 0.0, 1.0]), len(cases)
    own = np.outer(heights, up)
    position = np.stack([own, np.array([(*s[:2], 0.0) for s in shifts])], axis=1)
    position[:, 1, 2] = np.array(heights) + [shift[2] for shift in shifts]
    none, known = np.zeros(position.shape), np.ones(count, dtype=np.bool_)
    flight = ClockedFlight(
        names=("a", "b"), team=parse_team("SS"), rate_hz=100.0, time=np.arange(count) / 100.0,
        known=known, running=known, position=position, velocity=none, quaternion=none,
        acceleration=None, pwm=none, voltage=none,
    )  # fmt: skip
    force = np.stack([np.outer(forces, up), none[:, 1]], axis=1)
    keep, dropped = kept_entries(flight, force, 0, 1)
    assert np.flatnonzero(keep).tolist() == [k for k, why in enumerate(reasons) if why is None]
    for reason in set(reasons) - {None}:
        assert dropped[reason] == reasons.count(reason)
    assert np.flatnonzero(kept_entries(flight, force, 0, 5)[0]).tolist() == [0, 5, 10]


@pytest.mark.parametrize("lengths", [[1], [2, 1], [5, 5, 5, 5], [3] * 40])
def test_one_in_five_blocks_is_held_out(lengths):
    chosen = draw_blocks(lengths, seed=0)
    assert [len(blocks) for blocks in chosen] == lengths
    count = int(np.concatenate(chosen).sum())
    assert (count >= 1) == (sum(lengths) > 1)
    assert abs(count - sum(lengths) / 5) < 1
    again = draw_blocks(lengths, seed=0)
    assert all((a == b).all() for a, b in zip(chosen, again, strict=True))
