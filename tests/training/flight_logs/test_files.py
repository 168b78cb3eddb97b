"""The file of a log: round trips, and every rule that it can break."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.training.flight_logs import read_data, read_table
from swarm_envs.training.flight_logs.checks import checked_drones
from swarm_envs.training.flight_logs.flight_table import COLUMNS, from_columns
from tests.helpers.real_logs import columns_of, write_table


@pytest.fixture(scope="module")
def table(flown, as_table):
    return as_table(flown("SL", "walk", 3.0), "SL")


def same(a, b):
    columns = columns_of(a)
    assert list(columns) == list(columns_of(b))
    assert all(np.array_equal(values, columns_of(b)[name]) for name, values in columns.items())


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_survives_its_file(suffix, table, tmp_path):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    path = tmp_path / f"flight{suffix}"
    write_table(path, table)
    same(read_table(path), table)
    write_table(path, dataclasses.replace(table, acceleration=None))
    assert read_table(path).acceleration is None


def test_parquet_without_pyarrow_names_the_extra(table, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "flight.parquet").write_text("1")
    with pytest.raises(ImportError, match=r"pip install 'swarm-envs\[parquet\]'"):
        read_data(tmp_path)
    write_table(tmp_path / "b.csv", table)
    same(read_table(tmp_path / "b.csv"), table)


def test_columns_in_any_order_quoted_spaced_and_strange_ones_named(table, tmp_path):
    columns = columns_of(table)
    names = list(columns)[::-1]
    lines = ["\ufeff" + ", ".join(['"note"', *names])]
    for k in range(len(table)):
        lines.append(",".join(['"so, so"', *(str(columns[name][k]) for name in names)]))
    path = tmp_path / "flight.csv"
    lines[9:9] = ["", " "]  # blank lines are skipped
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
    same(read_table(path), table)
    _, (report,) = read_data(path)
    assert report.line().endswith("; ignored columns note")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            lambda t: t.replace("voltage", "vbatt", 1),
            "column 'voltage' is missing; there are .*, voltage \\(V\\)",
        ),
        (lambda t: t.replace(",ay,", ",accy,", 1), r"column 'ay' is missing"),
        (lambda t: t.replace(",vx,", ",x,", 1), r"column 'x' exists more than once"),
        (lambda t: t.replace(",", ";"), "separated by commas"),
        (lambda t: t.splitlines()[0], "no line follows the header"),
        (lambda t: "", "the file is empty; copy it again or delete it$"),
        (lambda t: "\n\n", "column 'time' is missing"),
        (lambda t: "\n" + t.replace("cf1,L,", "\n \ncf1,L,oops", 1), "line 6: .*'oops"),
        (lambda t: t.replace("cf1,L,", "cf1,L,oops", 1), "line 3: column 'time' is 'oops"),
        (lambda t: t.replace("cf1,L,", "cf1,L,,", 1), "line 3: it has 22 values, .* 21 columns"),
        (lambda t: t.replace("cf1,L,", "\ncf1\ncf1,L,", 1), "line 4: it has 1 values"),
        (lambda t: t.replace("cf1,L,", "\n ,L,", 1), "line 4: column 'drone' is empty"),
        (lambda t: t.replace("cf1,L,", "\ncf1,L,nan", 1).replace("nan1", "nan,1", 1), "line 4: "),
    ],
)
def test_a_file_that_is_no_such_table(edit, message, table, tmp_path):
    path = tmp_path / "flight.csv"
    write_table(path, table)
    path.write_text(edit(path.read_text()))
    with pytest.raises(ValueError, match=rf"^flight\.csv: .*{message}"):
        read_table(path)


def test_a_signature_other_line_ends_and_capitals_make_no_difference(table, tmp_path):
    path = tmp_path / "FLIGHT.CSV"
    write_table(path, table)
    text = path.read_text()
    for ending in ("\n", "\r\n", "\r"):
        path.write_text("\ufeff" + text, encoding="utf-8", newline=ending)
        same(read_table(path), table)


def parquet_of(table, path, **changes):
    """Write a table with other columns in place of its own, as (values, type of Arrow)."""
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = {name: arrow.array(v.tolist()) for name, v in columns_of(table).items()}
    given = {name: arrow.array(values, kind) for name, (values, kind) in changes.items()}
    parquet.write_table(arrow.table(columns | given), path)
    return path


@pytest.mark.parametrize(
    ("name", "values", "kind", "message"),
    [
        ("drone", ["cf0", None], "string", "line 2: column 'drone' is empty"),
        ("drone", ["cf0", " "], "string", "line 2: column 'drone' is empty"),
        ("drone", [b"cf0", b"cf1"], "binary", "column 'drone' has type binary, but must have text"),
        ("type", [1, 2], "int64", "column 'type' has type int64, but must have text"),
        ("x", [0.0, None], "float64", "line 2: column 'x' is empty"),
        ("x", ["0", "1"], "string", "column 'x' has type string, but must have numbers"),
        ("time", [0, 1], "timestamp[ns]", "column 'time' has type timestamp"),
        (
            "voltage",
            [True, False],
            "bool_",
            "column 'voltage' has type bool, but must have numbers",
        ),
    ],
)
def test_a_parquet_column_must_hold_what_it_says(name, values, kind, message, table, tmp_path):
    arrow = pytest.importorskip("pyarrow")
    kind = arrow.timestamp("ns") if "timestamp" in kind else getattr(arrow, kind)()
    repeated = (values * len(table))[: len(table)]
    path = parquet_of(table, tmp_path / "flight.parquet", **{name: (repeated, kind)})
    with pytest.raises(ValueError, match=rf"^flight\.parquet: .*{re.escape(message)}"):
        read_table(path)


def test_lines_are_read_by_drone_and_time_whatever_their_order(table, tmp_path):
    pytest.importorskip("pyarrow")
    names = np.where(table.drone == "cf0", "drone_10", "drone_2")
    table = dataclasses.replace(table, drone=names)
    write_table(tmp_path / "a.parquet", table)
    orders = np.lexsort((names, table.time)), np.random.default_rng(0).permutation(len(names))
    for order in orders:
        shuffled = {name: values[order] for name, values in columns_of(table).items()}
        write_table(tmp_path / "b.parquet", from_columns(shuffled))
        pairs = (checked_drones(read_table(tmp_path / f"{name}.parquet")) for name in "ab")
        for one, other in zip(*pairs, strict=True):
            assert one.name == other.name
            assert np.array_equal(one.position, other.position)
            assert np.array_equal(one.time, other.time)


def test_a_jump_of_the_clock_costs_one_file_and_no_memory(table, tmp_path):
    write_table(tmp_path / "a.csv", table)
    late = np.arange(len(table)) > len(table) // 2
    first = int(np.argmax(late & (table.drone == "cf0"))) + 2
    for k, jump in enumerate((1e5, 1e9, 1e300)):
        bad = dataclasses.replace(table, time=table.time + jump * late)
        write_table(tmp_path / f"bad-{k}.csv", bad)
    _, (_, *reports) = read_data(tmp_path)
    assert len(reports) == 3 and all(report.refused for report in reports)
    said = f"bad-0.csv: line {first}: the time of drone 'cf0' jumps by 100000 s"
    assert reports[0].refused.startswith(said)


def test_the_docs_list_the_columns():
    text = (Path(__file__).parents[3] / "docs" / "flight-logs.md").read_text(encoding="utf-8")
    for name, column in COLUMNS.items():
        (row,) = [line for line in text.splitlines() if re.search(rf"^\|.*`{name}[`|]", line)]
        assert f"| {column.unit} |" in row and column.meaning in row
        if np.isfinite(column.low):
            assert f"| {column.low:g} to {column.high:g} |" in row


def changed(name, change):
    """The edit of a column, of one drone alone where `change` takes a mask too."""
    return lambda columns: columns | {name: change(columns[name])}


def at(k, value):
    def change(values):
        values = values.copy()
        values[k] = value
        return values

    return change


def scaled(names, factor):
    return lambda columns: columns | {name: columns[name] * factor for name in names}


def degrees(columns):
    """Roll, pitch and yaw in degrees where the quaternion belongs."""
    angles = 2.0 * np.degrees(np.arcsin(np.clip(columns["qx"], -1.0, 1.0)))
    return columns | {"qx": angles + 3.0, "qy": angles, "qz": angles, "qw": 0.0 * angles}


def mirrored(columns):
    """Heights from a ceiling down, though the accelerometer keeps z up."""
    return columns | {"z": 2.5 - columns["z"], "vz": -columns["vz"]}


PWM = [f"pwm{k}" for k in range(1, 5)]
ACCELERATION = ["ax", "ay", "az"]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (changed("vy", at(7, np.nan)), "line 9: column 'vy' is nan, but must be a finite number"),
        (changed("time", at(20, np.inf)), "line 22: column 'time' is inf"),
        (changed("time", at(20, 100.0)), r"line 22: drone 'cf0' has time 100 s in line 2 too"),
        (changed("time", lambda t: t * 1000), r"usually 8\.333\d* s apart, but must be 0\.0005"),
        (changed("type", lambda t: np.where(t == "S", "s", t)), "unknown vehicle type 's' of"),
        (changed("type", at(4, "L")), "drone 'cf0' has the types L, S, but must have one"),
        (changed("drone", at(4, "")), "line 6: column 'drone' is empty"),
        (changed("drone", at(4, "cf9")), "drone 'cf9' has 1 lines"),
        (changed("qw", at(6, 0.5)), r"line 8: the quaternion of drone 'cf0' has length 0\.\d+"),
        (lambda c: c | {"qx": c["qw"], "qw": c["qx"]}, "qx, qy, qz, qw, body to world, z up"),
        (degrees, r"line 2: column 'qx' is \S+, but must lie between -1.01 and 1.01"),
        (scaled(["x", "y", "z"], 1000.0), r"column 'x' is \S+, but .* -200 and 200 m|moves 1e"),
        (scaled(["x", "y", "z"], 10.0), "is 10 times the integral of its velocity"),
        (scaled(["vx", "vy", "vz"], -1.0), "is -1 times the integral of its velocity"),
        (scaled(ACCELERATION, 1 / 9.80665), r"az of drone 'cf0' is usually \+1 m/s\^2, but must"),
        (mirrored, r"az of drone 'cf\d' opposes the change of vz .*z up"),
        (scaled(["ax"], -1.0), r"ax of drone 'cf\d' opposes .*world frame"),
        (scaled(["z", "vz"], -1.0), r"line 2: column 'z' is -\S+, but must lie between -0.5 and"),
        (scaled(ACCELERATION, -1.0), r"az of drone 'cf0' is usually -9\.\d+ m"),
        (scaled(PWM, 1 / 65535), "motors of drone 'cf0' never run"),
        (scaled(["voltage"], 1000.0), r"column 'voltage' is .* between 2.5 and 4.5 V"),
        (scaled(PWM, 0.5), "check the type, the PWM and the voltage"),
    ],
)
def test_every_rule_names_the_value_and_the_fix(edit, message, table):
    checked_drones(table)
    with pytest.raises(ValueError, match=message):
        checked_drones(from_columns(edit(columns_of(table))))


def test_a_bad_file_costs_that_file_alone(flown, as_table, tmp_path):
    table = as_table(flown("SL"), "SL")
    write_table(tmp_path / "a.csv", table)
    alone, _ = read_data(tmp_path)
    write_table(tmp_path / "b.csv", dataclasses.replace(table, voltage=table.voltage * 1000))
    write_table(tmp_path / "c.csv", as_table(flown("L"), "L", names=["cf0"]))
    later = dataclasses.replace(table, time=table.time + 5.0, drone=np.char.add(table.drone, "x"))
    write_table(tmp_path / "d.csv", later)
    (tmp_path / "notes.txt").write_text("windy")
    (tmp_path / "old").mkdir()
    rows, reports = read_data(tmp_path)
    assert np.array_equal(rows.force_g, alone.force_g)
    assert set(rows.vehicle_names.values()) == {"cf0", "cf1"}
    expected = [
        "a.csv: 512 rows of 8 s (dropped: between kept entries: ",
        "refused b.csv: line 2: column 'voltage' is ",
        "refused c.csv: drone 'cf0' has type L, but S in a.csv; give each vehicle a",
        "refused d.csv: it is a copy of a.csv, so that held-out rows could be",
        "refused notes.txt: the name must end in .csv or .parquet",
        "refused old: the name must end in .csv or .parquet",
    ]
    for report, said in zip(reports, expected, strict=True):
        assert report.line().startswith(said)


def test_what_gives_no_row_says_why(flown, as_table, tmp_path):
    table = as_table(flown("SL"), "SL")
    write_table(tmp_path / "a.csv", dataclasses.replace(table, pwm=table.pwm / 65536))
    with pytest.raises(ValueError, match=r"^a\.csv: motors of drone 'cf0' never run"):
        read_data(tmp_path)
    low, level = (values * [1.0, 1.0, 0.0] for values in (table.position, table.velocity))
    low = dataclasses.replace(table, position=low, velocity=level, acceleration=None)
    write_table(tmp_path / "a.csv", low)
    with pytest.raises(ValueError, match=r"no row remains \(a\.csv: 0 rows of 8 s .*too low: \d+"):
        read_data(tmp_path)
    with pytest.raises(FileNotFoundError, match="no data at"):
        read_data(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="has no flight log; put "):
        read_data(tmp_path / "empty")
    (tmp_path / "a.txt").write_text("windy")
    with pytest.raises(ValueError, match=r"^a\.txt: the name must end in \.csv or \.parquet"):
        read_table(tmp_path / "a.txt")


def test_damaged_files_are_refused(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "a.parquet"
    damages = (b"PAR1 and no more", "it cannot be read .*"), (b"", "the file is empty; ")
    for content, said in damages:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=rf"^a\.parquet: {said}copy it again"):
            read_table(path)
