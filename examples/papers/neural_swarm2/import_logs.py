"""Rows of measured force from the public flight logs of Neural-Swarm2's authors.

The logs (github.com/aerorobotics/neural-swarm, folder `data/training`) state no license, so neither
they nor these rows are part of this project; they are read from a clone. Scenarios,
flights and filter are the authors' (`learning/training.py`).
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from examples.papers.common import Array, Row, markdown, within, write_compared

WITHOUT_FORCE = 100  # a drone whose inertial sensor is too noisy, says its readme
COMMIT = "48b185118edde247f46ab76ee821ec23fc1b98ed"
LOGS_SHA256 = "b54004ffd798eff8c2d16d20498f81947d5d6d77bd68268cc91c792ee5a61e49"
"""SHA-256 of the 483 logs, one after another in the order of `GROUPS`."""
FILE = "neural_swarm_flights_33hz.npz"
NAMES = ("Ge2L", "Ge2S", "L2L", "S2S", "L2S", "S2L", "SS2L", "SL2L", "LL2S", "SL2S", "SS2S", "LL2L")

# Folder, numbers of the flights, and vehicles: 50 to 52 are small, 100 to 102 large.
GROUPS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("19_12_11_2019/random_walk_large_large", "00 01", (101, 102)),
    ("19_12_11_2019/random_walk_large_small", "02 03", (50, 102)),
    ("19_12_11_2019/random_walk_small_small", "04 05", (50, 51)),
    ("19_12_11_2019/swap_large_large", "02", (101, 102)),
    ("19_12_11_2019/swap_small_small", "02", (50, 51)),
    ("19_12_11_2019/swap_large_small", "00 01", (50, 102)),
    ("20_12_20_2019/random_walk_large_ground", "01 02", (101,)),
    ("20_12_20_2019/random_walk_small_ground", "01 02", (50,)),
    ("20_12_20_2019/random_walk_sll", "09 10", (50, 101, 102)),
    ("20_12_20_2019/swap_lsl", "06", (50, 101, 102)),
    ("20_12_20_2019/random_walk_ssl", "04 13", (50, 52, 101)),
    ("20_12_20_2019/swap_sls", "03", (50, 52, 101)),
    ("20_12_20_2019/random_walk_sss", "00 01", (50, 51, 52)),
    ("20_12_20_2019/swap_sss", "00", (50, 51, 52)),
    ("21_06_16_2020/randomwalk_l", "01 02 03 04 05 06 07", (102,)),
    ("21_06_16_2020/randomwalk_ll", "00 01 02 03 04 05", (101, 102)),
    ("21_06_16_2020/randomwalk_s", "00 01 02 03 04 05", (50,)),
    ("21_06_16_2020/randomwalk_sl", "00 01 02 03 04", (51, 102)),
    ("21_06_16_2020/randomwalk_sll", "00 01 02 03 04", (51, 101, 102)),
    ("21_06_16_2020/randomwalk_ss", "00 01 02 03 04", (50, 51)),
    ("21_06_16_2020/randomwalk_ssl", "00 01 02 03", (51, 52, 101)),
    ("21_06_16_2020/randomwalk_sss", "00 01 02 03 04 05", (50, 51, 52)),
    ("21_06_16_2020/swap_ll", "00 01 02 03 04 05 06 07 08 09 10 11", (101, 102)),
    ("21_06_16_2020/swap_lll", "01 03", (100, 101, 102)),
    ("21_06_16_2020/swap_sl", "00 01 02 03 04 05 08 09 10 11", (51, 101)),
    ("21_06_16_2020/swap_sll", "00 01 02 03 06", (52, 101, 102)),
    ("21_06_16_2020/swap_ss", "00 01 02 03 04 05 06 07 08 09 10", (50, 51)),
    ("21_06_16_2020/swap_ssl", "00 01 02 05 06 07 08 09", (50, 51, 101)),
    ("21_06_16_2020/swap_sss", "00 01 02 03 04 05 06 07", (50, 51, 52)),
    ("21_06_16_2020/takeoff_l", "00", (102,)),
    ("21_06_16_2020/takeoff_s", "00", (50,)),
    ("21_06_16_2020/takeoff_s", "00", (51,)),
    ("21_06_16_2020/takeoff_s", "00", (52,)),
    ("22_06_19_2020/randomwalk_lll", "00 01 02 03 04 05 06 07 08 09", (100, 101, 102)),
    ("22_06_19_2020/randomwalk_sl", "01 02 03 04 05 06", (51, 101)),
    ("22_06_19_2020/randomwalk_sll", "04 05 06 07 08", (51, 101, 102)),
    ("22_06_19_2020/randomwalk_ssl", "00 01 02 03 04", (51, 52, 102)),
    ("22_06_19_2020/swap_lll", "00 01 02 04 05 08", (100, 101, 102)),
    ("22_06_19_2020/swap_sl", "00 01 02 03 04 05 06 07 08 09 10 11", (51, 101)),
    ("22_06_19_2020/swap_sll", "02 03 04 05 06 07 08 09 10", (50, 101, 102)),
    ("22_06_19_2020/swap_ssl", "00 01 02 03", (51, 52, 102)),
    ("23_06_23_2020/randomwalk_l_1", "00 01 02 03 04 05 06", (101,)),
    ("23_06_23_2020/randomwalk_l_2", "00 01 02 03 04 05 06", (102,)),
    ("23_06_23_2020/randomwalk_s_1", "00 01 02 03 04 05", (52,)),
    ("23_06_23_2020/randomwalk_s_2", "00 01 02 03 04 05", (51,)),
    ("23_06_23_2020/swap_lll", "00 02 03 04 05 06 07 09", (100, 101, 102)),
)

# Four digits for each flight: the bits of its blocks of 5 s that validate, a fifth of all. The 26
# flights without ("----") are left out, for tests of models that were fitted to the others.
SPLIT = (
    "10040080000400200102108800000b03008000180820084000801102001410a00004----0020----00800001"
    "00020000----00080800----000c0d9500c206001001----0b2002200202001509820007----080000810003"
    "04800110000c0c1101c001500442077016800200----143108220c0204060000005100b0----005e08400040"
    "082c000000090000----000a000200030001----000000010001----00050008000c0005000a000200040000"
    "000600000008000000020003----000000020000----00000000000200010000000000000000000100000004"
    "0000000400000004000400000000000000080000----000a0000000100080007000300000040002000000000"
    "0020000a0000000001120080094001aa0013009600100a411400189700c10248----0009000008820002----"
    "000000000000000500080000----0000000000060002----00000000----0000----000b000d----0000----"
    "00000000000000060008000b0000000c08400784----1020006018020850000510781800002214201810140f"
    "----02340900104004100901081008041060----05090041000200000001----0004000000020002"
)
LONGER = "every drone of a kind counts; a scenario was flown for 942 s (SS2L) to 2087 s (SL2L)"
SAME = ("flight", "cf", "scenario")  # equal in all rows of a drone in a flight
BLOCK_STEPS, KEPT = 500, 3  # steps of a block; every third step is kept
MASS_G = {"S": 32.0, "L": 67.0}
PSI_1 = {  # Table I, with the digits of the authors' program: rows must be theirs to the last bit
    "S": (11.093358483549203, -39.08104165843915, -9.525647087583181, 20.573302305476638,
          38.42885066644033),
    "L": (44.10386631845999, -122.51151800146272, -36.18484254283743, 53.10772568607133,
          107.6819263349139),
}  # fmt: skip
LAG = 0.16  # share of the commanded thrust that a step of 0.01 s adds
GRAVITY = 9.81
NEAR_M, LOWEST_M = 0.35, {"S": 0.07, "L": 0.085}


class Track(NamedTuple):
    """The log of a drone, at K steps a hundredth of a second apart."""

    vehicle: int
    motion: Array  # (K, 6) position, m, and velocity, m/s
    force_g: Array  # (K, 4) f_a, and f_a,z without motor lag, from velocities instead of the IMU

    @property
    def kind(self) -> str:
        """The letter of the vehicle's kind."""
        return "S" if self.vehicle < 100 else "L"


