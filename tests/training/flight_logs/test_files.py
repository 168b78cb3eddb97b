"""The file of a log: round trips, and every rule that it can break."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from swarm_envs.training.flight_logs import LogOptions, read_logs, read_table, write_table
from swarm_envs.training.flight_logs.checks import checked_drones
from swarm_envs.training.flight_table import from_columns
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, LARGE, SMALL


@pytest.fixture(scope="module")
def table(flown, as_table):
    return as_table(flown("SL", "walk", 3.0), "SL")


def same(a, b):
    columns = a.columns()
    assert list(columns) == list(b.columns())
    assert all(np.array_equal(values, b.columns()[name]) for name, values in columns.items())


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
    (tmp_path / "flight.parquet").touch()
    with pytest.raises(ImportError, match=r"pip install 'swarm-envs\[parquet\]'"):
        read_logs(tmp_path)
    with pytest.raises(ImportError, match=r"pip install 'swarm-envs\[parquet\]'"):
        write_table(tmp_path / "b.parquet", table)
    write_table(tmp_path / "b.csv", table)
    same(read_table(tmp_path / "b.csv"), table)


def test_columns_in_any_order_quoted_spaced_and_strange_ones_named(table, tmp_path):
    columns = table.columns()
    names = list(columns)[::-1]
    lines = ["\ufeff" + ", ".join(['"note"', *names])]
    for k in range(len(table)):
        lines.append(",".join(['"so, so"', *(str(columns[name][k]) for name in names)]))
    path = tmp_path / "flight.csv"
    lines[9:9] = ["", " "]  # blank lines are skipped
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
    read = read_table(path)
    same(read, table)
    assert read.ignored == ("note",)
    _, report = read_logs(path, LogOptions(min_scenario_rows=1, min_quiet_rows=0))
    assert "flight.csv: ignored columns note" in report.lines()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t.replace("voltage", "vbatt", 1), "column 'voltage' is missing; .*'vbatt'"),
        (lambda t: t.replace(",pwm4", "", 1), r"column 'pwm4' is missing"),
        (lambda t: t.replace(",ay,", ",accy,", 1), r"column 'ay' is missing"),
        (lambda t: t.replace(",vx,", ",x,", 1), r"column 'x' is there more than once"),
        (lambda t: t.replace(",", ";"), "separate columns by commas"),
        (lambda t: t.splitlines()[0], "no line follows the header"),
        (lambda t: "", "^the file is empty; copy it again or delete it$"),
        (lambda t: "\n\n", "the file is empty"),
        (lambda t: "\n" + t.replace("cf1,L,", "\n \ncf1,L,oops", 1), "oops.* in line 6"),
        (lambda t: t.replace("cf1,L,", "cf1,L,oops", 1), r"'time' holds 'oops.*' in line 3"),
        (lambda t: t.replace("cf1,L,", "cf1,L,,", 1), r"line 3|row 2"),
        (lambda t: t.replace("cf1,L,", "\ncf1\ncf1,L,", 1), "line 4 has 1 values; write one"),
    ],
)
def test_a_file_that_is_no_such_table(edit, message, table, tmp_path):
    path = tmp_path / "flight.csv"
    write_table(path, table)
    path.write_text(edit(path.read_text()))
    with pytest.raises(ValueError, match=message):
        read_table(path)


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


def rotor_forces(unit):
    """Each rotor's force, in gram-force times `unit`, where its signal belongs."""
    weight = {"S": SMALL.mass, "L": LARGE.mass}

    def edit(columns):
        share = np.array([weight[kind] / GRAM_FORCE for kind in columns["type"]]) * GRAVITY / 4.0
        return columns | dict.fromkeys(PWM, share * unit)

    return edit


def forces(unit, kind="SL"):
    """Mass times acceleration, in newtons times `unit`, of the drones of a kind."""
    mass = {"S": SMALL.mass, "L": LARGE.mass}

    def edit(columns):
        factor = np.array([mass[t] * unit if t in kind else 1.0 for t in columns["type"]])
        return columns | {name: columns[name] * factor for name in ACCELERATION}

    return edit


def mirrored(columns):
    """Heights from a ceiling down, though the accelerometer keeps z up."""
    return columns | {"z": 2.5 - columns["z"], "vz": -columns["vz"]}