def import_logs(
    clone: Annotated[Path, tyro.conf.Positional], out: Path = Path("neural_swarm2")
) -> None:
    """Make rows of measured force from a clone of the authors' repository (Table II as flown).

    Writes `neural_swarm_flights_33hz.npz`, which `table-3 --data` and `swarm-envs fit --data` read,
    and `table_2_flights.json`: flown seconds and rows of each scenario.

    Args:
        clone: folder made by `git clone https://github.com/aerorobotics/neural-swarm`.
        out: folder, made if missing.
    """
    check_clone(clone)
    flights = [fly for group in GROUPS for fly in _flights_of(clone, *group)]
    tables, flown = list[dict[str, Any]](), dict.fromkeys(NAMES, 0.0)
    for k, paths in enumerate(tqdm(flights, "reading", unit="flight")):
        tracks = resample(paths)
        for own in range(len(tracks)):
            if tracks[own].vehicle != WITHOUT_FORCE:
                tables.append(rows_of(k, tracks, own))
                flown[NAMES[tables[-1]["scenario"]]] += 0.01 * len(tracks[own].motion)
    rows = join(tables)
    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out / FILE, **rows)
    report(out, rows, flown, sum(len(table["step"]) for table in tables))


def _flights_of(clone: Path, folder: str, numbers: str, cars: Sequence[int]) -> list[list[Path]]:
    where = clone / "data" / "training" / f"datacollection{folder}"
    return [[where / f"cf{car}_{number}" for car in cars] for number in numbers.split()]


def check_clone(clone: Path) -> None:
    """Refuse a folder that is no clone at `COMMIT` with the logs as they were read.

    Raises:
        ValueError: naming the folder and what to do.
    """
    head = subprocess.run(
        ["git", "-C", str(clone), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    if head != COMMIT:
        raise ValueError(
            f"{clone} is at commit {head or 'none'}, and the logs were read at {COMMIT[:8]}; clone "
            f"https://github.com/aerorobotics/neural-swarm and check out {COMMIT}"
        )
    found = sha256()
    for group in GROUPS:
        for paths in _flights_of(clone, *group):
            for path in paths:
                found.update(path.read_bytes())
    if found.hexdigest() != LOGS_SHA256:
        raise ValueError(f"the logs in {clone} were changed: check out {COMMIT} again")


# ---- Logs


def read_log(path: Path) -> Any:
    """Return the records of a micro SD log of the Crazyflie's firmware, as a structured array.

    A file has the number of variables, their names, each with a letter of Python's `struct`, and
    blocks: a count, as many records, and a checksum.
    """
    raw = path.read_bytes()
    names = raw[1:].split(b",")[: raw[0]]
    record = np.dtype([(name[:-3].decode(), f"<{chr(name[-2])}") for name in names])
    start, blocks = 1 + sum(len(name) + 1 for name in names) + 4, []
    while start < len(raw):
        blocks.append(np.frombuffer(raw, record, raw[start], start + 1))
        start += 1 + raw[start] * record.itemsize + 4
    return np.concatenate(blocks)


def unpack_quaternions(packed: Any) -> Array:
    """Return quaternions (K, 4), x, y, z, w, from the firmware's 32 bits.

    Two bits name the largest component; each other has a sign and nine bits, in 1 / sqrt(2).
    """
    bits = np.asarray(packed, dtype=np.int64)
    found, largest = np.zeros((len(bits), 4)), bits >> 30
    for k in (3, 2, 1, 0):
        here = largest != k
        value = (bits & 511) / 511 / np.sqrt(2.0) * np.where(bits >> 9 & 1, -1.0, 1.0)
        found[here, k] = value[here]
        bits = np.where(here, bits >> 10, bits)
    found[np.arange(len(bits)), largest] = np.sqrt(1.0 - (found**2).sum(axis=1))
    return found


def resample(paths: Sequence[Path]) -> list[Track]:
    """Return the drones of a flight, interpolated at the same steps; the shortest log ends them."""
    logs = [read_log(path) for path in paths]
    times = [(log["tick"].astype(np.float64) - log["tick"][0]) / 1e6 for log in logs]
    # The authors' program cuts two swaps of three large drones a step earlier.
    early = paths[0].parent.name == "swap_lll" and "collection21" not in str(paths[0])
    cut = 0.02 if early else 0.01
    end = min(float(np.floor(time[-1] * 100.0)) / 100.0 - cut for time in times)
    if paths[0].parent.parent.name.endswith("2019"):
        end = round(end, 2)  # typed there by hand
    grid = np.linspace(0.0, end, int(100.0 * end + 1.0))
    return [
        track(int(path.name[2:].partition("_")[0]), grid, time[:-1], log[:-1])
        for path, time, log in zip(paths, times, logs, strict=True)
    ]


def track(vehicle: int, grid: Array, time: Array, log: Any) -> Track:
    """Return what a drone logged, interpolated linearly at the instants of a grid, s."""

    def at(*names: str, unit: float) -> Array:
        return np.stack([np.interp(grid, time, log[name] / unit) for name in names], axis=1)

    state = [f"stateEstimateZ.{axis}" for axis in ("x", "y", "z", "vx", "vy", "vz")]
    turn = unpack_quaternions(log["stateEstimateZ.quat"]).T
    x, y, z, w = (np.interp(grid, time, part) for part in turn)
    up = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), -x * x - y * y + z * z + w * w], 1)
    signals = at("pwm.m1_pwm", "pwm.m2_pwm", "pwm.m3_pwm", "pwm.m4_pwm", unit=65536.0)
    found = Track(vehicle, at(*state, unit=1000.0), np.zeros((len(grid), 4)))
    thrust = thrust_g(found.kind, signals, at("pm.vbatMV", unit=4200.0))
    acceleration = at(*(f"stateEstimateZ.a{axis}" for axis in "xyz"), unit=1000.0)
    mass = MASS_G[found.kind]
    found.force_g[:, :3] = mass * acceleration / GRAVITY - lagged(thrust)[:, None] * up
    slope = differentiate(found.motion[:, 5])
    found.force_g[:, 3] = mass * (slope / GRAVITY + 1.0) - thrust * up[:, 2]
    return found