PWM = [f"pwm{k}" for k in range(1, 5)]
ACCELERATION = ["ax", "ay", "az"]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (changed("vy", at(7, np.nan)), r"'vy' is nan in line 9 \(drone 'cf1'\), .*finite; remove"),
        (changed("time", at(20, np.inf)), r"column 'time' is inf in line 22"),
        (
            changed("time", at(20, 0.0)),
            r"time of drone 'cf0' goes from 100\..* must increase; sort",
        ),
        (changed("time", lambda t: t * 1000), r"usually 8\.333\d* apart, .*time in seconds"),
        (changed("type", lambda t: np.where(t == "S", "s", t)), "unknown vehicle type 's' of"),
        (changed("type", at(4, "L")), "drone 'cf0' has the types L, S, but must have one"),
        (changed("drone", at(4, "")), "'drone' is empty"),
        (changed("drone", at(4, "cf9")), "drone 'cf9' has 1 lines"),
        (changed("qw", at(6, 0.5)), r"quaternion of drone 'cf0' has length 0\.\d+ at its line 4"),
        (lambda c: c | {"qx": c["qw"], "qw": c["qx"]}, "qw the scalar"),
        (degrees, r"quaternion of drone 'cf0' has length .* no angles \(it looks like degrees\)"),
        (rotor_forces(1.0), "looks like thrust in gram-force: log the signal"),
        (rotor_forces(GRAM_FORCE), "looks like thrust in newtons: log the signal"),
        (scaled(["x", "y", "z"], 1000.0), "moves 1e[+]03 times as its velocity says"),
        (scaled(["vx", "vy", "vz"], -1.0), "moves -1 times as its velocity says"),
        (scaled(ACCELERATION, 1 / 9.80665), "looks like multiples of g: multiply by 9.80665"),
        (scaled(ACCELERATION, 1000 / 9.80665), "looks like thousandths of g"),
        (forces(1.0), r"of drone 'cf0' .*a force in newtons: divide by the mass, 0\.0"),
        (forces(1.0, "L"), r"of drone 'cf1' .*a force in newtons: divide by the mass, 0\.0"),
        (forces(1 / GRAM_FORCE), "looks like a force in gram-force"),
        (scaled(ACCELERATION, 0.4), r"gravity included; give m/s\^2 in the world frame, z up$"),
        (mirrored, r"az - 9\.81 of drone 'cf\d' opposes the change of vz .*z must point up"),
        (scaled(["z", "vz"], -1.0), r"z of drone 'cf0' is usually -.*: z must point up; turn"),
        (scaled(["ax"], -1.0), r"ax of drone 'cf\d' opposes .*same world frame"),
        (scaled(ACCELERATION, -1.0), "sign is turned round"),
        (changed("az", lambda a: a - 9.80665), "gravity seems to be missing: add 9.80665"),
        (scaled(PWM, 1 / 65535), "looks like 0 to 1: multiply by 65535"),
        (scaled(PWM, 100 / 65535), "looks like per cent: multiply by 655.35"),
        (scaled(PWM, 255 / 65535), "looks like 0 to 255: multiply by 257"),
        (scaled(PWM, 3.0), "must be the signal from 0 to 65535$"),
        (scaled(PWM, 0.0), "motors of drone 'cf0' never run"),
        (scaled(["voltage"], 1000.0), "looks like millivolts: divide by 1000"),
        (scaled(["voltage"], 1 / 4.2), "looks divided by 4.2 V"),
        (scaled(PWM, 0.5), "check the type, the PWM and the voltage"),
    ],
)
def test_every_rule_names_the_value_and_the_fix(edit, message, table):
    checked_drones(table)
    with pytest.raises(ValueError, match=message):
        checked_drones(from_columns(edit(table.columns())))


def test_a_folder_goes_on_without_what_is_refused(flown, as_table, tmp_path):
    table = as_table(flown("SL"), "SL")
    write_table(tmp_path / "a.csv", table)
    write_table(tmp_path / "b.csv", dataclasses.replace(table, voltage=table.voltage * 1000))
    lone = as_table(flown("L"), "L", names=["cf0"])
    write_table(tmp_path / "c.csv", lone)
    (tmp_path / "notes.txt").write_text("windy")
    rows, report = read_logs(tmp_path, LogOptions(min_scenario_rows=1, min_quiet_rows=0))
    assert [file.file for file in report.files] == ["a.csv", "b.csv", "c.csv"]
    assert [file.rows for file in report.files] == [len(rows), 0, 0]
    said = "\n".join(report.lines())
    assert "1 of 3 flights are sound: " in said
    assert "not read: notes.txt; data is .csv" in said
    assert "refused b.csv: voltage of drone 'cf0'" in said
    assert "refused c.csv: drone 'cf0' has the type 'L' here, but 'S' in an earlier file" in said


def test_what_gives_no_row_says_why(flown, as_table, tmp_path):
    table = as_table(flown("SL"), "SL")
    write_table(tmp_path / "bad.csv", dataclasses.replace(table, pwm=table.pwm / 65536))
    with pytest.raises(ValueError, match=r"no flight .* is sound: bad\.csv: PWM of drone 'cf0'"):
        read_logs(tmp_path)
    write_table(tmp_path / "bad.csv", table)
    with pytest.raises(ValueError, match=r"1 flights give no row .*scenario too small"):
        read_logs(tmp_path, LogOptions(min_scenario_rows=100_000, min_quiet_rows=0))
    with pytest.raises(FileNotFoundError, match="no data at"):
        read_logs(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="has no flight log, only nothing"):
        read_logs(tmp_path / "empty")
    with pytest.raises(ValueError, match=r"ends in '\.txt', but must in"):
        read_table(tmp_path / "a.txt")