def thrust_g(kind: str, signals: Array, voltage: Array) -> Array:
    """Return the thrust (K,), g, of four motor signals (K, 4) at a voltage (K, 1) over 4.2 V."""
    a, b, c, d, e = PSI_1[kind]
    rotors = a + b * signals + c * voltage + d * signals**2 + e * signals * voltage
    return np.asarray(rotors.sum(axis=1))


def lagged(thrust: Array) -> Array:
    """Return a thrust (K,) behind the lag of the motors."""
    found = thrust.copy()
    for k in range(len(thrust) - 1):
        found[k + 1] = (1.0 - LAG) * found[k] + LAG * thrust[k]
    return found


def differentiate(values: Array) -> Array:
    """Return the slope (K,) by five points; zero at both ends."""
    slope = np.zeros_like(values)
    slope[2:-2] = (-values[4:] + 8 * values[3:-1] - 8 * values[1:-3] + values[:-4]) / 0.12
    return slope


# ---- Rows


def rows_of(flight: int, tracks: Sequence[Track], own: int) -> dict[str, Any]:
    """Return the rows of a drone in a flight that pass the authors' filter."""
    ego, others = tracks[own], [track for k, track in enumerate(tracks) if k != own]
    inputs = np.zeros((len(ego.motion), 18))
    inputs[:, :6] = -ego.motion
    for k, other in enumerate(others):
        inputs[:, 6 + 6 * k : 12 + 6 * k] = other.motion - ego.motion
    above = "".join(sorted((track.kind for track in others), reverse=True)) or "Ge"
    step = np.flatnonzero(kept(ego, inputs, len(others)))
    return {
        "x": np.round(inputs[step].astype(np.float32), 4),
        "fa": np.round(ego.force_g[step].astype(np.float32), 3),
        "step": step.astype(np.uint16),
        "flight": flight,
        "cf": ego.vehicle,
        "scenario": NAMES.index(f"{above}2{ego.kind}"),
        "place": own,
    }


def kept(ego: Track, inputs: Array, others: int) -> Any:
    """Return which rows (K,) the authors keep: above ground, a neighbor near, no outlier.

    As theirs, inputs are float32 and limits float64: many distances are 0.35 m to the millimeter.
    """
    inputs = inputs.astype(np.float32).astype(np.float64)
    height, force = -inputs[:, 2], ego.force_g[:, 2]
    fine = (height > LOWEST_M[ego.kind]) & (np.abs(force) <= 50.0)
    fine &= (force <= 35.0) | (height <= 0.25)
    near = np.zeros(len(inputs), dtype=bool)
    for k in range(others):
        near |= (np.abs(inputs[:, 6 + 6 * k : 8 + 6 * k]) <= NEAR_M).all(axis=1)
    return fine & near if others else fine


def join(tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return every third step of the flights that `SPLIT` has, by scenario, drone and flight."""
    splits = {table["flight"]: SPLIT[4 * table["flight"] :][:4] for table in tables}
    parts = []
    for table in sorted(tables, key=lambda table: (table["scenario"], table["place"])):
        if splits[table["flight"]] != "----":
            third = table["step"] % KEPT == 0
            step, held = table["step"][third], int(splits[table["flight"]], 16)
            same = {name: np.full(len(step), table[name], np.uint8) for name in SAME}
            columns = {"x": table["x"][third], "fa": table["fa"][third], "step": step}
            parts.append(columns | same | {"val": (held >> step // BLOCK_STEPS & 1).astype(bool)})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} | {
        "names": np.array(NAMES)
    }


def report(out: Path, rows: Mapping[str, Any], flown: Mapping[str, float], logged: int) -> None:
    """Write and print the seconds and rows of each scenario."""
    counts = np.bincount(rows["scenario"], minlength=len(NAMES))
    table: list[dict[str, Any]] = [
        {"scenario": name, "seconds": round(flown[name], 2), "rows": int(count)}
        for name, count in zip(NAMES, counts, strict=True)
    ]
    compared = [
        Row("scenarios", "12", sum(row["rows"] > 0 for row in table), given=True),
        Row("drones' time in a scenario, median, s", "around 1000",
            float(np.median(list(flown.values()))), within(1000.0, 0.25), LONGER, (1000.0, 1500.0)),
        Row("pairs at 100 Hz, all flights", "1.4 million", logged, within(1.4e6, 0.07)),
    ]  # fmt: skip
    numbers = {"rows": len(rows["step"]), "scenarios": table}
    print(markdown(table, ("scenario", "seconds", "rows")))
    write_compared(out / "table_2_flights.json", numbers, compared)
    print(f"wrote {FILE} and table_2_flights.json to {out}")
